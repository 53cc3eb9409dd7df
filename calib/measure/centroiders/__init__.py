"""The centroiders, one per file; `calib.measure.centroid` is their interface and registry."""
