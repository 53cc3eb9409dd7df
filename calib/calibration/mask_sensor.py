"""Calibration of an aperture-mask sun sensor against a turntable, R_sr (CUBE09, step 1).

The method of patent 200510112553.7 as in `calib.calibration.turntable`: hole against detector, mask distance, sensor
against table, direction of the beam and, optionally, the table's axes are fitted together to the spots of all
positions. As published, the simulator is taken as aligned: its beam lies along the Z axis of the table at zero, which
conditions the solution. The sensor is a pinhole camera whose focal length is the distance from mask to detector.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calib.attitude.euler_angles import increment_per_angle, rotation_of_angles
from calib.calibration.calibrate import calibrate
from calib.calibration.observations import Observations
from calib.calibration.table_axes import TableAxes
from calib.calibration.turntable import INSTALLATION_NAMES, STAR_NAMES, TableErrors, TurntableAttitudes
from calib.cameras import BrownConrady, SensorGeometry
from calib.fitting.normal_errors import conditioned
from calib.fitting.solution import Solution
from optics.arrays import FloatArray
from optics.errors import ConvergenceError
from optics.units import ARCSEC_RAD, RAD_ARCSEC

FREE = ("x0_px", "y0_px", "focal_length_mm")
LEAN_NAME = "lean_rad"
NOMINAL_CUBE = np.diag([-1.0, 1.0, -1.0])
"""Table from cube as designed: the cube's Z looks backwards, its X against the table's."""
CENTROID_SIGMA_PX = 0.05
"""Stated for all spots alike; the errors of the fit are scaled to its residual scatter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MaskSensorCalibration:
    """Calibrated rotation R_sr."""

    rotation: Rotation  # Sensor from table
    covariance_rad2: FloatArray  # (3, 3) Of the error's rotation vector in the sensor frame
    # (2,) Azimuth and elevation of the beam that the fit would find if it were not held: should be zero within its
    # errors
    free_beam_rad: FloatArray
    free_beam_sigma_rad: FloatArray
    lean_rad: float  # Fitted non-orthogonality of the axes, 0 where it was not fitted
    lean_sigma_rad: float  # Its standard deviation
    lean_cross_rad2: FloatArray  # (3,) Its covariance with the error of R_sr
    sigma_px: float  # Scatter of the spots about the fit, per axis
    focal_length_mm: float  # Mask distance
    offset_px: FloatArray  # (2,) Foot of the hole
    reading_rad: FloatArray  # (n, 2) Readings of the table that it was fitted to


def calibrate_mask_sensor(
    geometry: SensorGeometry,
    gap_mm: float,
    pixel_px: FloatArray,
    reading_rad: FloatArray,
    table: TableAxes,
    *,
    fit_non_orthogonality: bool = False,
) -> MaskSensorCalibration:
    """Joint fit to the spots (n, 2) [px] of all positions of the table, with its readings (n, 2) [rad].

    ``gap_mm`` is the start of the distance from mask to detector. The axes of the table are taken as orthogonal;
    with ``fit_non_orthogonality`` the angle is fitted. `ConvergenceError` if the spots do not determine the sensor.
    """
    nominal = table.nominal
    count = len(pixel_px)
    observations = Observations.isotropic(
        pixel_px=pixel_px,
        direction=np.tile([0.0, 0.0, 1.0], (count, 1)),
        frame=np.arange(count),
        sigma_px=CENTROID_SIGMA_PX,
    )
    errors = TableErrors()
    if fit_non_orthogonality:
        errors = TableErrors(axis_rate=nominal.lean_rates(reading_rad), axis_names=(LEAN_NAME,))
    calibration = calibrate(
        observations,
        BrownConrady.create(geometry, focal_length_mm=gap_mm),
        TurntableAttitudes(table_rotation=nominal.rotation(reading_rad), errors=errors),
        free=FREE,
    )
    solution = calibration.solution
    if solution.status not in ("converged", "refuted"):  # the noise is estimated from the residuals
        raise ConvergenceError(
            f"the sun sensor could not be calibrated against the table: {solution.message}; "
            "widen sensor.field_deg or take more positions (sensor.grid)"
        )
    noise = max(solution.reduced_chi2, 1e-12)
    value, covariance = np.array(solution.value), np.array(solution.covariance) * noise
    value, covariance = conditioned(value, covariance, [solution.index(name) for name in STAR_NAMES], np.zeros(2))
    return _packed(solution, value, covariance, reading_rad, sigma_px=float(np.sqrt(noise)) * CENTROID_SIGMA_PX)


