"""Calibration of a star camera by rendered frames of the real sky: error of the line-of-sight map and its causes.

Sixty frames of the real sky are rendered through the 206 mm lens and through a wide one, every star in its own colour,
read out with noise, detected, centroided and matched from an attitude with an error of arcminutes. Cameras are
calibrated with free attitudes and with attitudes linked by a gyro (ACF17), from poor start values, and the resulting
line of sight is compared with the traced lens over the whole detector: its error, its stated error, and the
contributions of camera model, star colours and centroids.
"""
