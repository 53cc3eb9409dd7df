"""Distortion error (ACC18 eq. 17-30, Fig. 8): residuals of a surveyed 32-point grid before and after a cubic fit.

A grid target over the whole mosaic is rendered, read out thirty times, detected and centroided; mean centroids minus
surveyed coordinates are reduced as printed. The three numbers are labelled by their meaning (before, after, removed),
predicted by ray trace, and compared with the true error of the correction between the points.
"""