def _packed(
    solution: Solution, value: FloatArray, covariance: FloatArray, reading_rad: FloatArray, *, sigma_px: float
) -> MaskSensorCalibration:
    at = [solution.index(name) for name in INSTALLATION_NAMES]
    theta = value[at]
    turn = increment_per_angle(theta)
    stars = [solution.index(name) for name in STAR_NAMES]
    scale = sigma_px / CENTROID_SIGMA_PX
    lean = solution.names.index(LEAN_NAME) if LEAN_NAME in solution.names else None
    return MaskSensorCalibration(
        rotation=rotation_of_angles(theta),
        covariance_rad2=turn @ covariance[np.ix_(at, at)] @ turn.T,
        free_beam_rad=solution.value[stars],
        free_beam_sigma_rad=solution.sigma[stars] * scale,
        lean_rad=0.0 if lean is None else float(value[lean]),
        lean_sigma_rad=0.0 if lean is None else float(np.sqrt(covariance[lean, lean])),
        lean_cross_rad2=np.zeros(3) if lean is None else turn @ covariance[at, lean],
        sigma_px=sigma_px,
        focal_length_mm=float(value[solution.index("focal_length_mm")]),
        offset_px=value[[solution.index("x0_px"), solution.index("y0_px")]],
        reading_rad=reading_rad,
    )


def mask_sensor_noise(
    table: TableAxes, angle_rad: FloatArray, spot_px2: FloatArray, per_rad_px: float, *, fit_non_orthogonality: bool
) -> FloatArray:
    """Covariance (3, 3) of what R_sr, and a fitted squareness, do to R_sp: rotation vector in the cube frame [rad^2].

    Noise of spots and readings is propagated through the least squares of a pinhole on a table by finite differences;
    the cube stands as designed, its Z backwards, its X against the table's.

    Shapes: ``angle_rad`` (n, 2), ``spot_px2`` (n,) variance of a spot per axis; ``per_rad_px`` is the distance from
    mask to detector over the pixel pitch.
    """
    start, step = np.zeros(7), 1e-5

    def spots(values: FloatArray, angle: FloatArray) -> FloatArray:
        return _pinhole_spots_px(table, values, angle, per_rad_px)

    by_value = [
        (spots(start + step * unit, angle_rad) - spots(start - step * unit, angle_rad)) / (2 * step)
        for unit in np.eye(7)[: 7 if fit_non_orthogonality else 6]
    ]
    to_value = np.linalg.pinv(np.stack(by_value, axis=-1).reshape(2 * len(angle_rad), -1))
    noise = np.diag(np.repeat(spot_px2, 2))
    for axis, sigma in zip(np.eye(2), table.reading_noise_arcsec * ARCSEC_RAD, strict=True):
        moved = (spots(start, angle_rad + step * axis) - spots(start, angle_rad)) / step * sigma
        for k, pair in enumerate(moved):
            noise[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += np.outer(pair, pair)
    covariance = to_value @ noise @ to_value.T
    # a squareness that is assumed too large turns R_pr about z: the second face takes all of it
    effect = np.column_stack([-NOMINAL_CUBE, [0.0, 0.0, -1.0]]) if fit_non_orthogonality else -NOMINAL_CUBE
    return np.asarray(effect @ covariance[3:, 3:] @ effect.T)


def _pinhole_spots_px(table: TableAxes, values: FloatArray, angle_rad: FloatArray, per_rad_px: float) -> FloatArray:
    """Spots (n, 2) of a sun sensor on a table, from the middle of the detector [px]."""
    x0, y0, scale, *turn, lean = values
    leaning = replace(table, non_orthogonality_arcsec=np.array([lean * RAD_ARCSEC]))
    beam = leaning.rotation(angle_rad).inv().apply([0.0, 0.0, 1.0])
    v = Rotation.from_rotvec(turn).apply(beam)
    return np.asarray([x0, y0] + per_rad_px * (1.0 + scale) * v[:, :2] / v[:, 2:])
