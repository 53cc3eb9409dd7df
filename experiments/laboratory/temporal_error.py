"""Temporal error of a star camera (ACC18 eq. 1-2): measured on frames of a static target, predicted without frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.error_budget import ErrorTerm
from calib.accuracy.temporal import expected_temporal_error, temporal_error
from calib.measure.centroid_error.expected_windows import bound_px, drawn_positions, followed_px, window_response
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
    sigma_px: Mapping[str, FloatArray]  # (l, j, 2) By method
    light: PointLight  # The target as rendered, at the signal of the bench
    position_px: Mapping[str, FloatArray]  # (l, f, j, 2) Centroids, dark-subtracted
    # (l, 2, 2) What the stars have in common (`calib.measure.statistics.frame_positions.common_motion_px2`)
    motion_px2: FloatArray

    def temporal_error(self, method: str, level: int = 0) -> ErrorTerm:
        """Temporal error at a level, 3 sigma."""
        return temporal_error(self.sigma_px[method][level], self.pixel_arcsec, self.frames)


@dataclass(frozen=True, slots=True, kw_only=True)
class TemporalPrediction:
    """What `TemporalMeasurement` should give."""

    levels_e: FloatArray  # (l,) Electrons per star and frame
    pixel_arcsec: float  # Angle of a pixel
    # (l, j, 2) Standard deviation of a frame's centroid by influence function
    linear_px: Mapping[str, FloatArray]
    device_px: Mapping[str, FloatArray]  # (l, j, 2) By how much the standard deviation differs from chip to chip
    sampled_px: Mapping[str, FloatArray]  # (l, j, 2) The same by noise drawn on noiseless windows
    draws: int  # Draws per window behind ``sampled_px``
    bound_px: FloatArray  # (l, j, 2) Cramer-Rao bound
    # (l, j, 2) Standard deviation that the line of sight from frame to frame makes, which is part of all the others:
    # its own, times what the centroid follows (1 but for the S-curve)
    common_px: Mapping[str, FloatArray]
    frames: int  # N

    def arcsec(self, sigma_px: FloatArray) -> FloatArray:
        """Temporal error (2,), 3 sigma, of standard deviations (j, 2)."""
        return np.asarray(3.0 * self.pixel_arcsec * sigma_px.mean(0))

    def sampled_error(self, method: str, level: int = 0) -> ErrorTerm:
        """Temporal error at a level by drawn noise: finite draws, chips and motions of the line of sight differ."""
        return expected_temporal_error(
            self.sampled_px[method][level],
            self.pixel_arcsec,
            self.frames,
            chip_px=self.device_px[method][level],
            common_px=self.common_px[method][level],
            draws=self.draws,
        )


def target_place(bench: Bench, instrument: Instrument, place_px: Sequence[float] | None = None) -> FloatArray:
    """Unit vectors (j, 3) in cam towards the multi-star target; by default in the middle of the first chip."""
    detector = instrument.detector
    middle = ((detector.chip_width_px - 1) / 2, (detector.chip_height_px - 1) / 2)
    return target_directions(bench.target, instrument, np.asarray(middle if place_px is None else place_px, float))


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

    The target stands still: its points are detected once, at the signal of the bench, and only the brightness changes.
    """
    scene = scene_of(scene, bench, instrument)
    bench = scene.bench
    light = scene.light(target_place(bench, instrument, place_px), streams, "target")
    levels = np.array([bench.signal_e] if levels_e is None else levels_e, float)
    frames = []
    for number, level in enumerate(levels):
        here, ratio = streams.child("level", number), float(level / bench.signal_e)
        frames.append(read_points(light, bench, instrument, streams=here, signal_ratio=ratio))
        advance()
    steady = motion_method(bench.methods)
    return TemporalMeasurement(
        levels_e=levels,
        frames=bench.frames,
        pixel_arcsec=instrument.pixel_arcsec,
        sigma_px={m: np.stack([one.sigma_px(m) for one in frames]) for m in bench.methods},
        light=light,
        position_px={m: np.stack([one.position_px[m] for one in frames]) for m in bench.methods},
        motion_px2=np.stack([common_motion_px2(one.position_px[steady]) for one in frames]),
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
    """The same without frames: PSFs, traced positions, the detector's data sheet."""
    bench = one_filter(bench)
    direction = target_place(bench, instrument, place_px)[None]
    levels = np.array([bench.signal_e] if levels_e is None else levels_e, float)
    noise, rng = instrument.pixel_noise(), Streams(seed).generator("temporal prediction")
    methods, told = centroiders(bench, psf), nominal_noise(instrument)
    bound, step = [], bench.power_px2(instrument)[0] ** 0.5
    # by method and level: linear, from chip to chip, common to all stars, drawn (4, j, 2)
    parts: dict[str, list[FloatArray]] = {m: [] for m in methods}
    place = bundle_prediction(bench, instrument, direction)[:, :, bench.reference]
    for level in levels:
        windows = target_windows(
            replace(bench, signal_e=float(level)), instrument, direction, psf, place, defect=defect
        )
        bound.append(bound_px(windows, noise.floor_e2))
        for name, centroider in methods.items():
            gain = window_response(centroider, windows, told)
            drawn = linear = gain.sigma_px(noise.temporal_e2(windows.light_e))
            if draws >= 2:
                positions = drawn_positions(centroider, windows, told, noise, draws=draws, rng=rng)
                drawn = np.nanstd(positions, axis=0, ddof=1)
            device, common = gain.device_sigma_px(windows.light_e, noise), followed_px(centroider, windows, told, step)
            parts[name].append(np.stack([np.hypot(linear, common), device, common, np.hypot(drawn, common)]))
    linear_px, device_px, common_px, sampled_px = (
        {name: np.stack(levels)[:, part] for name, levels in parts.items()} for part in range(4)
    )
    return TemporalPrediction(
        levels_e=levels,
        pixel_arcsec=instrument.pixel_arcsec,
        linear_px=linear_px,
        device_px=device_px,
        sampled_px=sampled_px,
        draws=draws,
        bound_px=np.hypot(np.stack(bound), step),
        common_px=common_px,
        frames=bench.frames,
    )
