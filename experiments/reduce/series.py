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
from calib.records import NoiseModel, Stamps
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
"""Probability that a check objects to frames that are as they should be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameStatistic:
    """What a check found in the frames of a series."""

    value: float
    limit: float  # Of its size, which noise reaches with the stated false alarm
    text: str  # What and where, in words


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesFrames:
    """Centroids of a series of N frames of j points."""

    settings: SeriesSettings  # What the folder says of it
    frames: int  # N
    signal_e: float  # Mean electrons in a window, background taken away
    points: PointFrames  # Centroids by method, and the windows
    mean_e: FloatArray  # (j, h, w) Mean windows as centroided, background included where no dark frames were given
    # (j, 2, 2) Of the centroid of one frame, by method: what photons, read noise, rounding and the dark charge seen
    # in the frames with the lamp off give, through the influence of each pixel of the mean windows
    frame_covariance_px2: Mapping[str, FloatArray]
    # (j, 2, h, w) By how much what is the same in all frames moves the first method's centroids, pixel by pixel, one
    # standard deviation: noise of the mean dark frame and of the flat, and the response that no flat removes
    pattern_px: FloatArray
    origin: tuple[str, ...]  # File of every frame
    lags: tuple[FrameStatistic, ...]  # Correlation of the first method's centroids from frame to frame
    light: FloatArray  # (f,) Light of every frame over the mean, all points together
    percent_px: float  # RMS over points and axes of what a response that differs by 1 % from pixel to pixel moves them

    @property
    def name(self) -> str:
        """Name of the series in messages and tables."""
        return self.settings.name

    @property
    def exposure_s(self) -> float:
        """Exposure time; NaN where the files do not say."""
        return self.points.windows.exposure_s

    @property
    def light_per_s(self) -> float:
        """Electrons per point and second, at least 1e-3; per frame where the exposure time is not known."""
        return max(self.signal_e, 1e-3) / (self.exposure_s if self.exposure_s > 0 else 1.0)

    @property
    def usable_fraction(self) -> float:
        """Smallest share over points and methods of frames that gave a position."""
        return float(min(np.isfinite(p[..., 0]).mean(0).min() for p in self.points.position_px.values()))

    @property
    def effective_frames(self) -> float:
        """Independent frames whose mean is as good; N where the frames show no correlation."""
        return effective_frames(
            self.frames, max((one.value for one in self.lags if one.value > one.limit), default=0.0)
        )

    def predicted_px(self, method: str) -> FloatArray:
        """Standard deviation (j, 2) of a frame's centroid by the noise model."""
        return np.sqrt(np.diagonal(self.frame_covariance_px2[method], axis1=1, axis2=2))

    def widening(self, method: str) -> float:
        """Factor of the error of a scatter: frames that are correlated, and motion that points have in common."""
        position = self.points.position_px[method]
        alike = common_part(position[np.isfinite(position).all((1, 2))])
        return float(np.sqrt(self.frames / self.effective_frames * (1.0 + (position.shape[1] - 1) * alike)))

    def mean_covariance_px2(self, method: str) -> FloatArray:
        """Covariance (j, 2, 2) of the mean over the frames, dark frames and flat included; of the first method."""
        fixed = centroid_covariance(self.pattern_px, np.ones(self.mean_e.shape))
        return np.asarray(self.frame_covariance_px2[method] / self.effective_frames + fixed)


def reduce_series(
    folder: FrameFolder, series: FrameSeries, methods: Sequence[str], *, every_model: bool = False
) -> SeriesFrames:
    """Centroids of a series and their noise."""
    stamps, noise = _stamps(series)
    frames = len(series.windows.dn)
    refuse_saturated(stamps, len(series.found_px), where=f"{series.name}, target points", advice=_SATURATED)
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
    one = stamps.select(slice(0, len(mean)))
    modelled = methods if every_model else methods[:1]
    gain = {m: linear_response(tight(get_centroider(m)), one, noise, mean) for m in modelled}
    return SeriesFrames(
        settings=series.settings,
        frames=frames,
        signal_e=float(np.where(series.windows.defect, 0.0, light).sum((1, 2)).mean()),
        points=PointFrames(position_px=position, windows=series.windows, stamps=one, noise=noise),
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
    """Correlations of centroids (f, j, 2) of a series, one of ``tests``: of all points together, x and y, and apart."""
    whole = position_px[np.isfinite(position_px).all((1, 2))]
    common = whole.mean(1)
    apart = (whole - common[:, None]).reshape(len(whole), -1)
    findings = []
    for what, values, independent in (
        ("x of all points", common[:, :1], 1),
        ("y of all points", common[:, 1:], 1),
        ("the points' own motion", apart, 2 * (whole.shape[1] - 1)),
    ):
        lag = lag_one(values, independent=independent, false_alarm=FALSE_ALARM / (3 * tests))
        if lag is not None:
            text = (
                f"frames of {series} are not independent: {what}, correlation {lag.correlation:+.2f} with the next "
                "frame"
            )
            findings.append(FrameStatistic(value=lag.correlation, limit=lag.limit, text=text))
    return tuple(findings)


def _stamps(series: FrameSeries) -> tuple[Stamps, NoiseModel]:
    if series.dark_e is None:
        return ring_subtracted(series.windows, series.found_px, response=series.response)
    return dark_subtracted(series.windows, series.dark_e, response=series.response)
