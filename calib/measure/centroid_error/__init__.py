"""Centroid errors without frames: Cramer-Rao bound, S-curve, linear response to pixel noise, predictions from PSFs."""
