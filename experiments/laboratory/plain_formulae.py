"""The documents' formulae once more, in plain NumPy, for criteria that must not share code with what they judge.

Nothing here is used by a simulation or a reduction, and nothing of those is used here: turns are matrices written out
element by element or by Rodrigues' formula, the camera is ACF17 eq. 3 and 4 term by term, an attitude comes from the
singular vectors of Kabsch (Acta Cryst. A32, 922, 1976).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray

__all__ = [
    "ARCSEC",
    "acf_camera_px",
    "acf_matrix",
    "matrix_of_quaternion",
    "small_turn_rad",
    "table_matrices",
    "turn_matrix",
]


ARCSEC = np.pi / 648000.0
"""One second of arc [rad]."""
NEAR_TO_ONE = 0.1


def turn_matrix(axis: ArrayLike, angle_rad: ArrayLike) -> FloatArray:
    """Matrices (..., 3, 3) that turn vectors about a unit axis (3,) by the right-hand rule (Rodrigues)."""
    x, y, z = np.asarray(axis, float)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.asarray(angle_rad, float)[..., None, None]
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))


def acf_matrix(a1: float, a2: float, a3: float) -> FloatArray:
    """C = R_y(a2) R_x(a1) R_z(a3) of ACF17 eq. 2 (3, 3), from the three printed matrices."""
    c, s = np.cos([a1, a2, a3]), np.sin([a1, a2, a3])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, c[0], s[0]], [0.0, -s[0], c[0]]])
    about_y = np.array([[c[1], 0.0, -s[1]], [0.0, 1.0, 0.0], [s[1], 0.0, c[1]]])
    about_z = np.array([[c[2], s[2], 0.0], [-s[2], c[2], 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_y @ about_x @ about_z)


def matrix_of_quaternion(xyzw: ArrayLike) -> FloatArray:
    """Matrix (3, 3) of a unit quaternion, scalar last, that takes vectors of the one frame to the other."""
    x, y, z, w = np.asarray(xyzw, float)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def acf_camera_px(values: Sequence[float], rays: ArrayLike, size_px: tuple[int, int], pitch_mm: float) -> FloatArray:
    """Images (n, 2) [px] of directions (n, 3) in the camera: ACF17 eq. 3 and 4."""
    x0, y0, f, q1, q2, q3, p1, p2 = values
    vx, vy, vz = np.asarray(rays, float).T
    x, y = f * vx / vz, f * vy / vz
    rr = x * x + y * y
    dx = p1 * (2 * x * x + rr) + 2 * p2 * x * y + q1 * x * rr + q2 * x * rr**2 + q3 * x * rr**3
    dy = p2 * (2 * y * y + rr) + 2 * p1 * x * y + q1 * y * rr + q2 * y * rr**2 + q3 * y * rr**3
    return np.column_stack(
        [(size_px[0] - 1) / 2 + x0 + (x + dx) / pitch_mm, (size_px[1] - 1) / 2 + y0 + (y + dy) / pitch_mm]
    )


def table_matrices(axes: str, angle_rad: ArrayLike, lean_arcsec: Sequence[float]) -> FloatArray:
    """Laboratory from table top (n, 3, 3) of a table with axes like "xy" or "z-xy", outermost first.

    Every angle is right-handed about its axis; an axis that leans encloses 90 deg less ``lean_arcsec`` with the one
    that carries it.
    """
    letters, nominal, sign = {"x": [1.0, 0.0, 0.0], "y": [0.0, 1.0, 0.0], "z": [0.0, 0.0, 1.0]}, [], 1.0
    for letter in axes:
        if letter != "-":
            nominal.append(sign * np.array(letters[letter]))
        sign = -1.0 if letter == "-" else 1.0
    angle = np.asarray(angle_rad, float)
    total = turn_matrix(nominal[0], angle[:, 0])
    for i in range(1, len(nominal)):
        lean = lean_arcsec[i - 1] * ARCSEC
        axis = nominal[i] * np.cos(lean) + nominal[i - 1] * np.sin(lean)
        total = total @ turn_matrix(axis, angle[:, i])
    return np.asarray(total)


def small_turn_rad(matrix: ArrayLike) -> FloatArray:
    """Rotation vectors (..., 3) of matrices near to one, to first order; infinite for matrices that are not."""
    m = np.asarray(matrix, float)
    parts = (m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1])
    small = np.abs(m - np.eye(3)).max(axis=(-2, -1)) < NEAR_TO_ONE  # half a turn has no antisymmetric part either
    return np.asarray(np.where(small[..., None], np.stack(parts, axis=-1) / 2.0, np.inf))
