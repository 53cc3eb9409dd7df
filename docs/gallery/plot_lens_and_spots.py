"""
A lens, its rays and its spots
==============================

What an optics engineer asks first: the drawing, and where the light of a point lands over the field.
"""

from optics import draw_lens, draw_spots, load_lens

lens = load_lens("star_camera_206mm")
drawing = draw_lens(lens)

# %%
# Spots at best focus of the design; the scale bar is in micrometres.
spots = draw_spots(lens)
