"""Brightness of stars in a camera: zero point, colour, vignetting, extinction, spectral response, atmosphere."""
