"""The centroiders, one per file; `calib.measure.centroiding.registry` is their interface and registry."""
