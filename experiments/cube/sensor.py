"""Step 1: calibration of the sun sensor against the table, R_sr, by turning the table over its field (CUBE09, step 1).

The method of patent 200510112553.7 as in `calib.calibration.turntable`: hole against detector, mask distance, sensor
against table, direction of the beam and, optionally, the table's axes are fitted together to the spots of all
positions. As published, the simulator is taken as aligned: its beam lies along the Z axis of the table at zero, which
conditions the solution.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.spatial.transform import Rotation

from calib.attitude.link import increment_per_angle, rotation_of_angles
from calib.calibration.calibrate import calibrate
from calib.calibration.observations import Observations
from calib.calibration.turntable import INSTALLATION_NAMES, STAR_NAMES, TableErrors, TurntableAttitudes
from calib.cameras import BrownConrady, SensorGeometry
from calib.fitting.solution import Solution
from experiments.cube.bench import Laboratory, Truth
from experiments.cube.settings import Config
from experiments.laboratory.devices.turntable import Turntable
from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.units import DEG_RAD
from render.bench.sensor import MaskSensor, mask_scene, trace_mask
from render.detector.diffusion import diffusion_kernel
from render.detector.readout import expose_windows
from render.detector.spec import Detector
from render.engine.random import Streams

FREE = ("x0_px", "y0_px", "focal_length_mm")
LEAN_NAME = "lean_rad"
EXPOSURE_S = 0.01
CENTROID_SIGMA_PX = 0.05
"""Stated for all spots alike; the errors of the fit are scaled to its residual scatter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorRun:
    """Spots measured at the positions of the table."""

    angle_rad: FloatArray  # (n, 2) True angles of the table
    pixel_px: FloatArray  # (n, 2) Measured spots
    true_px: FloatArray  # (n, 2) Where geometry puts them
    stamp: FloatArray  # (h, w) One window, electrons, for the report


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorCalibration:
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


def field_angles(config: Config) -> FloatArray:
    """Commanded angles (n, 2) [rad]: a square grid."""
    edge = np.linspace(-config.sensor.field_deg, config.sensor.field_deg, config.sensor.grid) * DEG_RAD
    outer, inner = np.meshgrid(edge, edge, indexing="ij")
    return np.column_stack([outer.ravel(), inner.ravel()])


def observe_spots(laboratory: Laboratory, truth: Truth, table: Turntable, streams: Streams) -> SensorRun:
    """Turn the table over the field and measure the spot at each position."""
    config = laboratory.config.sensor
    detector = own_detector(laboratory, truth)
    angle = table.set(field_angles(laboratory.config), streams)
    sun = table.rotation(angle).inv().apply([0.0, 0.0, 1.0]) @ truth.sensor_from_table.T
    true_px = truth.sensor.spot_px(sun)
    corner = np.rint(true_px).astype(np.int64) - config.window_px // 2
    _check_windows(truth.sensor, corner, config.window_px)
    light = trace_mask(
        mask_scene(truth.sensor),
        truth.sensor,
        sun,
        corner,
        config.window_px,
        half_angle_rad=laboratory.geometry.half_angle_rad,
        log2_particles=config.log2_particles,
        seed=streams.key("particles") >> 1,
    )
    stack = expose_windows(
        diffused(light, detector.diffusion_sigma_px) * config.plateau_e,
        corner,
        detector,
        streams=streams,
        frames=config.frames,
        exposure_s=EXPOSURE_S,
    )
    electrons = (stack.dn.astype(np.float64).mean(0) - stack.offset_dn) / stack.gain_dn_per_e
    middle = len(sun) // 2
    return SensorRun(
        angle_rad=angle, pixel_px=centre_of_light(electrons) + corner, true_px=true_px, stamp=electrons[middle]
    )


def own_detector(laboratory: Laboratory, truth: Truth) -> Detector:
    """The detector of this bench's sensor: a chip of its own, or one fixed pattern would shift the spots of all benches
    alike."""
    seed = laboratory.streams.child("bench", truth.number).key("sun sensor chip") >> 1
    return replace(laboratory.sensor_detector, sensor_seed=seed)


