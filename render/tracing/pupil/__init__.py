"""Sampling of a star's beam: outline, points inside, adaptive orders."""
