"""Statistics of samples: robust scatter, positions over frames, separability of two kinds of images."""
