"""A star camera on a turntable before a single-star simulator (FISHER23, S100): bench, rendering, joint calibration."""
