"""Joint calibration of camera, mounting and turntable by images of a single star (FISHER23): accuracy and bound.

A single-star simulator is rendered through the lens prescription while a table of two, then of three axes carries its
image over the whole detector; windows are read out with noise and centroided. From images and table readings one joint
calibration (S100-S200) determines the camera, the direction of the star, the installation and the non-orthogonality of
the axes. The truth is the traced lens. Monte-Carlo runs on coordinates then test the covariance, the dominant reading
error, the effect of leaning axes, and why the principal point is poorly determined while the line of sight is not.
"""
