"""Derivative and inverse of the Brown-Conrady distortion (`optics.distortion_polynomial`), in mm.

With s = x^2 + y^2, g = q1 s + q2 s^2 + q3 s^3 and h = dg/ds, the derivative

    dx'/dx = 1 + g + 2 x^2 h + 6 p1 x + 2 p2 y
    dx'/dy = dy'/dx = 2 x y h + 2 p1 y + 2 p2 x
    dy'/dy = 1 + g + 2 y^2 h + 2 p1 x + 6 p2 y

is symmetric.
"""

from __future__ import annotations

import numpy as np

from calib.cameras.inversion import PlaneMap, invert_plane
from optics.arrays import FloatArray
from optics.distortion_polynomial import one_to_one_radius_mm


def distort_jacobian(x: FloatArray, y: FloatArray, coefficients: FloatArray) -> PlaneMap:
    """Distorted positions with their derivatives by the ideal ones; arguments of `distort`."""
    q1, q2, q3, p1, p2 = coefficients.tolist()
    s = x * x + y * y
    along = p1 * x + p2 * y
    factor = 1.0 + s * (q1 + s * (q2 + s * q3)) + 2.0 * along
    h2 = 2.0 * (q1 + s * (2.0 * q2 + s * (3.0 * q3)))
    xh = x * h2
    cross = xh * y + 2.0 * (p1 * y + p2 * x)
    return PlaneMap(
        x * factor + p1 * s,
        y * factor + p2 * s,
        factor + x * (xh + 4.0 * p1),
        cross,
        cross,
        factor + y * (y * h2 + 4.0 * p2),
    )


def undistort(x: FloatArray, y: FloatArray, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ideal positions of distorted ones, the inverse of `distort`; NaN beyond the fold of the distortion.

    Parameters
    ----------
    x, y : (n,)
        Distorted positions from the principal point [mm].
    coefficients : (5,)
        q1, q2, q3, p1, p2.
    """
    if not np.any(coefficients):
        return x.copy(), y.copy()
    radius = one_to_one_radius_mm(coefficients)
    return invert_plane(
        lambda u, v: distort_jacobian(u, v, coefficients), x, y, safe=lambda u, v: u * u + v * v < radius * radius
    )
