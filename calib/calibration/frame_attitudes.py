"""Attitudes of single frames with a camera from elsewhere, and their residuals: how well it predicts them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from calib.attitude.attitude_solution import solve_wahba
from calib.attitude.identify import MEDIAN_RAYLEIGH
from calib.calibration.observations import Observations
from calib.cameras.base import CameraModel
from optics.arrays import BoolArray, FloatArray
from optics.attitude import attitude_error_arcsec
from optics.errors import DomainError

CLIP_SIGMA, ROUNDS, FEWEST = 4.5, 6, 4
FEWEST_FOR_HALVES = 12


def predicted_residuals(stars: Observations, camera: CameraModel) -> tuple[FloatArray, BoolArray]:
    """Residuals (n, 2) [px] of the stars of a frame after its best attitude, and which are no outliers (n,)."""
    used = np.ones(len(stars), bool)
    v_cam = camera.unproject(stars.pixel_px)
    sigma = np.sqrt(np.trace(stars.covariance_px2, axis1=1, axis2=2) / 2.0)
    direction = np.array(stars.direction)
    residual = np.zeros((len(stars), 2))
    for _ in range(ROUNDS):
        attitude = solve_wahba(v_cam[used], direction[used], sigma_rad=sigma[used] * 1e-4).rotation
        residual = stars.pixel_px - camera.project(attitude.apply(direction))
        normalised = np.linalg.norm(residual, axis=1) / sigma
        inliers = normalised < CLIP_SIGMA * max(1.0, float(np.median(normalised[used])) / MEDIAN_RAYLEIGH)
        if np.array_equal(inliers, used) or inliers.sum() < FEWEST:
            break
        used = inliers
    return residual, used


def frame_attitude(stars: Observations, camera: CameraModel) -> Rotation:
    """Attitude of a frame with a given camera: stars with equal weights, outliers left out.

    `DomainError` if the stars determine no attitude.
    """
    _, used = predicted_residuals(stars, camera)
    solution = solve_wahba(camera.unproject(stars.pixel_px[used]), np.array(stars.direction[used]))
    if not solution.ok:
        raise DomainError(f"attitude of {used.sum()} stars: {solution.message}")
    return solution.rotation


def frame_attitudes(stars: Observations, camera: CameraModel, start: Sequence[Rotation]) -> Rotation:
    """Attitudes of all frames with a given camera; ``start`` in frames of fewer than four stars."""
    frames = [stars.select(stars.frame == number) for number in range(len(start))]
    return Rotation.concatenate(
        [
            frame_attitude(observed, camera) if len(observed) >= FEWEST else turn
            for observed, turn in zip(frames, start, strict=True)
        ]
    )


def camera_residuals(stars: Observations, camera: CameraModel, attitudes: Rotation) -> FloatArray:
    """Measured minus predicted positions (n, 2) [px]; attitudes of all frames."""
    turn = attitudes.as_matrix()[stars.frame]
    return np.asarray(stars.pixel_px - camera.project(np.einsum("nij,nj->ni", turn, stars.direction)))


def split_half_error_arcsec(stars: Observations, camera: CameraModel) -> FloatArray:
    """Half of the difference (3,) of two attitudes by every other star: the error of one attitude by all of them.

    NaN with fewer than 12 stars.
    """
    if len(stars) < FEWEST_FOR_HALVES:
        return np.full(3, np.nan)
    even, odd = (frame_attitude(stars.select(np.arange(len(stars)) % 2 == part), camera) for part in (0, 1))
    return attitude_error_arcsec(even, odd) / 2.0
