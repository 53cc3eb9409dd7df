"""Step 1 of CUBE09: calibration of the sun sensor against the table, R_sr, by turning the table over its field."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.calibration.mask_sensor import MaskSensorCalibration, calibrate_mask_sensor
from calib.calibration.table_axes import TableAxes
from calib.cameras import SensorGeometry
from calib.measure.centroiding.moments import centre_of_light
from experiments.cube.bench import CubeLaboratory, TrueBench
from experiments.cube.settings import CubeMirrorConfig
from experiments.laboratory.devices.turntable import Turntable
from optics.arrays import FloatArray
from optics.units import DEG_RAD
from render.bench.pictures import mask_windows
from render.bench.sensor import MaskSensor
from render.detector.spec import Detector
from render.engine.random import Streams

EXPOSURE_S = 0.01
"""Exposure of the sun sensor."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorRun:
    """Spots measured at the positions of the table."""

    angle_rad: FloatArray  # (n, 2) True angles of the table's outer and inner axis
    pixel_px: FloatArray  # (n, 2) Measured centres of light of the spots


def field_angles(config: CubeMirrorConfig) -> FloatArray:
    """Commanded angles (n, 2) [rad]: a square grid."""
    edge = np.linspace(-config.sensor.field_deg, config.sensor.field_deg, config.sensor.grid) * DEG_RAD
    outer, inner = np.meshgrid(edge, edge, indexing="ij")
    return np.column_stack([outer.ravel(), inner.ravel()])


def observe_spots(laboratory: CubeLaboratory, truth: TrueBench, table: Turntable, streams: Streams) -> SensorRun:
    """Turn the table over the field and measure the spot at each position."""
    config = laboratory.config.sensor
    angle = table.set(field_angles(laboratory.config), streams)
    sun = table.rotation(angle).inv().apply([0.0, 0.0, 1.0]) @ truth.sensor_from_table.T
    electrons, window_origin_px = mask_windows(
        truth.sensor,
        sun,
        sensor_chip(laboratory, truth),
        window_px=config.window_px,
        half_angle_rad=laboratory.geometry.half_angle_rad,
        plateau_e=config.plateau_e,
        frames=config.frames,
        exposure_s=EXPOSURE_S,
        log2_particles=config.log2_particles,
        streams=streams,
    )
    return SensorRun(angle_rad=angle, pixel_px=centre_of_light(electrons) + window_origin_px)


def sensor_chip(laboratory: CubeLaboratory, truth: TrueBench) -> Detector:
    """Detector of a bench's sun sensor. Every bench has its own fixed pattern: a common one would bias all alike."""
    # Keys have 64 bits, seeds of a sensor 63
    seed = laboratory.streams.child("bench", truth.number).key("sun sensor chip") >> 1
    return replace(laboratory.sensor_detector, sensor_seed=seed)


def fit_sensor(
    config: CubeMirrorConfig,
    pixel_px: FloatArray,
    reading_rad: FloatArray,
    table: TableAxes,
    sensor: MaskSensor,
    *,
    fit_non_orthogonality: bool,
) -> MaskSensorCalibration:
    """Joint fit of pinhole and R_sr to the spots, on request with the non-orthogonality of the table's axes."""
    geometry = SensorGeometry(width_px=sensor.width_px, height_px=sensor.height_px, pixel_pitch_mm=sensor.pitch_mm)
    gap_mm = config.sensor.gap_mm
    return calibrate_mask_sensor(
        geometry, gap_mm, pixel_px, reading_rad, table, fit_non_orthogonality=fit_non_orthogonality
    )


def calibrate_sensor(
    laboratory: CubeLaboratory,
    truth: TrueBench,
    table: Turntable,
    run: SensorRun,
    streams: Streams,
    *,
    fit_non_orthogonality: bool,
) -> MaskSensorCalibration:
    """Fit the sensor to a run's spots, at angles as the table's encoders read them."""
    reading = table.read(run.angle_rad, streams)
    config = laboratory.config
    return fit_sensor(config, run.pixel_px, reading, table, truth.sensor, fit_non_orthogonality=fit_non_orthogonality)
