"""
Your own lens from Zemax
========================

A ``.zmx`` file is read line by line; the report lists each line as read, approximated or ignored. Unsupported features
are refused with their line.
"""

from optics import draw_distortion, draw_lens, read_lens_file

file = read_lens_file("files/triplet.zmx")
print(file.report)
section = draw_lens(file.lens)

# %%
# All functions that take a built-in lens also take this lens.
distortion = draw_distortion(file.lens)
