"""Spectra, filter bands, photometry and transmission of a lens."""
