"""Centroids of a series of own frames, and their expected noise from the frames' own light and the stated camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.measure.centroid import get_centroider
from calib.measure.frame_positions import measured_positions
from calib.measure.linear_response import centroid_covariance, linear_response, tight
from calib.records import NoiseModel, Stamps
from experiments.laboratory.bench.point_bench import refuse_few_frames
from experiments.laboratory.bench.point_frames import PointFrames
from experiments.laboratory.bench.readout.stamps import dark_subtracted, refuse_saturated, ring_subtracted
from experiments.reduce.folder import FrameFolder, FrameSeries
from experiments.reduce.frames_toml import SeriesSettings
from experiments.reduce.sequence import Lag, effective_frames, position_lags
from optics.arrays import FloatArray

_SATURATED = (
    "lower the lamp or the exposure (saturated: pixels at saturation_dn or above, and pixels with the bit SATURATE "
    "of a MASK)"
)


CHANCE = 3.0
"""Standard deviations up to which points that move alike are so by chance."""


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
    lags: tuple[Lag, ...]  # Correlation of the first method's centroids from frame to frame
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
        place = self.points.position_px[method]
        whole = place[np.isfinite(place).all((1, 2))]
        frames, points, _ = whole.shape
        alike = 0.0
        if points > 1 and frames > 2:
            unit = whole - whole.mean(0)
            unit = unit / np.maximum(np.linalg.norm(unit, axis=0), 1e-300)
            squares = np.einsum("fja,fka->ajk", unit, unit) ** 2
            between = (squares.sum() - 2 * points) / (2 * points * (points - 1))
            more, chance = float(between) * (frames - 1) - 1.0, np.sqrt(2.0 / (points * (points - 1)))
            alike = more / (frames - 1) if more > CHANCE * chance else 0.0
        return float(np.sqrt(self.frames / self.effective_frames * (1.0 + (points - 1) * alike)))

    def mean_covariance_px2(self, method: str) -> FloatArray:
        """Covariance (j, 2, 2) of the mean over the frames, dark frames and flat included; of the first method."""
        fixed = np.einsum("jahw,jbhw->jab", self.pattern_px, self.pattern_px)
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
    temporal_e2, fixed_e2 = _variances(folder, series, mean, light, noise)
    one = stamps.select(slice(0, len(mean)))
    modelled = methods if every_model else methods[:1]
    gain = {m: linear_response(tight(get_centroider(m)), one, noise, mean) for m in modelled}
    return SeriesFrames(
        settings=series.settings,
        frames=frames,
        signal_e=float(np.where(series.windows.defect, 0.0, light).sum((1, 2)).mean()),
        points=PointFrames(position_px=position, windows=series.windows),
        mean_e=mean,
        frame_covariance_px2={m: centroid_covariance(gain[m], temporal_e2) for m in modelled},
        pattern_px=gain[methods[0]] * np.sqrt(fixed_e2)[:, None],
        origin=series.origin,
        lags=position_lags(position[methods[0]], series.name, tests=len(folder.series)),
        light=_light(stamps.electrons.reshape(frames, *light.shape) - (mean - light), light, ~series.windows.defect),
        percent_px=float(0.01 * np.sqrt(((gain[methods[0]] * light[:, None]) ** 2).sum((2, 3)).mean())),
    )


def _light(frames_e: FloatArray, mean_e: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    """Light (f,) of frames (f, j, h, w) over that of their mean, by least squares."""
    weight = np.where(usable, mean_e, 0.0)
    return np.asarray(np.einsum("fjhw,jhw->f", frames_e, weight) / np.einsum("jhw,jhw->", mean_e, weight))


def _stamps(series: FrameSeries) -> tuple[Stamps, NoiseModel]:
    if series.dark_e is None:
        return ring_subtracted(series.windows, series.found_px, response=series.response)
    return dark_subtracted(series.windows, series.dark_e, response=series.response)


def _variances(
    folder: FrameFolder, series: FrameSeries, mean_e: FloatArray, light_e: FloatArray, noise: NoiseModel
) -> tuple[FloatArray, FloatArray]:
    """Variance of a pixel from frame to frame, and of what is the same in all frames, (j, h, w) [e-^2] each."""
    response: FloatArray | float = 1.0 if series.response is None else series.response
    floor = np.full(mean_e.shape, noise.floor_e2)
    if series.dark_e is not None:  # the charge that was subtracted still makes noise
        floor = floor + (series.dark_e - noise.offset_dn / noise.gain_dn_per_e)
    temporal = np.maximum(np.maximum(mean_e, 0.0) * response + floor, 0.0) / response**2
    fixed = (folder.settings.prnu_fraction * light_e) ** 2
    if series.dark_frames:
        fixed = fixed + np.maximum(floor, 0.0) / series.dark_frames / response**2
    if series.response_error is not None:
        fixed = fixed + (light_e * series.response_error / response) ** 2
    return temporal, fixed
