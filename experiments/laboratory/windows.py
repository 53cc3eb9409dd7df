"""A star that visits many places of the detector: windows around it, read out, reduced, with the noise predicted.

At every place the star is looked for in one wide window, then a small window around it is read out many times, and as
often with the lamp off. What is measured is the mean centroid over the frames. Its covariance is predicted from the
linear response of the centroider to each pixel, by the noise of that pixel: photons, read noise, rounding and dark
current over the number of frames, the same of the dark frames, and the response pattern (PRNU), which no averaging
removes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.flags import StarFlag, has_flag
from calib.measure.centroid import Centroider, get_centroider
from calib.measure.linear_response import centroid_covariance, centroid_variance, linear_response
from calib.measure.stamps import coarse_position, stamps_from_windows
from calib.records import NoiseModel, Stamps
from experiments.laboratory.instrument import Instrument
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from render.detector.readout import expose_windows
from render.engine.random import Streams
from render.records import EffectivePsf, ExpectedImage, WindowStack

__all__ = ["SEARCH_PX", "StarReadings", "WindowPlan", "read_windows"]


SEARCH_PX = 48
"""Side of the window in which the star is looked for."""
SEEN_SIGMA = 8.0
"""A star's brightest smoothed pixel stands out of the search window's noise by this much at least."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowPlan:
    """How windows are read: their side [px], frames with the star, frames with the lamp off."""

    size_px: int
    frames: int
    dark_frames: int


@dataclass(frozen=True, slots=True, kw_only=True)
class StarReadings:
    """Mean centroids of a star at n places.

    Attributes
    ----------
    position_px : (n, 2)
        Mean over the frames.
    covariance_px2 : (n, 2, 2)
        Of the mean, predicted (see the module).
    temporal_px : (n, 2)
        Standard deviation of a single frame's centroid, measured.
    predicted_temporal_px : (n, 2)
        The same, predicted.
    frames_used : (n,) int64
        Frames that gave a position.
    windows : WindowStack
        The readout.
    """

    position_px: FloatArray
    covariance_px2: FloatArray
    temporal_px: FloatArray
    predicted_temporal_px: FloatArray
    frames_used: NDArray[np.int64]
    windows: WindowStack

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("position_px", "temporal_px", "predicted_temporal_px"):
            freeze(self, name, shape=("n", 2), sizes=sizes)
        freeze(self, "covariance_px2", shape=("n", 2, 2), sizes=sizes)
        freeze(self, "frames_used", shape=("n",), dtype=np.int64, sizes=sizes)


def read_windows(
    expected: ExpectedImage,
    near_px: FloatArray,
    psfs: Sequence[EffectivePsf],
    instrument: Instrument,
    plan: WindowPlan,
    *,
    streams: Streams,
) -> StarReadings:
    """Find the star at every place, read windows around it, and reduce them.

    Parameters
    ----------
    expected : ExpectedImage
        The star at all places at once, one band; windows of different places must not share light.
    near_px : (n, 2)
        Where to look (column, row), good to half of `SEARCH_PX`.
    psfs : sequence of EffectivePsf
        PSF at each place.
    instrument : Instrument
        The camera.
    plan : WindowPlan
        Windows and frames.
    streams : Streams
        Root of the noise.

    Raises
    ------
    DomainError
        If the star is not found, is saturated, or a window leaves the detector; the place is named.
    """
    reader = _Reader(expected, instrument, plan, streams)
    centre = reader.find(near_px)
    corner = np.rint(centre).astype(np.int64) - plan.size_px // 2
    light = reader.cut(corner, plan.size_px)
    stack = reader.expose(light, corner, plan.frames, "star")
    dark = reader.expose(np.zeros_like(light), corner, plan.dark_frames, "dark")
    stamps, noise = _dark_subtracted(stack, dark)
    if has_flag(stamps.flags, StarFlag.SATURATED).any():
        at = int(np.argmax(has_flag(stamps.flags, StarFlag.SATURATED))) % len(centre)
        raise DomainError(
            f"the star is saturated at column {centre[at, 0]:.0f}, row {centre[at, 1]:.0f}; lower the signal "
            f"({float(light[at].sum()):.0f} e- in the window)"
        )
    centroider = get_centroider("epsf", epsf=list(psfs))
    mean, temporal, used = _average(centroider, stamps, noise, plan.frames)
    if used.min() < 2:
        raise DomainError(
            f"{int(used.min())} usable frames of {plan.frames} at place {int(used.argmin())}; at least 2 are needed: "
            "raise the signal or the number of frames"
        )
    one = stamps.select(slice(0, len(centre)))
    light_e, pixel = light.astype(np.float64), instrument.pixel_noise()
    gain = linear_response(centroider, one, noise, light_e)
    mean_e2 = pixel.temporal_e2(light_e, frames=plan.frames, dark_frames=plan.dark_frames) + pixel.response_e2(light_e)
    return StarReadings(
        position_px=mean,
        covariance_px2=centroid_covariance(gain, mean_e2),
        temporal_px=temporal,
        predicted_temporal_px=np.sqrt(centroid_variance(gain, pixel.temporal_e2(light_e))),
        frames_used=used,
        windows=stack,
    )


