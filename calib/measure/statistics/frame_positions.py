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
    failed = has_flag(table.flags, StarFlag.NOT_CONVERGED | StarFlag.NO_DATA)
    return np.where(failed[:, None], np.nan, table.pixel_px).reshape(frames, -1, 2)


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
    """Variance (2, 2) of positions (f, n, 2): first of the common motion in x and y from frame to frame.

    Then of the mean of the points' independent noise, which is subtracted from the first. NaN for a single point.
    """
    points = position_px.shape[1]
    if points < 2:
        return np.full((2, 2), np.nan)
    mean = np.nanmean(position_px, axis=1)
    noise = np.nanvar(position_px - mean[:, None], axis=0, ddof=1).mean(0) / (points - 1.0)
    return np.stack([mean.var(0, ddof=1) - noise, noise])


def common_motion_limit(frames: int, points: int, false_alarm: float) -> float:
    """Variance of the mean over n points at rest in f frames, over that by their noise, with a false alarm probability.

    Fisher's F with (f - 1) and (f - 1)(n - 1) degrees of freedom.
    """
    return float(fdtri(frames - 1, (frames - 1) * (points - 1), 1.0 - false_alarm))
