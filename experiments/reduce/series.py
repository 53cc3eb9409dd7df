"""Centroids of a series of own frames, and their expected noise from the frames' own light and the stated camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.frame_sequence import common_part, effective_frames, lag_one
from calib.detector.fixed_pattern import reduced_variance
from calib.measure.centroid_error.linear_response import centroid_covariance, linear_response, tight
from calib.measure.centroiding.registry import get_centroider
from calib.measure.reduced_windows import dark_subtracted, refuse_saturated, ring_subtracted
from calib.measure.statistics.frame_positions import measured_positions
from experiments.laboratory.bench.point_bench import refuse_few_frames
from experiments.laboratory.bench.points import PointFrames
from experiments.reduce.folder import FrameFolder, FrameSeries
from experiments.reduce.frames_toml import SeriesSettings
from optics.arrays import FloatArray

_SATURATED = (
    "lower the lamp or the exposure (saturated: pixels at saturation_dn or above, and pixels with the bit SATURATE "
    "of a MASK)"
)


FALSE_ALARM = 1e-3
"""Probability that a check refuses correct frames."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameStatistic:
    """Statistic of a check of the frames of a series."""

    value: float
    limit: float  # Of its magnitude, exceeded by noise with the probability of a false alarm
    text: str  # Fault and frames, in words


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesFrames:
    """Centroids of a series of N frames of j points."""

    settings: SeriesSettings
    frames: int  # N
    signal_e: float  # Mean electrons in a window above the background
    points: PointFrames  # Centroids by method, and the windows
    mean_e: FloatArray  # (j, h, w) Mean windows as centroided, with the background if there are no dark frames
    # (j, 2, 2) Of the centroid of a frame, by method: photon noise, read noise, rounding and dark charge, through the
    # linear response to each pixel of the mean windows
    frame_covariance_px2: Mapping[str, FloatArray]
    # (j, 2, h, w) Shift of the first method's centroids by one standard deviation of each pixel's fixed pattern: noise
    # of the mean dark frame and of the flat, and the response that no flat removes
    pattern_px: FloatArray
    origin: tuple[str, ...]  # File of every frame
    lags: tuple[FrameStatistic, ...]  # Correlation of the first method's centroids from frame to frame
    light: FloatArray  # (f,) Light of every frame over the mean, all points together
    percent_px: float  # RMS shift over points and axes by a pixel response with a standard deviation of 1 %

    @property
    def name(self) -> str:
        """Name of the series in messages and tables."""
        return self.settings.name

    @property
    def exposure_s(self) -> float:
        """Exposure time; NaN if unknown."""
        return self.points.windows.exposure_s

    @property
    def light_per_s(self) -> float:
        """Electrons per point and second, at least 1e-3; per frame if the exposure time is unknown."""
        return max(self.signal_e, 1e-3) / (self.exposure_s if self.exposure_s > 0 else 1.0)

    @property
    def usable_fraction(self) -> float:
        """Fraction of frames with a position, smallest over points and methods."""
        return float(min(np.isfinite(p[..., 0]).mean(0).min() for p in self.points.position_px.values()))

    @property
    def effective_frames(self) -> float:
        """Number of independent frames with the same error of the mean; N without significant correlation."""
        significant = [lag.value for lag in self.lags if lag.value > lag.limit]
        return effective_frames(self.frames, max(significant, default=0.0))

    def predicted_px(self, method: str) -> FloatArray:
        """Standard deviation (j, 2) of a frame's centroid by the noise model."""
        return np.sqrt(np.diagonal(self.frame_covariance_px2[method], axis1=1, axis2=2))

    def widening(self, method: str) -> float:
        """Factor of the error of a scatter due to correlated frames and common motion of the points."""
        position = self.points.position_px[method]
        common = common_part(position[np.isfinite(position).all((1, 2))])
        return float(np.sqrt(self.frames / self.effective_frames * (1.0 + (position.shape[1] - 1) * common)))

    def mean_covariance_px2(self, method: str) -> FloatArray:
        """Covariance (j, 2, 2) of the mean over the frames, dark frames and flat included; of the first method."""
        fixed = centroid_covariance(self.pattern_px, np.ones(self.mean_e.shape))
        return np.asarray(self.frame_covariance_px2[method] / self.effective_frames + fixed)


