"""Temporal error of a star camera (ACC18 eq. 1-2): measured on frames of a static target, predicted without frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.error_budget import ErrorTerm
from calib.accuracy.temporal import expected_temporal_error, temporal_error
from calib.measure.centroid_error.expected_windows import bound_px as cramer_rao_px
from calib.measure.centroid_error.expected_windows import drawn_positions, followed_px, window_response
from calib.measure.statistics.frame_positions import common_motion_px2
from experiments.laboratory.bench.point_bench import Bench, centroiders, motion_method, one_filter
from experiments.laboratory.bench.points import PointLight, PointScene, read_points, scene_of
from experiments.laboratory.bench.ray_prediction import bundle_prediction, target_windows
from experiments.laboratory.bench.readout.frames import nominal_noise
from experiments.laboratory.devices.target import target_directions
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.records import EffectivePsf
from render.sensor_file.instrument import Instrument


@dataclass(frozen=True, slots=True, kw_only=True)
class TemporalMeasurement:
    """Scatter of the centroids at l signal levels, j stars."""

    levels_e: FloatArray  # (l,) Electrons per star and frame
    frames: int  # N of each level
    pixel_arcsec: float  # Angle of a pixel
    sigma_px: Mapping[str, FloatArray]  # (l, j, 2) Standard deviation of a frame's centroid, by method
    light: PointLight  # The target as rendered, at the signal of the bench
    position_px: Mapping[str, FloatArray]  # (l, f, j, 2) Centroids, dark-subtracted
    motion_px2: FloatArray  # (l, 2, 2) Motion common to the stars (`common_motion_px2`)

    def temporal_error(self, method: str, level: int = 0) -> ErrorTerm:
        """Temporal error at a level, 3 sigma."""
        return temporal_error(self.sigma_px[method][level], self.pixel_arcsec, self.frames)


@dataclass(frozen=True, slots=True, kw_only=True)
class TemporalPrediction:
    """Expected standard deviations of a frame's centroid, motion of the line of sight included."""

    levels_e: FloatArray  # (l,) Electrons per star and frame
    pixel_arcsec: float  # Angle of a pixel
    linear_px: Mapping[str, FloatArray]  # (l, j, 2) By the linear response of the centroid to pixels
    sampled_px: Mapping[str, FloatArray]  # (l, j, 2) By noise drawn on noiseless windows
    draws: int  # Monte-Carlo samples per window of ``sampled_px``
    device_px: Mapping[str, FloatArray]  # (l, j, 2) Scatter of the standard deviation from detector to detector
    # (l, j, 2) Motion of the line of sight as the centroid follows it (`followed_px`)
    common_px: Mapping[str, FloatArray]
    bound_px: FloatArray  # (l, j, 2) Cramer-Rao bound
    frames: int  # N of each level

    def arcsec(self, sigma_px: FloatArray) -> FloatArray:
        """Temporal error (2,), 3 sigma, of standard deviations (j, 2)."""
        return np.asarray(3.0 * self.pixel_arcsec * sigma_px.mean(0))

    def sampled_error(self, method: str, level: int = 0) -> ErrorTerm:
        """Temporal error at a level by sampled noise; uncertainty: samples, detectors, motion of the line of sight."""
        return expected_temporal_error(
            self.sampled_px[method][level],
            self.pixel_arcsec,
            self.frames,
            chip_px=self.device_px[method][level],
            common_px=self.common_px[method][level],
            draws=self.draws,
        )


def star_target_directions(bench: Bench, instrument: Instrument, place_px: Sequence[float] | None = None) -> FloatArray:
    """Unit vectors (j, 3) in the camera frame of the multi-star target, by default at the centre of chip one."""
    detector = instrument.detector
    centre = ((detector.chip_width_px - 1) / 2, (detector.chip_height_px - 1) / 2)
    return target_directions(bench.target, instrument, np.asarray(centre if place_px is None else place_px, float))


