"""Baffle in front of a lens: its geometry and coatings, and the light that it lets and throws into the lens."""
