"""The centroiders, one per file; `calib.measure.centroid` is the interface and knows their names."""
