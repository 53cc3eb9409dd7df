"""Residuals of identified stars, tested against their noise and the stated model error.

A match within a tolerance of some pixels identifies a star, but a camera model that is off by pixels or a wrong partner
may meet the tolerance too. A robust rotation is therefore fitted to the stars (least distances, then least squares of
the stars within 5 sigma), and every residual is tested against the centroid's covariance and the stated model error.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.attitude.attitude_solution import solve_wahba
from calib.attitude.wahba import rotations_of_groups
from calib.cameras.base import CameraModel
from calib.fitting.misfit import LARGEST_WRONG_PART, UNTESTED, ChiSquare, joined
from optics.arrays import BoolArray, FloatArray
from optics.errors import DomainError

BEYOND_SIGMA = 5.0  # of both axes together; one star of 270 000 lies there by chance
ROUNDS = 10


class StarResiduals(NamedTuple):
    """Residuals (k, 2) [px], measured minus catalogue; which lie beyond their noise (k,); chi-square; one line."""

    residual_px: FloatArray
    beyond: BoolArray
    misfit: ChiSquare
    note: str


def star_residuals(
    pixel_px: FloatArray,
    v_ref: FloatArray,
    model: CameraModel,
    *,
    sigma_px: ArrayLike | None = None,
    model_error_px: float = 0.0,
) -> StarResiduals:
    """Residuals of identified stars after the best rotation.

    Shapes: ``pixel_px`` (k, 2), ``v_ref`` (k, 2), ``sigma_px`` (k,).
    """
    if not (np.isfinite(model_error_px) and model_error_px >= 0):
        raise DomainError(f"model_error_px = {model_error_px}; it must be finite and not negative")
    v_cam, count = model.unproject(pixel_px), len(pixel_px)
    fewest = max(3, (1.0 - LARGEST_WRONG_PART) * count)
    start = rotations_of_groups(v_cam, v_ref, np.zeros(count, np.int64), 1, robust=True)[0]
    residual = _residual(pixel_px, v_ref, model, Rotation.from_matrix(start))
    if sigma_px is None:
        return StarResiduals(residual, np.zeros(count, bool), UNTESTED, _size(residual))
    error = np.hypot(np.broadcast_to(np.asarray(sigma_px, float), (count,)), model_error_px)
    if not np.all(error > 0):
        raise DomainError("sigma_px of an identified star is not positive; leave it out, or state a model_error_px")
    inliers = _within(residual, error)
    for _ in range(ROUNDS):
        if np.count_nonzero(inliers) < fewest:
            inliers = np.ones(count, bool)  # no minority: it is the model or the noise
        solution = solve_wahba(v_cam[inliers], v_ref[inliers], sigma_rad=error[inliers] * model.pixel_angle_rad)
        residual = _residual(pixel_px, v_ref, model, solution.rotation)
        previous, inliers = inliers, _within(residual, error)
        if np.array_equal(previous, inliers) or np.count_nonzero(inliers) < 3:
            break
    tested = inliers if np.count_nonzero(inliers) >= fewest else np.ones(count, bool)
    squares = np.sum((residual / error[:, None]) ** 2, axis=1)
    misfit = ChiSquare(value=float(squares[tested].sum()), degrees_of_freedom=max(2 * int(tested.sum()) - 3, 0))
    beyond = ~inliers
    text = f"{np.count_nonzero(beyond)} of {count} stars lie beyond {BEYOND_SIGMA:g} sigma of noise and model error"
    return StarResiduals(residual, beyond, misfit, joined(_size(residual), text if beyond.any() else "", misfit.note))


def _residual(pixel: FloatArray, v_ref: FloatArray, model: CameraModel, rotation: Rotation) -> FloatArray:
    return pixel - model.project(v_ref @ rotation.as_matrix().T)


def _within(residual: FloatArray, error: FloatArray) -> BoolArray:
    return np.asarray(np.sqrt(np.sum(residual**2, axis=1)) <= BEYOND_SIGMA * error)


def _size(residual: FloatArray) -> str:
    length = np.sqrt(np.sum(residual**2, axis=1))
    return f"residuals {np.sqrt(np.mean(length**2)):.3g} px RMS, {length.max():.3g} px at most" if len(length) else ""
