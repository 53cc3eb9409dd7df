"""Calibration of a star camera by rendered frames of the real sky: error of the line-of-sight map and its causes.

Sixty frames of the real sky are rendered through the 206 mm lens and through a wide one, every star in its own colour,
read out with noise, detected, centroided and matched from an attitude that is wrong by arcminutes. Cameras are
calibrated with free attitudes and with attitudes linked by a gyro (ACF17), from poor start values, and the resulting
line of sight is compared with the traced lens over the whole detector: how far off it is, how far off it says it is,
and how much of that is the camera model, the colour of the stars, and the centroids.
"""
