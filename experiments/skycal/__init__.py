"""How well a star camera is calibrated by the stars it sees, and what limits it: rendered frames of a moving sky.

Sixty frames of the real sky are rendered through the 206 mm lens and through a wide one, every star in its own colour,
read out with noise, detected, centroided and matched from an attitude that is wrong by arcminutes. Cameras are
calibrated with free attitudes and with attitudes linked by a gyro (ACF17), from poor start values, and the resulting
line of sight is compared with the traced lens over the whole detector: how far off it is, how far off it says it is,
and how much of that is the camera model, the colour of the stars, and the centroids.
"""
