"""The truth of the camera under test, a traced lens without a camera model, and errors of calibrations against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.calibration.record import Calibration
from calib.cameras.line_of_sight import LineOfSightMap, line_of_sight_map
from experiments.laboratory.devices.turntable import Turntable
from experiments.laboratory.single_star.reduce import Data, calibrated_bench
from experiments.laboratory.single_star.setup import build_star
from experiments.turntable.settings import Config
from optics.arrays import FloatArray
from optics.frames import field_angles_deg
from optics.records import freeze_all
from optics.units import DEG_RAD
from render.sensor_file.instrument import Instrument
from render.tracing.tracer import Tracer

MAP_COLUMNS, MAP_ROWS = 33, 17
"""Points of the truth over the detector."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TracedMap:
    """Landing points of the light of m directions by ray trace, without a model."""

    direction: FloatArray  # (m, 3) Unit vectors in cam
    pixel_px: FloatArray  # (m, 2) Photon-weighted mean of the traced bundle

    def __post_init__(self) -> None:
        freeze_all(self, direction=("m", 3), pixel_px=("m", 2))


def traced_map(config: Config, instrument: Instrument) -> TracedMap:
    """The camera's truth over the whole detector, for the light of the star simulator."""
    camera = instrument.camera
    x, y = (np.linspace(0, n - 1, c) for n, c in ((camera.width_px, MAP_COLUMNS), (camera.height_px, MAP_ROWS)))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    direction = camera.nominal_direction(grid[:, 0], grid[:, 1], instrument.focal_length_mm)
    field_x, field_y = field_angles_deg(direction)
    within = np.hypot(np.tan(field_x * DEG_RAD), np.tan(field_y * DEG_RAD)) <= np.tan(
        camera.lens.max_field_deg * DEG_RAD
    )
    direction = direction[within]
    pixel = Tracer(camera).bundle_means(build_star(config, instrument).seen(direction, instrument))[:, 0]
    seen = np.isfinite(pixel).all(axis=1)
    return TracedMap(direction=direction[seen], pixel_px=pixel[seen])


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduction:
    """One calibration, judged."""

    calibration: Calibration  # As the estimator gives it
    star: FloatArray  # (3,) Direction of the star in the laboratory
    # Error against the traced lens after the best rotation, and what the covariance predicts
    line_of_sight: LineOfSightMap
    # (n, 2) Images minus what the calibration says at the angles as read, before any reading error is fitted
    residual_px: FloatArray


def judge(calibration: Calibration, data: Data, table: Turntable, traced: TracedMap) -> Reduction:
    """Set a calibration, made with ``table`` as believed, against the traced lens."""
    bench = calibrated_bench(calibration, table)
    return Reduction(
        calibration=calibration,
        star=bench.star,
        line_of_sight=line_of_sight_map(
            calibration.model, traced.direction, traced.pixel_px, covariance=calibration.covariance
        ),
        residual_px=data.pixel_px - calibration.model.project(bench.seen(data.reading_rad)),
    )
