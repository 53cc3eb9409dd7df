"""Distortion error (ACC18 section 1.4.2) measured: a surveyed grid target, frames, residuals, polynomial, map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from calib.accuracy.distortion import (
    DistortionStatistics,
    Reference,
    deleted_rms_px,
    distortion_statistics,
    grid_residual_px,
    map_error_px,
)
from experiments.laboratory.bench.point_bench import Bench, one_filter
from experiments.laboratory.bench.points import PointLight, PointScene, nominal_px, read_points, scene_of
from experiments.laboratory.bench.ray_prediction import bundle_prediction
from experiments.laboratory.devices.target import grid_directions, survey
from experiments.laboratory.settings.tables import GridTargetConfig
from optics.arrays import FloatArray
from optics.records import freeze_all
from render.engine.random import Streams
from render.sensor_file.instrument import Instrument

SESSIONS = ("earlier", "test")
"""The camera model of "calibrated" comes from the earlier session."""


def grid_position(instrument: Instrument, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nominal pixels (n, 2) of directions (n, 3), and the same from the centre in units of half the diagonal."""
    camera = instrument.camera
    nominal = nominal_px(instrument, direction)
    return nominal, (nominal - camera.centre_px) / (0.5 * np.hypot(camera.width_px, camera.height_px))


@dataclass(frozen=True, slots=True, kw_only=True)
class DistortionMeasurement:
    """Frames of a grid target of n points, reduced."""

    instrument: Instrument  # The camera
    order: int  # Of the polynomial
    frames: int  # N of each session
    direction: FloatArray  # (n, 3) True directions of the points
    surveyed: FloatArray  # (q, n, 3) Directions by q surveys before the test; statistics use the first by default
    session_px: Mapping[str, FloatArray]  # (2, n, 2) Mean centroids of `SESSIONS` by method
    sigma_px: Mapping[str, FloatArray]  # (n, 2) Standard deviation of a single frame's centroid
    light: PointLight  # The target as rendered, with truth

    def __post_init__(self) -> None:
        freeze_all(self, direction=("n", 3), surveyed=("q", "n", 3))

    @property
    def arcsec_3sigma(self) -> float:
        """Factor from px, 1 sigma, to arcsec, 3 sigma."""
        return 3.0 * self.instrument.pixel_arcsec

    def statistics(self, method: str, reference: Reference, copy: int = 0) -> DistortionStatistics:
        """Numbers of ACC18 with one survey of the target."""
        nominal, position = grid_position(self.instrument, self.surveyed[copy])
        earlier, test = self.session_px[method]
        d_px, _ = grid_residual_px(nominal, position, earlier, test, reference)
        return distortion_statistics(position, d_px, self.order)

    def over_surveys(self, method: str, reference: Reference) -> FloatArray:
        """sigma_d, sigma_Dd and sigma_C1 (q, 3, 2) [px] of the same frames with every survey."""
        return np.stack([self.statistics(method, reference, copy).sigma_px for copy in range(len(self.surveyed))])

    def deleted_rms_px(self, method: str, reference: Reference) -> FloatArray:
        """RMS of deleted residuals (2, 2) per axis, by point and by row or column, of the first survey."""
        nominal, position = grid_position(self.instrument, self.surveyed[0])
        return deleted_rms_px(position, self.session_px[method][1] - nominal, self.order, reference)

    def map_error_px(
        self, method: str, reference: Reference, field_position: FloatArray, field_offset_px: FloatArray
    ) -> FloatArray:
        """True error (q, m, 2) of the correction of every survey at m field points (`map_error_px`)."""
        errors = []
        earlier, test = self.session_px[method]
        for surveyed in self.surveyed:
            nominal, position = grid_position(self.instrument, surveyed)
            d_px, camera_px = grid_residual_px(nominal, position, earlier, test, reference)
            errors.append(
                map_error_px(
                    field_position,
                    field_offset_px,
                    camera_px=camera_px,
                    polynomial_px=distortion_statistics(position, d_px, self.order).coefficient_px,
                    reference=reference,
                    order=self.order,
                )
            )
        return np.stack(errors)


def dense_grid(instrument: Instrument, rows: int, columns: int) -> FloatArray:
    """Unit vectors (rows * columns, 3) in cam that an ideal lens images on a grid over the whole detector."""
    camera = instrument.camera
    x, y = np.meshgrid(np.linspace(0, camera.width_px - 1, columns), np.linspace(0, camera.height_px - 1, rows))
    # corners lie just beyond the field of the lens, where the chief ray is traced too
    return camera.nominal_direction(x, y, instrument.focal_length_mm).reshape(-1, 3)


def traced_bundles(bench: Bench, instrument: Instrument, direction: FloatArray) -> FloatArray:
    """Photon-weighted bundle means (n, 2) [px] through the bench's reference filter, by the NumPy trace."""
    reference_bench = one_filter(bench)
    chunks = np.array_split(direction, -(-len(direction) // 64))  # bounds the memory
    return np.concatenate([bundle_prediction(reference_bench, instrument, chunk[None])[0, :, 0] for chunk in chunks])


def measure_distortion(
    bench: Bench,
    instrument: Instrument,
    target: GridTargetConfig,
    *,
    order: int = 3,
    surveys: int = 1,
    streams: Streams,
    scene: PointScene | None = None,
    advance: Callable[[], None] = lambda: None,
) -> DistortionMeasurement:
    """Frames of a static grid target in two sessions (`SESSIONS`)."""
    scene = scene_of(scene, bench, instrument)
    bench = scene.bench
    direction = grid_directions(target, instrument, streams)
    light = scene.light(direction, streams, "grid")
    sessions: dict[str, list[FloatArray]] = {method: [] for method in bench.methods}
    sigma: dict[str, FloatArray] = {}
    for session in SESSIONS:
        frames = read_points(light, bench, instrument, streams=streams.child(session))
        for method in bench.methods:
            sessions[method].append(frames.mean_px(method))
            sigma[method] = frames.sigma_px(method)
        advance()
    return DistortionMeasurement(
        instrument=instrument,
        order=order,
        frames=bench.frames,
        direction=direction,
        surveyed=survey(target, direction, streams.generator("survey"), copies=surveys),
        session_px={method: np.stack(mean_px) for method, mean_px in sessions.items()},
        sigma_px=sigma,
        light=light,
    )
