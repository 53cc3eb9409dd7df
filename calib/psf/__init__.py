"""The point-spread function as measured on stars: mixtures of Gaussians over the field and colour, shapes of images."""
