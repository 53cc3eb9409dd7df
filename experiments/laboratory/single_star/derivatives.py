"""Derivatives of the star and its image by angles and leans of the table, and by every unknown of the joint
calibration.

Independent of the estimator in `calib`; only the camera's derivatives are shared.
"""

from __future__ import annotations

import numpy as np

from calib.attitude.link import angles_of_rotation, increment_per_angle
from calib.cameras.base import CameraModel
from experiments.laboratory.single_star.bench import Bench
from experiments.laboratory.single_star.star import star_angles_deg
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD, DEG_RAD


def angle_effect(bench: Bench, angle_rad: FloatArray) -> FloatArray:
    """Derivative by an angle of the direction in cam: (n, k, 3) per radian.

    From v = M R^T s and dR = [w x] R: dv = -M R^T (w x s).
    """
    return _effect(bench, angle_rad, bench.table.angle_rates(angle_rad))


def lean_effect(bench: Bench, angle_rad: FloatArray) -> FloatArray:
    """Derivative by a non-orthogonality of the direction in cam: (n, k - 1, 3) per radian."""
    return _effect(bench, angle_rad, bench.table.lean_rates(angle_rad))


def _effect(bench: Bench, angle_rad: FloatArray, rates: FloatArray) -> FloatArray:
    to_cam = bench.installation.as_matrix() @ np.swapaxes(bench.table.rotation(angle_rad).as_matrix(), 1, 2)
    return np.asarray(np.cross(bench.star, rates) @ np.swapaxes(to_cam, 1, 2))


def reading_covariance_px2(model: CameraModel, bench: Bench, angle_rad: FloatArray) -> FloatArray:
    """Covariance on the detector by the reading noise of the table, (n, 2, 2) [px^2]."""
    by_direction = model.project_jacobian(bench.seen(angle_rad)).by_direction
    shift = by_direction @ np.swapaxes(angle_effect(bench, angle_rad), 1, 2)
    sigma = bench.table.reading_noise_arcsec * ARCSEC_RAD
    return np.asarray((shift * sigma**2) @ np.swapaxes(shift, 1, 2))


def design(model: CameraModel, bench: Bench, angle_rad: FloatArray, *, leans: bool) -> FloatArray:
    """Derivatives (n, 2, q) of the image by all unknowns."""
    direction = bench.seen(angle_rad)
    projection = model.project_jacobian(direction)
    (azimuth, elevation), theta = star_angles_deg(bench.star) * DEG_RAD, angles_of_rotation(bench.installation)
    across = np.array(  # derivatives of the star's direction by azimuth and elevation
        [
            [np.cos(azimuth) * np.cos(elevation), 0.0, -np.sin(azimuth) * np.cos(elevation)],
            [-np.sin(azimuth) * np.sin(elevation), np.cos(elevation), -np.cos(azimuth) * np.sin(elevation)],
        ]
    )
    turns = increment_per_angle(theta).T  # rotation vectors in cam, per angle of the installation
    to_cam = bench.installation.as_matrix() @ np.swapaxes(bench.table.rotation(angle_rad).as_matrix(), 1, 2)
    moves = [np.swapaxes(to_cam @ across.T, 1, 2), np.cross(turns[None], direction[:, None])]
    if leans:
        moves.append(lean_effect(bench, angle_rad))
    by_pose = projection.by_direction @ np.swapaxes(np.concatenate(moves, axis=1), 1, 2)
    return np.concatenate([projection.by_parameter, by_pose], axis=2)
