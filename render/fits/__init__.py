"""FITS files: frames, headers, world coordinates."""