def reduce_series(
    folder: FrameFolder, series: FrameSeries, methods: Sequence[str], *, every_model: bool = False
) -> SeriesFrames:
    """Centroids of a series and their noise."""
    if series.dark_e is None:
        stamps, noise = ring_subtracted(series.windows, series.detected_px, response=series.response)
    else:
        stamps, noise = dark_subtracted(series.windows, series.dark_e, response=series.response)
    frames = len(series.windows.dn)
    refuse_saturated(stamps, len(series.detected_px), where=f"{series.name}, target points", advice=_SATURATED)
    position = {m: measured_positions(get_centroider(m), stamps, noise, frames) for m in methods}
    if frames > 1:
        for method, values in position.items():
            refuse_few_frames(values, method, where=series.name)
    mean = stamps.electrons.reshape(frames, *series.windows.defect.shape).mean(0)
    light = mean - stamps.background_e[: len(mean), None, None]
    temporal_e2, fixed_e2 = reduced_variance(
        mean,
        light,
        noise,
        dark_e=None if series.dark_e is None else series.dark_e - noise.offset_dn / noise.gain_dn_per_e,
        dark_frames=series.dark_frames,
        response=series.response,
        response_error=series.response_error,
        prnu=folder.settings.prnu_fraction,
    )
    first_stamps = stamps.select(slice(0, len(mean)))
    modelled = methods if every_model else methods[:1]
    gain = {m: linear_response(tight(get_centroider(m)), first_stamps, noise, mean) for m in modelled}
    return SeriesFrames(
        settings=series.settings,
        frames=frames,
        signal_e=float(np.where(series.windows.defect, 0.0, light).sum((1, 2)).mean()),
        points=PointFrames(position_px=position, windows=series.windows, stamps=first_stamps, noise=noise),
        mean_e=mean,
        frame_covariance_px2={m: centroid_covariance(gain[m], temporal_e2) for m in modelled},
        pattern_px=gain[methods[0]] * np.sqrt(fixed_e2)[:, None],
        origin=series.origin,
        lags=_lags(position[methods[0]], series.name, tests=len(folder.series)),
        light=_light(stamps.electrons.reshape(frames, *light.shape) - (mean - light), light, ~series.windows.defect),
        percent_px=float(0.01 * np.sqrt(((gain[methods[0]] * light[:, None]) ** 2).sum((2, 3)).mean())),
    )


def _light(frames_e: FloatArray, mean_e: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    """Light (f,) of frames (f, j, h, w) over that of their mean, by least squares."""
    weight = np.where(usable, mean_e, 0.0)
    return np.asarray((frames_e * weight).sum((1, 2, 3)) / (mean_e * weight).sum())


def _lags(position_px: FloatArray, series: str, *, tests: int) -> tuple[FrameStatistic, ...]:
    """Correlations of centroids (f, j, 2) of one of ``tests`` series: common motion in x and y, and relative motion."""
    complete = position_px[np.isfinite(position_px).all((1, 2))]
    common = complete.mean(1)
    relative = (complete - common[:, None]).reshape(len(complete), -1)
    statistics = []
    for motion, values, independent in (
        ("x of all points", common[:, :1], 1),
        ("y of all points", common[:, 1:], 1),
        ("the points' own motion", relative, 2 * (complete.shape[1] - 1)),
    ):
        lag = lag_one(values, independent=independent, false_alarm=FALSE_ALARM / (3 * tests))
        if lag is not None:
            text = (
                f"frames of {series} are not independent: {motion}, correlation {lag.correlation:+.2f} with the next "
                "frame"
            )
            statistics.append(FrameStatistic(value=lag.correlation, limit=lag.limit, text=text))
    return tuple(statistics)
