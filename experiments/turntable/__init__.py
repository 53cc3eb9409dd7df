"""Joint calibration of camera, mounting and turntable by images of a single star (FISHER23): accuracy and bound.

A single-star simulator is rendered through the lens prescription while a table of two, then of three axes carries its
image over the whole detector; windows are read out with noise and centroided. From the images and the readings of the
table one joint calibration (S100-S200) finds the camera, the direction of the star, the installation and how far the
axes are from square. The truth is the traced lens. Then, on coordinates: whether the covariance is honest, which
reading error dominates, what leaning axes cost, and why the principal point is not known though the line of sight is.
"""
