"""What ACF17 prints: Table 2 and the numbers of Fig. 4. Its curves (Fig. 3 and 5) are given as pictures only."""

from __future__ import annotations

import numpy as np

from optics.arrays import FloatArray

__all__ = [
    "FIG4_LARGEST_PX",
    "FIG4_RMS_PX",
    "RUNS",
    "TABLE2_CALIBRATED",
    "TABLE2_NAMES",
    "TABLE2_ROUNDING",
    "TABLE2_START",
    "TABLE2_TRUE",
    "TABLE2_UNITS",
]


def _locked(*values: float) -> FloatArray:
    array = np.array(values)
    array.setflags(write=False)
    return array


TABLE2_NAMES = ("x0", "y0", "f", "q1", "q2", "q3", "p1", "p2", "phi1", "phi2", "phi3", "theta1", "theta2", "theta3")
TABLE2_UNITS = ("px", "px", "mm", "mm⁻²", "mm⁻⁴", "mm⁻⁶", "mm⁻¹", "mm⁻¹", *("deg",) * 6)
TABLE2_TRUE = _locked(10, -10, 25.6, 2e-4, -4e-7, 1e-8, 2e-4, 2e-4, 56.9476, -1.0046, -25.3335, 2, 2, 2)
TABLE2_START = _locked(0, 0, 20, *(0,) * 11)
TABLE2_CALIBRATED = _locked(
    9.81, -10.51, 25.6002, 1.96e-4, -1.84e-9, -1.72e-8, 1.99e-4, 1.98e-4,
    56.9550, -1.0084, -25.3325, 2.0019, 1.9950, 2.0001,
)  # fmt: skip
TABLE2_ROUNDING = _locked(0.01, 0.01, 1e-4, 1e-6, 1e-11, 1e-10, 1e-6, 1e-6, *(1e-4,) * 6)
"""Unit of the last printed digit. The errors of phi and theta are printed too, consistently, in arcsec."""

FIG4_RMS_PX = _locked(0.0132, 0.0123)
"""RMS reprojection error, x and y, for 0.1 px of star noise and the gyro of Table 1."""
RUNS = 100
"""That the printed numbers are the mean of, as the text says."""
FIG4_LARGEST_PX = 0.04
"""All reprojection errors of Fig. 4 are below."""
