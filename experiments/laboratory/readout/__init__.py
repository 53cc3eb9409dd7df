"""From light on the detector to centroids, as a laboratory measures: windows or frames, dark frames, detection."""
