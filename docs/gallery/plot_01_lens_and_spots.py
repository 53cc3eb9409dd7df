"""
A lens, its rays and its spots
==============================

Section with rays, and spot diagrams over the field.
"""

from optics import draw_lens, draw_spots, load_lens

lens = load_lens("star_camera_206mm")
section = draw_lens(lens)

# %%
# Spots at three wavelengths about their common mean; the square is a pixel of the detector.
spots = draw_spots(lens, wavelength_nm=[500.0, 600.0, 800.0], pixel_um=5.5)
