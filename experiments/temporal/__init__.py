"""Temporal error of a star camera (ACC18 eq. 1-2, Fig. 5): frames of a static target, scatter against signal.

A 5 x 5 point target stands still; frames are rendered, read out with noise and rounding, detected and centroided at
several signal levels. The scatter of every star's centroid is compared with the Cramer-Rao bound and two predictions
without frames: the noise model carried through each centroider's influence function, and noise drawn on PSF windows.
"""
