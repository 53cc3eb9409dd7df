"""Distortion error (ACC18 eq. 17-30, Fig. 8): residuals of a surveyed 32-point grid before and after a cubic fit.

A grid target over the whole mosaic is rendered, read out thirty times, detected and centroided; mean centroids minus
surveyed coordinates are reduced as printed. The three numbers are labelled with what they are (found, left, removed),
predicted by ray trace, and judged by the error that the correction really has between the points.
"""
