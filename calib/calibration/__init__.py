"""Calibrations of a camera: observations, estimators, bounds; turntable and cube mirror."""
