"""Temporal error of a star camera (ACC18 eq. 1-2): scatter of centroids over frames of a static scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import gammaln
from scipy.stats import chi2

from calib.accuracy.error_budget import ErrorTerm
from optics.arrays import FloatArray


def small_sample_factor(samples: float) -> float:
    """Expectation of a standard deviation from N normal samples (divisor N - 1) over the true one: c4(N)."""
    n = float(samples)
    return float(np.sqrt(2.0 / (n - 1.0)) * np.exp(gammaln(n / 2.0) - gammaln((n - 1.0) / 2.0)))


def relative_scatter(samples: float) -> float:
    """Standard deviation of a standard deviation from N normal samples, over its expectation: sqrt(1 / c4^2 - 1)."""
    c4 = small_sample_factor(samples)
    return float(np.sqrt(1.0 - c4**2) / c4)


def temporal_error(sigma_px: FloatArray, pixel_arcsec: float, frames: int) -> ErrorTerm:
    """Temporal error: three times the mean over the stars of their standard deviations.

    Parameters
    ----------
    sigma_px : (j, 2)
        Standard deviation of the centroids of each star over the frames (divisor N - 1) [px].
    pixel_arcsec : float
        Angle of a pixel [arcsec].
    frames : int
        Number of frames N. The value keeps the bias of a standard deviation from N samples (`small_sample_factor`), as
        in the paper; the uncertainty takes the stars as independent.
    """
    scale = 3.0 * pixel_arcsec
    spread = np.sqrt((sigma_px**2).sum(0)) / len(sigma_px) * relative_scatter(frames)
    return ErrorTerm(arcsec=scale * sigma_px.mean(0), uncertainty_arcsec=scale * spread, n=int(frames) * len(sigma_px))


def expected_temporal_error(
    sigma_px: FloatArray,
    pixel_arcsec: float,
    frames: int,
    *,
    chip_px: FloatArray,
    common_px: FloatArray,
    draws: int = 0,
) -> ErrorTerm:
    """Temporal error of predicted standard deviations, and how far that of a chip and a series may lie from it.

    Shapes (j, 2): ``sigma_px`` of the centroid of each star in a frame; ``chip_px``, its standard deviation from chip
    to chip; ``common_px``, its part by a motion of the line of sight, the same for all stars, which N frames draw.
    ``draws``: noisy copies of a window from which ``sigma_px`` was estimated; fewer than two if it was computed.
    """
    drawn = sigma_px / np.sqrt(2.0 * (draws - 1)) if draws >= 2 else np.zeros_like(sigma_px)
    spread = np.sqrt((chip_px**2 + drawn**2).sum(0)) / len(sigma_px)
    motion = (common_px**2 / (2.0 * sigma_px)).mean(0) * np.sqrt(2.0 / (frames - 1.0))
    scale = 3.0 * pixel_arcsec
    return ErrorTerm(arcsec=scale * sigma_px.mean(0), uncertainty_arcsec=scale * np.hypot(spread, motion))


def scatter_interval(
    value: ArrayLike, relative_error: ArrayLike, *, level: float = 0.95
) -> tuple[FloatArray, FloatArray]:
    """Two-sided confidence interval of standard deviations with known relative standard errors.

    Of chi-square, with the degrees of freedom whose standard deviation has this relative standard error. For one star
    in N frames these are N - 1 and the interval is exact; a mean over stars is treated as a standard deviation of more
    degrees.

    Parameters
    ----------
    value, relative_error : (...)
        Unbiased estimates, and their standard errors over the values.
    level : float
        Confidence.

    Returns
    -------
    low, high : (...) arrays
        Ends of the interval; NaN where the standard error is zero or not finite.
    """
    value, relative_error = np.broadcast_arrays(np.asarray(value, float), np.asarray(relative_error, float))
    low, high = np.full(value.shape, np.nan), np.full(value.shape, np.nan)
    ends = np.log([1e-2, 1e7])
    for index in zip(*np.nonzero((relative_error > 0.0) & (relative_error < np.inf)), strict=True):

        def excess(log_degrees: float, wanted: float = float(relative_error[index])) -> float:
            return relative_scatter(np.exp(log_degrees) + 1.0) - wanted

        degrees = float(np.exp(brentq(excess, *ends) if excess(ends[0]) > 0.0 > excess(ends[1]) else ends[0]))
        # an average of estimates is low by c4 of a single estimate; the root of chi-square by c4 of the average
        scale = value[index] * np.sqrt(degrees) * small_sample_factor(degrees + 1.0)
        tails = chi2.isf([0.5 * (1.0 - level), 0.5 * (1.0 + level)], degrees)
        low[index], high[index] = scale / np.sqrt(tails)
    return low, high
