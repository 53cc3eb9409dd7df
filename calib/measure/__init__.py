"""From pixels to stars: images, background, detection, centroids, their errors without frames, ePSFs, round targets."""