def measure_temporal(
    bench: Bench,
    instrument: Instrument,
    *,
    levels_e: Sequence[float] | FloatArray | None = None,
    place_px: Sequence[float] | None = None,
    streams: Streams,
    scene: PointScene | None = None,
    advance: Callable[[], None] = lambda: None,
) -> TemporalMeasurement:
    """Frames of a static target at several signal levels, as ACC18 section 1.2.

    The target is at rest: its points are detected once, at the signal of the bench, and only the brightness changes.
    """
    scene = scene_of(scene, bench, instrument)
    bench = scene.bench
    light = scene.light(star_target_directions(bench, instrument, place_px), streams, "target")
    levels = np.array([bench.signal_e] if levels_e is None else levels_e, float)
    frames = []
    for number, level in enumerate(levels):
        level_streams = streams.child("level", number)
        signal_ratio = float(level / bench.signal_e)
        frames.append(read_points(light, bench, instrument, streams=level_streams, signal_ratio=signal_ratio))
        advance()
    return TemporalMeasurement(
        levels_e=levels,
        frames=bench.frames,
        pixel_arcsec=instrument.pixel_arcsec,
        sigma_px={m: np.stack([level.sigma_px(m) for level in frames]) for m in bench.methods},
        light=light,
        position_px={m: np.stack([level.position_px[m] for level in frames]) for m in bench.methods},
        motion_px2=np.stack([common_motion_px2(level.position_px[motion_method(bench.methods)]) for level in frames]),
    )


def predict_temporal(
    bench: Bench,
    instrument: Instrument,
    *,
    psf: Sequence[EffectivePsf],
    levels_e: Sequence[float] | FloatArray | None = None,
    place_px: Sequence[float] | None = None,
    draws: int = 100,
    defect: NDArray[np.bool_] | None = None,
    seed: int = 0,
) -> TemporalPrediction:
    """`measure_temporal` without frames: PSFs, traced positions, the detector's data sheet."""
    bench = one_filter(bench)
    direction = star_target_directions(bench, instrument, place_px)[None]
    levels = np.array([bench.signal_e] if levels_e is None else levels_e, float)
    pixel = instrument.pixel_noise()
    noise_model = nominal_noise(instrument)
    rng = Streams(seed).generator("temporal prediction")
    motion_px = bench.power_px2(instrument)[0] ** 0.5
    position = bundle_prediction(bench, instrument, direction)[:, :, bench.reference]
    bound_px = []
    linear_px: dict[str, list[FloatArray]] = {method: [] for method in bench.methods}
    sampled_px: dict[str, list[FloatArray]] = {method: [] for method in bench.methods}
    device_px: dict[str, list[FloatArray]] = {method: [] for method in bench.methods}
    common_px: dict[str, list[FloatArray]] = {method: [] for method in bench.methods}
    for level in levels:
        level_bench = replace(bench, signal_e=float(level))
        windows = target_windows(level_bench, instrument, direction, psf, position, defect=defect)
        bound_px.append(np.hypot(cramer_rao_px(windows, pixel.floor_e2), motion_px))
        for method, centroider in centroiders(bench, psf).items():
            response = window_response(centroider, windows, noise_model)
            linear = sampled = response.sigma_px(pixel.temporal_e2(windows.light_e))
            if draws >= 2:
                drawn = drawn_positions(centroider, windows, noise_model, pixel, draws=draws, rng=rng)
                sampled = np.nanstd(drawn, axis=0, ddof=1)
            common = followed_px(centroider, windows, noise_model, motion_px)
            linear_px[method].append(np.hypot(linear, common))
            sampled_px[method].append(np.hypot(sampled, common))
            device_px[method].append(response.device_sigma_px(windows.light_e, pixel))
            common_px[method].append(common)
    return TemporalPrediction(
        levels_e=levels,
        pixel_arcsec=instrument.pixel_arcsec,
        linear_px=_stacked(linear_px),
        sampled_px=_stacked(sampled_px),
        draws=draws,
        device_px=_stacked(device_px),
        common_px=_stacked(common_px),
        bound_px=np.stack(bound_px),
        frames=bench.frames,
    )


def _stacked(levels: Mapping[str, list[FloatArray]]) -> dict[str, FloatArray]:
    return {method: np.stack(values) for method, values in levels.items()}
