"""A camera on a turntable before a star that is fixed in the laboratory: geometry and derivatives.

Three frames: the laboratory, in which the star is fixed and which is the table's frame at zero angles; the table top;
the camera. With the installation M (cam from table top) and the table's attitude R (laboratory from table top)::

    v_cam = M R^T s

The derivatives are independent of the estimator (`calib.calibration.turntable`); only the camera's are shared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.attitude.euler_angles import angles_of_rotation, increment_per_angle
from calib.attitude.star_vectors import initial_frame_vectors
from calib.calibration.table_axes import TableAxes
from calib.cameras.base import CameraModel, unproject_jacobian
from calib.directional.fisher import tangent_basis
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from optics.units import ARCSEC_RAD, DEG_RAD, RAD_DEG

AIM_STEPS = 60
AIM_TOLERANCE_RAD = 1e-12
LONGEST_STEP_RAD = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class StarBench:
    """Star, table and mounting of the camera."""

    table: TableAxes  # The table
    star: FloatArray  # (3,) Direction of the star in the laboratory
    installation: Rotation  # Cam from table top

    def __post_init__(self) -> None:
        freeze(self, "star", shape=(3,))

    def star_in_cam(self, angle_rad: ArrayLike) -> FloatArray:
        """Unit vectors (n, 3) in cam towards the star at angles (n, k)."""
        on_table = self.table.rotation(angle_rad).inv().apply(self.star.copy())
        return np.asarray(self.installation.apply(on_table))

    def cam_from_lab(self, angle_rad: ArrayLike) -> FloatArray:
        """Matrices (n, 3, 3) from the laboratory to cam at angles (n, k)."""
        turn = self.table.rotation(angle_rad).as_matrix()
        return np.asarray(self.installation.as_matrix() @ np.swapaxes(turn, 1, 2))


def star_direction(azimuth_deg: ArrayLike, elevation_deg: ArrayLike) -> FloatArray:
    """Unit vectors (..., 3) in the laboratory: +Z at azimuth 0, azimuth towards +X, elevation towards +Y.

    The part of FISHER23 eq. 1, whose print does not show the order of its axes.
    """
    azimuth, elevation = (np.asarray(v, float) * DEG_RAD for v in (azimuth_deg, elevation_deg))
    azimuth, elevation = np.broadcast_arrays(azimuth, elevation)
    level = np.cos(elevation)
    return np.stack([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level], axis=-1)


def star_angles_deg(direction: ArrayLike) -> FloatArray:
    """Azimuth and elevation (..., 2) [deg] of directions (..., 3); the inverse of `star_direction`."""
    v = np.asarray(direction, float)
    azimuth = np.arctan2(v[..., 0], v[..., 2])
    elevation = np.arctan2(v[..., 1], np.hypot(v[..., 0], v[..., 2]))
    return np.stack([azimuth, elevation], axis=-1) * RAD_DEG


def aiming_angles(bench: StarBench, wanted_cam: FloatArray, roll_rad: FloatArray) -> FloatArray:
    """Angles (n, k) of the table that put the star at directions (n, 3) in cam.

    Newton's method on the outer two axes; a third, inner axis stands at ``roll_rad`` (n,). `DomainError` if the table
    cannot reach a direction.
    """
    table, count = bench.table, len(bench.table.axis)
    on_table = bench.installation.inv().apply(wanted_cam)
    angle = np.zeros((len(wanted_cam), count))
    if count == 3:
        angle[:, 2] = roll_rad
    off = np.full(len(wanted_cam), np.inf)
    for _ in range(AIM_STEPS):
        now = table.rotation(angle).apply(on_table)
        off = np.linalg.norm(bench.star - now, axis=1)
        if off.max() < AIM_TOLERANCE_RAD:
            return angle
        motion = np.cross(table.angle_rates(angle)[:, :2], now[:, None])  # (n, 2, 3): of the star, per radian
        step = (np.linalg.pinv(np.swapaxes(motion, 1, 2), rcond=1e-6) @ (bench.star - now)[..., None])[..., 0]
        longest = np.abs(step).max(1, keepdims=True)
        angle[:, :2] += step * np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(longest, 1e-300))
    at = int(np.argmax(off))
    raise DomainError(
        f"the table cannot turn the camera so that the star appears at place {at}: the closest approach is "
        f"{np.degrees(off[at]):.3g} deg; at zero angles the star should be near the camera's axis and perpendicular "
        "to the outer two axes"
    )


def direction_by_angle(bench: StarBench, angle_rad: FloatArray) -> FloatArray:
    """Derivative by an angle of the direction in cam: (n, k, 3) per radian.

    From v = M R^T s and dR = [w x] R: dv = -M R^T (w x s).
    """
    return _by_rates(bench, angle_rad, bench.table.angle_rates(angle_rad))


def direction_by_lean(bench: StarBench, angle_rad: FloatArray) -> FloatArray:
    """Derivative by a non-orthogonality of the direction in cam: (n, k - 1, 3) per radian."""
    return _by_rates(bench, angle_rad, bench.table.lean_rates(angle_rad))


def _by_rates(bench: StarBench, angle_rad: FloatArray, rates: FloatArray) -> FloatArray:
    return np.asarray(np.cross(bench.star, rates) @ np.swapaxes(bench.cam_from_lab(angle_rad), 1, 2))


def reading_covariance_px2(model: CameraModel, bench: StarBench, angle_rad: FloatArray) -> FloatArray:
    """Covariance on the detector by the reading noise of the table, (n, 2, 2) [px^2]."""
    by_direction = model.project_jacobian(bench.star_in_cam(angle_rad)).by_direction
    shift = by_direction @ np.swapaxes(direction_by_angle(bench, angle_rad), 1, 2)
    sigma = bench.table.reading_noise_arcsec * ARCSEC_RAD
    return np.asarray((shift * sigma**2) @ np.swapaxes(shift, 1, 2))


def design_matrix(model: CameraModel, bench: StarBench, angle_rad: FloatArray, *, leans: bool) -> FloatArray:
    """Derivatives (n, 2, q) of the image by all unknowns of the joint calibration, in the order of `unknown_names`."""
    direction = bench.star_in_cam(angle_rad)
    projection = model.project_jacobian(direction)
    (azimuth, elevation), theta = star_angles_deg(bench.star) * DEG_RAD, angles_of_rotation(bench.installation)
    across = np.array(  # derivatives of the star's direction by azimuth and elevation
        [
            [np.cos(azimuth) * np.cos(elevation), 0.0, -np.sin(azimuth) * np.cos(elevation)],
            [-np.sin(azimuth) * np.sin(elevation), np.cos(elevation), -np.cos(azimuth) * np.sin(elevation)],
        ]
    )
    turns = increment_per_angle(theta).T  # rotation vectors in cam, per angle of the installation
    moves = [np.swapaxes(bench.cam_from_lab(angle_rad) @ across.T, 1, 2), np.cross(turns[None], direction[:, None])]
    if leans:
        moves.append(direction_by_lean(bench, angle_rad))
    by_pose = projection.by_direction @ np.swapaxes(np.concatenate(moves, axis=1), 1, 2)
    return np.concatenate([projection.by_parameter, by_pose], axis=2)


def unknown_names(model: CameraModel, bench: StarBench, *, leans: bool) -> tuple[str, ...]:
    """Unknowns of the joint calibration as `calib.calibration.turntable` names them."""
    return (
        *model.parameter_names,
        *("star_azimuth_rad", "star_elevation_rad", "theta1_rad", "theta2_rad", "theta3_rad"),
        *(f"lean{i + 1}_rad" for i in range(len(bench.table.axis) - 1) if leans),
    )


def true_unknowns(model: CameraModel, bench: StarBench, *, leans: bool) -> FloatArray:
    """Values of `unknown_names` for a camera and a bench."""
    angles = star_angles_deg(bench.star) * DEG_RAD, angles_of_rotation(bench.installation)
    lean = bench.table.non_orthogonality_arcsec * ARCSEC_RAD
    return np.concatenate([model.parameters, *angles, lean if leans else lean[:0]])


def star_vector_by_pixel(model: CameraModel, bench: StarBench, angle_rad: FloatArray) -> FloatArray:
    """Derivatives (n, 2, 2) of star vectors, on the plane tangent at the star, by the image [rad/px]."""
    direction = bench.star_in_cam(angle_rad)
    by_pixel = unproject_jacobian(model, model.project(direction)).by_pixel
    return np.asarray(tangent_basis(bench.star) @ np.swapaxes(bench.cam_from_lab(angle_rad), 1, 2) @ by_pixel)


def clock_covariance_px2(
    model: CameraModel, bench: StarBench, angle_rad: FloatArray, rate_rad_per_s: float, jitter_s: float
) -> FloatArray:
    """Covariance on the detector (n, 2, 2) [px^2] by the jitter between the clocks of the camera and of the table.

    The second axis (the inner one of two) turns at the rate; an image that is taken a time dt off moves by the image's
    derivative by that axis, times rate dt.
    """
    by_direction = model.project_jacobian(bench.star_in_cam(angle_rad)).by_direction
    by_axis = (by_direction @ direction_by_angle(bench, angle_rad)[:, 1, :, None])[..., 0]
    shift = by_axis * (abs(rate_rad_per_s) * jitter_s)
    return np.asarray(shift[:, :, None] * shift[:, None, :])


def star_vectors(model: CameraModel, bench: StarBench, pixel_px: ArrayLike, angle_rad: ArrayLike) -> FloatArray:
    """Star vectors (n, 3) of images in the frame of the table at zero angles (FISHER23, S300)."""
    turn = bench.table.rotation(angle_rad)
    return initial_frame_vectors(model, pixel_px, installation=bench.installation, table_rotation=turn)


def residual_px(model: CameraModel, bench: StarBench, pixel_px: ArrayLike, angle_rad: ArrayLike) -> FloatArray:
    """Images (n, 2) minus the star as a camera and a bench put it."""
    return np.asarray(np.asarray(pixel_px, float) - model.project(bench.star_in_cam(angle_rad)))


def design_star_last(model: CameraModel, bench: StarBench, angle_rad: FloatArray) -> FloatArray:
    """`design_matrix` (n, 2, q) with leans unknown and the star's two direction angles last, which enter no vector."""
    return design_matrix(model, bench, angle_rad, leans=True)[:, :, star_last(unknown_names(model, bench, leans=True))]


def star_last(names: tuple[str, ...]) -> list[int]:
    """Order of unknowns that puts the star's two direction angles last."""
    star = [names.index(name) for name in ("star_azimuth_rad", "star_elevation_rad")]
    return [i for i in range(len(names)) if i not in star] + star
