"""Predicted covariance of attitudes from star directions and expected errors, without measurements."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.attitude.wahba import adjugate3
from optics.arrays import FloatArray

DEGENERATE = 1e-13
"""Smallest determinant of the information, relative to its trace cubed; below, the roll is not determined."""


def attitude_covariance(
    v_cam: FloatArray, variance_rad2: FloatArray, frame: NDArray[np.int64], frames: int, share: FloatArray | None = None
) -> FloatArray:
    """Covariance of the error's rotation vector in cam, ``(sum share (I - v v^T) / variance)^-1``.

    Shuster and Oh, J. Guid. Control 4, 70 (1981); the estimate of `calib.attitude.solve.solve_wahba` with the right
    weights reaches it.

    Shapes: ``v_cam`` (m, 3), ``variance_rad2`` (m,), ``frame`` (m,), ``share`` (m,).
    """
    weight = np.divide(1.0 if share is None else share, variance_rad2)
    outer = np.empty((frames, 3, 3))
    for a in range(3):
        for b in range(a, 3):
            outer[:, a, b] = outer[:, b, a] = np.bincount(frame, weight * v_cam[:, a] * v_cam[:, b], frames)
    trace = np.einsum("fii->f", outer)
    information = trace[:, None, None] * np.eye(3) - outer
    adjugate = adjugate3(information)
    determinant = np.einsum("fi,fi->f", information[:, 0, :], adjugate[:, :, 0])
    known = determinant > DEGENERATE * trace**3
    covariance = np.full((frames, 3, 3), np.inf)
    covariance[known] = adjugate[known] / determinant[known, None, None]
    return covariance
