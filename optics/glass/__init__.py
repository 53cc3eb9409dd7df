"""Refractive index and absorption: the glass catalogue, air, media on any array library."""