@dataclass(frozen=True, slots=True)
class _Reader:
    expected: ExpectedImage
    instrument: Instrument
    plan: WindowPlan
    streams: Streams

    def find(self, near_px: FloatArray) -> FloatArray:
        """Coarse places (n, 2) of the star."""
        height, width, _ = self.expected.electrons.shape
        limit = np.array([width, height])
        if min(limit) < SEARCH_PX:
            raise DomainError(
                f"a detector of {width} x {height} px is smaller than the search window of {SEARCH_PX} px"
            )
        corner = np.clip(np.rint(near_px).astype(np.int64) - SEARCH_PX // 2, 0, limit - SEARCH_PX)
        stack = self.expose(self.cut(corner, SEARCH_PX), corner, 1, "search")
        dark = self.expose(np.zeros((len(corner), SEARCH_PX, SEARCH_PX)), corner, 2, "search dark")
        light = (stack.dn[0].astype(np.float64) - dark.dn.mean(0)) / stack.gain_dn_per_e
        valid = ~(stack.defect | stack.saturated[0])
        x, y = coarse_position(light, valid)
        found = np.column_stack([x, y])
        self._check_seen(light, valid, found, near_px)
        centre = corner + found
        half = self.plan.size_px // 2
        off = np.any((np.rint(centre) < half) | (np.rint(centre) > limit - 1 - half), axis=1)
        if off.any():
            at = int(np.argmax(off))
            raise DomainError(
                f"the star at column {centre[at, 0]:.0f}, row {centre[at, 1]:.0f} is too near to the edge of the "
                f"detector for a window of {self.plan.size_px} px; keep farther from the edge"
            )
        return np.asarray(centre)

    def _check_seen(self, light: FloatArray, valid: NDArray[np.bool_], found: FloatArray, near_px: FloatArray) -> None:
        """Refuse places at which nothing stands out of the noise."""
        index = np.rint(found).astype(np.int64)
        some = np.arange(len(light))
        row, column = (np.clip(index[:, k], 1, SEARCH_PX - 2) for k in (1, 0))
        block = sum(np.where(valid, light, 0.0)[some, row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1))
        spread = 1.4826 * np.median(np.abs(light - np.median(light, axis=(1, 2), keepdims=True)), axis=(1, 2))
        unseen = np.asarray(block) < SEEN_SIGMA * 3.0 * np.maximum(spread, 1e-9)
        if unseen.any():
            at = int(np.argmax(unseen))
            raise DomainError(
                f"the star is not seen within {SEARCH_PX // 2} px of column {near_px[at, 0]:.0f}, row "
                f"{near_px[at, 1]:.0f} ({int(unseen.sum())} of {len(light)} places); raise the signal, come nearer to "
                "focus, or lower the dark current"
            )

    def cut(self, corner: NDArray[np.int64], size: int) -> NDArray[np.float32]:
        """Noiseless windows (n, size, size)."""
        index = np.arange(size)
        rows, columns = corner[:, 1, None, None] + index[:, None], corner[:, 0, None, None] + index
        return np.asarray(self.expected.electrons[rows, columns, 0])

    def expose(self, light: NDArray[Any], corner: NDArray[np.int64], frames: int, what: str) -> WindowStack:
        config = self.instrument.config
        return expose_windows(
            light,
            corner,
            self.instrument.detector,
            streams=self.streams,
            frames=frames,
            exposure_s=config.exposure_s,
            temperature_c=config.chip_temperature_c,
            band=what,
        )


def _dark_subtracted(stack: WindowStack, dark: WindowStack) -> tuple[Stamps, NoiseModel]:
    """Stamps minus the mean dark frame; no background is left, and the start is the mean frame's centre of gravity."""
    stamps, noise = stamps_from_windows(stack, background_e=0.0, start_px=stack.corner_px.astype(np.float64))
    pedestal = dark.dn.mean(0) / dark.gain_dn_per_e - noise.offset_dn / noise.gain_dn_per_e
    frames, places, height, width = stack.dn.shape
    electrons = np.where(stamps.valid, stamps.electrons - np.tile(pedestal, (frames, 1, 1)), 0.0)
    light = np.maximum(electrons.reshape(frames, places, height, width).mean(0), 0.0)
    light /= np.maximum(light.sum((1, 2), keepdims=True), 1e-300)
    gravity = np.column_stack([light.sum(1) @ np.arange(width), light.sum(2) @ np.arange(height)])
    return replace(
        stamps,
        electrons=electrons,
        start_px=np.tile(stack.corner_px + gravity, (frames, 1)),
        psf_index=np.tile(np.arange(places), frames),
    ), noise


def _average(
    centroider: Centroider, stamps: Stamps, noise: NoiseModel, frames: int
) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Mean (n, 2), standard deviation of a frame (n, 2) and number of good frames (n,) at each place."""
    table = centroider.measure(stamps, noise)
    position = np.stack([table.x_px, table.y_px], axis=-1).reshape(frames, -1, 2)
    good = ~has_flag(table.flags, StarFlag.NOT_CONVERGED | StarFlag.NO_DATA).reshape(frames, -1)
    count = good.sum(0)
    weight = good[..., None] / np.maximum(count, 1)[:, None]
    filled = np.where(good[..., None], position, 0.0)
    mean = (filled * weight).sum(0)
    square = np.where(good[..., None], (filled - mean) ** 2, 0.0).sum(0)
    return mean, np.sqrt(square / np.maximum(count - 1, 1)[:, None]), count
