"""Light and how much of it: spectra, filter bands, photometry, transmission of a lens."""
