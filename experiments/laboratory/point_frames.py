"""Frames of point targets and their reduction: centroids of every point in every frame, by several methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib.flags import StarFlag, has_flag
from calib.measure.centroid import Centroider
from calib.measure.stamps import ring_background, stamps_from_windows
from calib.records import NoiseModel, Stamps
from experiments.laboratory.bench import Bench
from experiments.laboratory.centroid_methods import method_centroiders
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.point_scene import PointLight
from experiments.laboratory.points import dark_subtracted
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.detector.readout import expose_windows
from render.detector.spec import Detector
from render.engine.random import Streams
from render.records import EffectivePsf, WindowStack

__all__ = [
    "SUBTRACTIONS",
    "PointFrames",
    "Subtraction",
    "centroiders",
    "measured_positions",
    "noiseless_positions",
    "read_points",
    "reduce_windows",
]

Subtraction = Literal["dark", "raw"]

SUBTRACTIONS: tuple[Subtraction, ...] = ("dark", "raw")
"""``dark``: minus the mean of frames with the lamp off. ``raw``: minus the nominal offset and one background value per
window, from the outermost ring of its mean frame; fixed patterns stay."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointFrames:
    """Centroids of j points in f frames.

    Attributes
    ----------
    position_px : dict of str to (f, j, 2)
        By method; NaN where a frame gave none.
    windows : WindowStack
        The readout.
    """

    position_px: Mapping[str, FloatArray]
    windows: WindowStack

    def __post_init__(self) -> None:
        for value in self.position_px.values():
            if value.ndim != 3 or value.shape[2] != 2:
                raise DomainError(f"PointFrames.position_px: shape {value.shape} where (frames, points, 2) is needed")

    def mean_px(self, method: str) -> FloatArray:
        """Mean over the frames (j, 2)."""
        return np.asarray(np.nanmean(self.position_px[method], axis=0))

    def sigma_px(self, method: str) -> FloatArray:
        """Standard deviation of a single frame (j, 2)."""
        return np.asarray(np.nanstd(self.position_px[method], axis=0, ddof=1))


