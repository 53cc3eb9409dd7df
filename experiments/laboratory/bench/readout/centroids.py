"""Centroids of every window in every frame, and of the noiseless light; statistics over frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.flags import StarFlag, has_flag
from calib.measure.centroid import Centroider
from calib.records import NoiseModel, Stamps
from experiments.laboratory.bench.centroid_methods import method_centroiders, needs_measured_epsf
from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.readout.stamps import centre_of_gravity
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.records import EffectivePsf

FEWEST_FRAMES = 2
"""A scatter needs two."""


def centroiders(bench: Bench, psf: Sequence[EffectivePsf]) -> dict[str, Centroider]:
    """Centroiders of the bench by method; the PSF for all points is that of the middle one."""
    reference = [psf[len(psf) // 2]] * len(psf)
    return method_centroiders(bench.methods, own=psf, reference=reference, measured=bench.epsf)


def session_centroiders(bench: Bench, psf: Sequence[EffectivePsf], method: str) -> list[Centroider]:
    """A method with the PSF of each of the bench's drawn sessions; none if it uses no PSF that was built."""
    if not needs_measured_epsf(method):
        return []
    return [centroiders(replace(bench, methods=(method,), epsf=one), psf)[method] for one in bench.sessions]


def measured_positions(centroider: Centroider, stamps: Stamps, noise: NoiseModel, frames: int) -> FloatArray:
    """Positions (f, n, 2) of n windows in f frames; NaN where the centroider failed."""
    table = centroider.measure(stamps, noise)
    position = np.stack([table.x_px, table.y_px], axis=-1).reshape(frames, -1, 2)
    bad = has_flag(table.flags, StarFlag.NOT_CONVERGED | StarFlag.NO_DATA).reshape(frames, -1)
    return np.where(bad[..., None], np.nan, position)


def frame_statistics(position_px: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Mean (n, 2), standard deviation of a frame (n, 2) and number of usable frames (n,) of positions (f, n, 2).

    Mean and standard deviation are NaN where fewer than two frames are usable.
    """
    count = np.isfinite(position_px[..., 0]).sum(0)
    enough = (count >= FEWEST_FRAMES)[:, None]
    filled = np.where(enough, position_px, 0.0)
    mean, sigma = np.nanmean(filled, axis=0), np.nanstd(filled, axis=0, ddof=1)
    return np.where(enough, mean, np.nan), np.where(enough, sigma, np.nan), count


def motion_method(methods: Sequence[str]) -> str:
    """The method that a motion of the image is judged by: a fit of the true PSF has no S-curve; or the first."""
    return "epsf" if "epsf" in methods else methods[0]


def common_motion_px2(position_px: FloatArray) -> FloatArray:
    """Variance (2, 2) of positions (f, n, 2): first (x, y) of what the points have in common from frame to frame.

    Then what the points' own noise leaves in the mean over them, which has been taken from the first. NaN for a single
    point.
    """
    points = position_px.shape[1]
    if points < 2:
        return np.full((2, 2), np.nan)
    mean = np.nanmean(position_px, axis=1)
    own = np.nanvar(position_px - mean[:, None], axis=0, ddof=1).mean(0) / (points - 1.0)
    return np.stack([mean.var(0, ddof=1) - own, own])


def refuse_few_frames(position_px: FloatArray, method: str, *, where: str) -> None:
    """Refuse positions (f, n, 2) of which a window has fewer than two."""
    count = np.isfinite(position_px[..., 0]).sum(0)
    if count.min() < FEWEST_FRAMES:
        raise DomainError(
            f"{where}: centroider {method!r} gives {count.min()} usable frames of {len(position_px)} at place "
            f"{count.argmin()}; at least {FEWEST_FRAMES} are needed: raise the signal or the number of frames, or take "
            "another centroider"
        )


def noiseless_positions(
    centroider: Centroider,
    noise: NoiseModel,
    *,
    light_e: FloatArray,
    corner_px: NDArray[np.int64],
    valid: NDArray[np.bool_] | None = None,
    psf_index: NDArray[np.int64] | None = None,
) -> tuple[FloatArray, Stamps]:
    """Positions (n, 2) by a centroider on windows (n, h, w) without noise, and its stamps."""
    count = len(light_e)
    usable = np.ones(light_e.shape, bool) if valid is None else valid
    light = np.where(usable, np.maximum(light_e, 0.0), 0.0)
    stamps = Stamps(
        electrons=light,
        valid=usable,
        corner_px=corner_px,
        background_e=np.zeros(count),
        start_px=corner_px + centre_of_gravity(light),
        flags=np.zeros(count, np.uint32),
        psf_index=np.arange(count) if psf_index is None else psf_index,
    )
    table = centroider.measure(stamps, noise)
    return np.column_stack([table.x_px, table.y_px]), stamps