def diffused(windows: NDArray[np.float32], sigma_px: float) -> FloatArray:
    """Charge diffusion on all windows (n, h, w) at once; what `render.detector.diffusion.diffuse` does to one image."""
    kernel = diffusion_kernel(sigma_px)
    rows = correlate1d(windows.astype(np.float64), kernel, axis=1, mode="reflect")
    return np.asarray(correlate1d(rows, kernel, axis=2, mode="reflect"))


def _check_windows(sensor: MaskSensor, corner: NDArray[np.int64], size: int) -> None:
    limit = np.array([sensor.width_px, sensor.height_px]) - size
    if np.any(corner < 0) or np.any(corner > limit):
        raise DomainError(
            f"a spot of the sun sensor leaves its detector of {sensor.width_px} x {sensor.height_px} px; make "
            "sensor.field_deg or sensor.gap_mm smaller"
        )


def centre_of_light(electrons: FloatArray) -> FloatArray:
    """First moments (n, 2) of windows (n, h, w) above their border; (column, row) in the window."""
    border = np.concatenate([electrons[:, 0], electrons[:, -1], electrons[:, 1:-1, 0], electrons[:, 1:-1, -1]], axis=1)
    light = electrons - border.mean(axis=1)[:, None, None]
    total = light.sum((1, 2))
    column, row = np.arange(light.shape[2]), np.arange(light.shape[1])
    return np.column_stack([(light.sum(1) * column).sum(1), (light.sum(2) * row).sum(1)]) / total[:, None]


def fit_sensor(
    config: Config, pixel_px: FloatArray, reading_rad: FloatArray, table: Turntable, sensor: MaskSensor, *, free: bool
) -> SensorCalibration:
    """Joint fit to spots."""
    nominal = table.nominal
    geometry = SensorGeometry(width_px=sensor.width_px, height_px=sensor.height_px, pixel_pitch_mm=sensor.pitch_mm)
    count = len(pixel_px)
    observations = Observations.isotropic(
        pixel_px=pixel_px,
        direction=np.tile([0.0, 0.0, 1.0], (count, 1)),
        frame=np.arange(count),
        sigma_px=CENTROID_SIGMA_PX,
    )
    errors = TableErrors()
    if free:
        errors = TableErrors(axis_rate=nominal.lean_rates(reading_rad), axis_names=(LEAN_NAME,))
    calibration = calibrate(
        observations,
        BrownConrady.create(geometry, focal_length_mm=config.sensor.gap_mm),
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
    value, covariance = _held(solution, value, covariance, STAR_NAMES, np.zeros(2))
    return _packed(solution, value, covariance, reading_rad, sigma_px=float(np.sqrt(noise)) * CENTROID_SIGMA_PX)


def _held(
    solution: Solution, value: FloatArray, covariance: FloatArray, names: tuple[str, ...], held: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Solution given that some unknowns are known: conditional mean and covariance of a normal distribution."""
    at = [solution.index(name) for name in names]
    gain = covariance[:, at] @ np.linalg.inv(covariance[np.ix_(at, at)])
    new = value - gain @ (value[at] - held)
    spread = covariance - gain @ covariance[at]
    spread[at], spread[:, at] = 0.0, 0.0
    return new, spread


def _packed(
    solution: Solution, value: FloatArray, covariance: FloatArray, reading_rad: FloatArray, *, sigma_px: float
) -> SensorCalibration:
    at = [solution.index(name) for name in INSTALLATION_NAMES]
    theta = value[at]
    turn = increment_per_angle(theta)
    stars = [solution.index(name) for name in STAR_NAMES]
    scale = sigma_px / CENTROID_SIGMA_PX
    lean = solution.names.index(LEAN_NAME) if LEAN_NAME in solution.names else None
    return SensorCalibration(
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


def calibrate_sensor(
    laboratory: Laboratory, truth: Truth, table: Turntable, run: SensorRun, streams: Streams, *, free: bool
) -> SensorCalibration:
    """Read the table at the positions of a run, and fit."""
    reading = table.read(run.angle_rad, streams)
    return fit_sensor(laboratory.config, run.pixel_px, reading, table, truth.sensor, free=free)
