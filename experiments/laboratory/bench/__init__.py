"""The bench: point targets before the camera, their light, read-out and centroids."""
