"""Motion of the camera: trajectories, jitter, gyros."""
