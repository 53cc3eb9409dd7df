"""Baffle in front of a lens: geometry and coatings, direct and scattered light at the entrance of the lens."""
