"""Sensor file of a camera (its twin) from a folder of its night frames, with uncertainties and a comparison.

The frames are solved blind and measured: camera model with its order, PSF over the field and against colour, zero
point, colour, vignetting, extinction, gain, noise, fixed pattern. The twin is a sensor file that every experiment
without glass takes. Each frame is rendered by a twin measured without it and reduced by the same code; every statistic
of real and rendered frames is compared, with its error and a verdict. Without ``--frames`` frames of a known camera are
rendered first, and the measured parameters are compared with the truth.
"""
