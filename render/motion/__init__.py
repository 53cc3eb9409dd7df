"""How a camera moves: trajectories, jitter, gyros."""
