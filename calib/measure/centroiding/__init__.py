"""What the centroiders share: registry, options, moments, maximum likelihood, the pixel-integrated Gaussian."""
