"""Brown-Conrady distortion of the image plane, ideal -> distorted, in mm from the principal point.

ACF17, eq. 4 (after Brown 1966, Photogrammetric Engineering 32, 444): with s = x^2 + y^2 and g = q1 s + q2 s^2 + q3 s^3,

    x' = x (1 + g) + p1 (2 x^2 + s) + 2 p2 x y
    y' = y (1 + g) + p2 (2 y^2 + s) + 2 p1 x y

q1, q2, q3 are in mm^-2, mm^-4, mm^-6, p1, p2 in mm^-1. Written with vectors, e = g r + p s + 2 r (p . r), so the
deviation of its derivative from the identity is bounded by

    |de| <= 3 |q1| s + 5 |q2| s^2 + 7 |q3| s^3 + 6 |p| |r|,

and the distortion is one-to-one within the radius at which this reaches 1.
"""

from __future__ import annotations

import numpy as np

from optics.arrays import FloatArray

COEFFICIENTS = ("q1_per_mm2", "q2_per_mm4", "q3_per_mm6", "p1_per_mm", "p2_per_mm")


def distort(x: FloatArray, y: FloatArray, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distorted positions (n,) of ideal ones (n,) [mm from the principal point]; coefficients q1, q2, q3, p1, p2."""
    q1, q2, q3, p1, p2 = coefficients.tolist()
    s = x * x + y * y
    factor = 1.0 + s * (q1 + s * (q2 + s * q3)) + 2.0 * (p1 * x + p2 * y)
    return x * factor + p1 * s, y * factor + p2 * s


def one_to_one_radius_mm(coefficients: FloatArray) -> float:
    """Radius [mm] within which the module's bound proves the distortion one-to-one; infinite without distortion."""
    q1, q2, q3, p1, p2 = np.abs(coefficients).tolist()
    p = float(np.hypot(p1, p2))

    def bound(r: float) -> float:
        s = r * r
        return s * (3.0 * q1 + s * (5.0 * q2 + s * 7.0 * q3)) + 6.0 * p * r

    if bound(1.0) == 0.0:
        return float("inf")
    low, high = 0.0, 1.0
    while bound(high) < 1.0 and high < 1e12:
        low, high = high, 2.0 * high
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if bound(middle) < 1.0 else (low, middle)
    return low
