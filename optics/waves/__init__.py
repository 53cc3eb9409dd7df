"""Diffraction from traced rays: pupil fields, images by a sum of plane waves, wavefront errors, Zernike polynomials."""
