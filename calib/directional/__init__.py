"""Directional statistics: the Fisher distribution and whether data follow it."""
