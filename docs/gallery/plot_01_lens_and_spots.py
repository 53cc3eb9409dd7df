"""
A lens, its rays and its spots
==============================

What an optics engineer asks first: the section with rays, and where the light of a point lands over the field.
"""

from optics import draw_lens, draw_spots, load_lens

lens = load_lens("star_camera_206mm")
section = draw_lens(lens)

# %%
# The same for three wavelengths about their common mean, beside a pixel of the detector.
spots = draw_spots(lens, wavelength_nm=[500.0, 600.0, 800.0], pixel_um=5.5)
