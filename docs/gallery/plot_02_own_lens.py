"""
Your own lens from Zemax
========================

A ``.zmx`` file is read line by line; the report says what was taken over, what was approximated, what has no meaning
here. What cannot be read right is refused with the line.
"""

from optics import draw_distortion, draw_lens, read_lens_file

file = read_lens_file("files/triplet.zmx")
print(file.report)
section = draw_lens(file.lens)

# %%
# Everything that is asked of a built-in lens can be asked of it.
distortion = draw_distortion(file.lens)
