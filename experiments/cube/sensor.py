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


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorRun:
    """Spots measured at the positions of the table."""

    angle_rad: FloatArray  # (n, 2) True angles of the table
    pixel_px: FloatArray  # (n, 2) Measured spots


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
    electrons, corner = mask_windows(
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
    return SensorRun(angle_rad=angle, pixel_px=centre_of_light(electrons) + corner)


def sensor_chip(laboratory: CubeLaboratory, truth: TrueBench) -> Detector:
    """Detector of the sun sensor of a bench; a fixed pattern common to all benches would shift all their spots
    alike."""
    seed = laboratory.streams.child("bench", truth.number).key("sun sensor chip") >> 1
    return replace(laboratory.sensor_detector, sensor_seed=seed)


def fit_sensor(
    config: CubeMirrorConfig,
    pixel_px: FloatArray,
    reading_rad: FloatArray,
    table: TableAxes,
    sensor: MaskSensor,
    *,
    free_squareness: bool,
) -> MaskSensorCalibration:
    """Joint fit to spots, on request with the squareness of the axes of the table."""
    geometry = SensorGeometry(width_px=sensor.width_px, height_px=sensor.height_px, pixel_pitch_mm=sensor.pitch_mm)
    gap_mm = config.sensor.gap_mm
    return calibrate_mask_sensor(geometry, gap_mm, pixel_px, reading_rad, table, free_lean=free_squareness)


def calibrate_sensor(
    laboratory: CubeLaboratory,
    truth: TrueBench,
    table: Turntable,
    run: SensorRun,
    streams: Streams,
    *,
    free_squareness: bool,
) -> MaskSensorCalibration:
    """Read the table at the positions of a run, and fit."""
    reading = table.read(run.angle_rad, streams)
    config = laboratory.config
    return fit_sensor(config, run.pixel_px, reading, table, truth.sensor, free_squareness=free_squareness)
