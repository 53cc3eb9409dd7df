"""From light on the detector to centroids, as in a laboratory: windows or frames, dark frames, detection."""