def centroiders(methods: Sequence[str], psf: Sequence[EffectivePsf]) -> dict[str, Centroider]:
    """Centroiders by method; the PSF for all points is that of the middle one."""
    return method_centroiders(methods, own=psf, reference=[psf[len(psf) // 2]] * len(psf))


def read_points(
    light: PointLight,
    bench: Bench,
    instrument: Instrument,
    *,
    streams: Streams,
    dark_streams: Streams | None = None,
    signal_ratio: float = 1.0,
    detector: Detector | None = None,
    subtraction: Subtraction = "dark",
    mask_defects: bool = True,
) -> PointFrames:
    """Read out frames of a target and centroid its points.

    Parameters
    ----------
    light : PointLight
        What falls onto the detector.
    bench, instrument
        The laboratory.
    streams : Streams
        Noise of the frames.
    dark_streams : Streams, optional
        Noise of the frames with the lamp off; places that share it share one set of dark frames, pixel by pixel.
    signal_ratio : float
        Brightness over that of ``light``.
    detector : Detector, optional
        In place of the instrument's: the same with an effect switched off.
    subtraction : {"dark", "raw"}
        See `SUBTRACTIONS`.
    mask_defects : bool
        Whether the reduction leaves out the pixels known to be hot or dead.

    Raises
    ------
    DomainError
        On saturated points, or fewer than two usable frames of a point.
    """
    chip, config = detector or instrument.detector, instrument.config

    def expose(electrons: FloatArray, root: Streams, frames: int, label: str) -> WindowStack:
        stack = expose_windows(
            electrons,
            light.corner_px,
            chip,
            streams=root,
            frames=frames,
            exposure_s=config.exposure_s,
            temperature_c=config.chip_temperature_c,
            band=label,
        )
        return stack if mask_defects else replace(stack, defect=np.zeros_like(stack.defect))

    stack = expose(light.light_e * signal_ratio, streams, bench.frames, "lamp")
    dark = None
    if subtraction == "dark":
        dark = expose(np.zeros_like(light.light_e), dark_streams or streams, bench.dark_frames, "dark")
    stamps, noise = reduce_windows(stack, dark, light.found_px)
    if has_flag(stamps.flags, StarFlag.SATURATED).any():
        raise DomainError(
            f"target points are saturated at {bench.signal_e * signal_ratio:g} e- per frame; lower signal_e or the "
            "highest level"
        )
    position = {
        name: measured_positions(centroider, stamps, noise, bench.frames)
        for name, centroider in centroiders(bench.methods, light.psf).items()
    }
    first = bench.methods[0]
    fewest = int(np.isfinite(position[first][..., 0]).sum(0).min())
    if fewest < 2:
        raise DomainError(
            f"centroider {first!r} gives {fewest} usable frames of {bench.frames} for a target point; at least 2 are "
            "needed: raise the signal or the number of frames, or take another centroid"
        )
    return PointFrames(position_px=position, windows=stack)


def reduce_windows(stack: WindowStack, dark: WindowStack | None, start_px: FloatArray) -> tuple[Stamps, NoiseModel]:
    """Stamps of all frames, without dark or background, and their noise model.

    Parameters
    ----------
    stack : WindowStack
        The readout.
    dark : WindowStack or None
        The same windows with the lamp off; None: see "raw" in `SUBTRACTIONS`.
    start_px : (j, 2)
        Where the points were detected.
    """
    if dark is not None:
        return dark_subtracted(stack, dark.dn.mean(0) / dark.gain_dn_per_e, start_px)
    stamps, noise = stamps_from_windows(stack, background_e=0.0, start_px=start_px)
    frames, points, height, width = stack.dn.shape
    mean = stamps.electrons.reshape(frames, points, height, width).mean(0)
    valid = ~stack.defect
    level = ring_background(mean, valid)
    # the centre of gravity of the mean frame within 3 px of the detection: patterns far from the point do not count
    index = np.arange(height), np.arange(width)
    at = np.rint(start_px - stack.corner_px)
    near = (np.abs(index[0] - at[:, 1, None]) <= 3)[:, :, None] & (np.abs(index[1] - at[:, 0, None]) <= 3)[:, None, :]
    light = np.maximum(np.where(near & valid, mean - level[:, None, None], 0.0), 0.0)
    light /= np.maximum(light.sum((1, 2), keepdims=True), 1e-300)
    gravity = np.column_stack([light.sum(1) @ index[1], light.sum(2) @ index[0]])
    return replace(
        stamps,
        background_e=np.tile(level, frames),
        start_px=np.tile(stack.corner_px + gravity, (frames, 1)),
        psf_index=np.tile(np.arange(points), frames),
    ), noise


def measured_positions(centroider: Centroider, stamps: Stamps, noise: NoiseModel, frames: int) -> FloatArray:
    """Positions (f, j, 2); NaN where the centroider failed or a point had fewer than two good frames."""
    table = centroider.measure(stamps, noise)
    position = np.stack([table.x_px, table.y_px], axis=-1).reshape(frames, -1, 2)
    bad = has_flag(table.flags, StarFlag.NOT_CONVERGED | StarFlag.NO_DATA).reshape(frames, -1)
    return np.where(bad[..., None], np.nan, position)


def noiseless_positions(
    centroider: Centroider,
    noise: NoiseModel,
    *,
    light_e: FloatArray,
    corner_px: NDArray[np.int64],
    valid: NDArray[np.bool_] | None = None,
    psf_index: NDArray[np.int64] | None = None,
) -> tuple[FloatArray, Stamps]:
    """What a centroider makes of windows (n, h, w) without noise: positions (n, 2), and the stamps it was given.

    Parameters
    ----------
    centroider : Centroider
        The estimator.
    noise : NoiseModel
        Noise model handed to it.
    light_e : (n, h, w)
        Expected electrons.
    corner_px : (n, 2)
        First pixels.
    valid : (n, h, w) bool, optional
        Pixels that may be used; all without it.
    psf_index : (n,), optional
        Which PSF belongs to which window; in order without it.
    """
    count, height, width = light_e.shape
    usable = np.ones(light_e.shape, bool) if valid is None else valid
    light = np.where(usable, np.maximum(light_e, 0.0), 0.0)
    share = light / np.maximum(light.sum((1, 2), keepdims=True), 1e-300)
    gravity = np.column_stack([share.sum(1) @ np.arange(width), share.sum(2) @ np.arange(height)])
    stamps = Stamps(
        electrons=light,
        valid=usable,
        corner_px=corner_px,
        background_e=np.zeros(count),
        start_px=corner_px + gravity,
        flags=np.zeros(count, np.uint32),
        psf_index=np.arange(count) if psf_index is None else psf_index,
    )
    table = centroider.measure(stamps, noise)
    return np.column_stack([table.x_px, table.y_px]), stamps
