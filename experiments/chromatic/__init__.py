"""Chromatic error of a star camera (ACC18, sec. 1.4.1): shift of a star's image with the colour of its light.

A 5 x 5 point target is rendered through the lens prescription behind three filters at four edge positions, read out
with noise, detected, centroided and reduced as the document does (eq. 13-16, Table 1, Fig. 7); every shift is compared
with the truth and a ray-trace prediction. Questions left open by the document follow: why its signed mean vanishes for
a centred lens, which movement of which element gives its 0.12 px, and whether "one third" holds for stars.
"""
