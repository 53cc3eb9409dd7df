"""Predicted errors of attitudes from star directions and the expected errors of the stars, without measurements.

The attitude of stars at v with weights w errs, to first order, by ``e = M^-1 sum w (v x dv)`` for known changes dv of
their directions, with ``M = sum w (I - v v^T)``, and with the covariance ``M^-1 [sum w^2 s^2 (I - v v^T)] M^-1`` for
independent errors s across each direction; with the right weights, 1 / s^2, that is ``M^-1``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import constants

from calib.attitude.wahba import adjugate3
from optics.arrays import FloatArray

DEGENERATE = 1e-13
"""Smallest determinant of the information, relative to its trace cubed; below, the roll is not determined."""


def attitude_covariance(
    v_cam: FloatArray,
    variance_rad2: FloatArray,
    frame: NDArray[np.int64],
    frames: int,
    probability: FloatArray | None = None,
) -> FloatArray:
    """Covariance of the error's rotation vector in cam, ``(sum probability (I - v v^T) / variance)^-1``.

    Shuster and Oh, J. Guid. Control 4, 70 (1981); the estimate of `calib.attitude.attitude_solution.solve_wahba` with
    the right weights reaches it.

    Shapes: ``v_cam`` (m, 3), ``variance_rad2`` (m,), ``frame`` (m,), ``probability`` (m,).
    """
    weight = np.divide(1.0 if probability is None else probability, variance_rad2)
    outer = np.empty((frames, 3, 3))
    for a in range(3):
        for b in range(a, 3):
            outer[:, a, b] = outer[:, b, a] = np.bincount(frame, weight * v_cam[:, a] * v_cam[:, b], frames)
    trace = np.einsum("fii->f", outer)
    adjugate, determinant = adjugate3(trace[:, None, None] * np.eye(3) - outer)
    regular = determinant > DEGENERATE * trace**3
    covariance = np.full((frames, 3, 3), np.inf)
    covariance[regular] = adjugate[regular] / determinant[regular, None, None]
    return covariance


def attitude_of_shifts(v_cam: FloatArray, weight: FloatArray, shift_rad: FloatArray) -> FloatArray:
    """Attitude error (3,) [rad] of stars (n, 3) whose directions change by ``shift_rad`` (n, 3); weights (n,)."""
    return np.asarray(
        np.linalg.solve(_information(v_cam, weight), (weight[:, None] * np.cross(v_cam, shift_rad)).sum(0))
    )


def covariance_of_noise(
    v_cam: FloatArray, weight: FloatArray, variance_rad2: FloatArray, probability: float = 1.0
) -> FloatArray:
    """Covariance (3, 3) of the attitude of stars (n, 3) that err independently, with weights of any kind.

    ``probability``: probability that a star is measured at all; its error and its weight are missing together.
    """
    inverse = np.linalg.inv(_information(v_cam, weight))
    return np.asarray(inverse @ _information(v_cam, weight**2 * variance_rad2) @ inverse / probability)


def attitude_of_velocity(velocity_km_per_s: ArrayLike) -> FloatArray:
    """Attitude error (3,) [rad] by an unknown velocity (3,) in cam: aberration moves all stars alike, z x V / c."""
    return np.cross([0.0, 0.0, 1.0], np.asarray(velocity_km_per_s, float)) * 1e3 / constants.c


def _information(v_cam: FloatArray, weight: FloatArray) -> FloatArray:
    return np.asarray(weight.sum() * np.eye(3) - np.einsum("n,ni,nj->ij", weight, v_cam, v_cam))
