"""What others find in the frames, beside the truth: stars, centroids, attitudes, world coordinates."""
