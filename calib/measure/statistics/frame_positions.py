"""Positions of the same stars in several frames: measured, their mean and scatter, and their common motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from calib.flags import StarFlag, has_flag
from calib.measure.centroiding.registry import Centroider
from calib.records import NoiseModel, Stamps
from optics.arrays import FloatArray

FEWEST_FRAMES = 2
"""A scatter needs two."""


def measured_positions(centroider: Centroider, stamps: Stamps, noise: NoiseModel, frames: int) -> FloatArray:
    """Positions (f, n, 2) of n windows in f frames; NaN where the centroider failed."""
    table = centroider.measure(stamps, noise)
    position = np.stack([table.x_px, table.y_px], axis=-1).reshape(frames, -1, 2)
    bad = has_flag(table.flags, StarFlag.NOT_CONVERGED | StarFlag.NO_DATA).reshape(frames, -1)
    return np.where(bad[..., None], np.nan, position)


def frame_statistics(position_px: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Mean (..., 2), standard deviation of a frame (..., 2), number of usable frames (...) of positions (f, ..., 2).

    Mean and standard deviation are NaN where fewer than two frames are usable.
    """
    count = np.isfinite(position_px[..., 0]).sum(0)
    enough = (count >= FEWEST_FRAMES)[..., None]
    filled = np.where(enough, position_px, 0.0)
    mean, sigma = np.nanmean(filled, axis=0), np.nanstd(filled, axis=0, ddof=1)
    return np.where(enough, mean, np.nan), np.where(enough, sigma, np.nan), count


def position_covariance_px2(position_px: FloatArray) -> FloatArray:
    """Covariance (n, 2, 2) of positions (f, n, 2); frames without a position are left out."""
    deviation = position_px - np.nanmean(position_px, axis=0)
    count = np.isfinite(deviation[..., 0]).sum(0)[:, None, None]
    filled = np.nan_to_num(deviation)
    return np.asarray(np.einsum("fna,fnb->nab", filled, filled) / (count - 1))


def common_motion_px2(position_px: FloatArray) -> FloatArray:
    """Variance (2, 2) of positions (f, n, 2): first (x, y) of what the points have in common from frame to frame.

    Then what the points' own noise leaves in the mean over them, which has been taken from the first. NaN for a single
    point.
    """
    points = position_px.shape[1]
    if points < 2:
        return np.full((2, 2), np.nan)
    mean = np.nanmean(position_px, axis=1)
    noise = np.nanvar(position_px - mean[:, None], axis=0, ddof=1).mean(0) / (points - 1.0)
    return np.stack([mean.var(0, ddof=1) - noise, noise])


def common_motion_limit(frames: int, points: int, false_alarm: float) -> float:
    """Variance of the mean over n points at rest, over that by their own noise, that chance reaches.

    Fisher's F with (f - 1) and (f - 1)(n - 1) degrees of freedom, f frames.
    """
    return float(fdtri(frames - 1, (frames - 1) * (points - 1), 1.0 - false_alarm))
