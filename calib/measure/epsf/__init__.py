"""Effective PSFs: B-splines between their samples, construction from stars, interpolation over the field."""
