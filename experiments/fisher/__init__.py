"""Accuracy of a single-frame star vector: scatter on a turntable, by the Fisher distribution (FISHER23).

A single star is rendered through the lens while a table carries its image over the whole detector, at rest and in
motion. A joint calibration (S100) on separate frames gives camera, star and installation; with it the images of single
frames become vectors in the table's frame at zero angles (S200-S300), and their concentration a standard deviation per
axis with a confidence interval (S400-S500). For comparison: the usual method, pixel residuals times an angle per pixel,
with its bias over the field of view, and the coverage of the confidence interval.
"""
