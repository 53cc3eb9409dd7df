"""Detections against true positions: pairs, robust errors, and limits that a sample allows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.stats import binom, norm

from optics.arrays import FloatArray, IntArray

ROBUST_SIGMA = 1.4826
"""Median absolute deviation to standard deviation of a normal distribution."""


class Pairs(NamedTuple):
    """Stars (n) and detections (m)."""

    detection: IntArray  # (n,) Detection of each star, -1 for none
    star: IntArray  # (m,) Nearest star of each detection, -1 without stars
    distance_px: FloatArray  # (m,) And its distance; infinite without stars


def nearest_pairs(star_px: FloatArray, detected_px: FloatArray, radius_px: ArrayLike) -> Pairs:
    """Stars (n, 2) and detections (m, 2) that are each other's nearest, within a radius, () or one per star (n,)."""
    stars, count = len(star_px), len(detected_px)
    if not stars or not count:
        return Pairs(np.full(stars, -1), np.full(count, -1), np.full(count, np.inf))
    distance, nearest = cKDTree(detected_px).query(star_px)
    distance_back, back = cKDTree(star_px).query(detected_px)
    mutual = (back[nearest] == np.arange(stars)) & (distance <= radius_px)
    return Pairs(np.where(mutual, nearest, -1), back, distance_back)


def robust_scatter(deviation: FloatArray) -> tuple[float, float]:
    """Standard deviation of normal values (n, k) about their medians (k,) from the median absolute deviation.

    Returns it and its standard error: the variance of the median absolute deviation of N values, times 1.4826 squared,
    is 1.3604 sigma^2 / N.
    """
    sigma = robust_rms(deviation - np.median(deviation, axis=0))
    return sigma, sigma * float(np.sqrt(1.3604 / deviation.size))


def robust_rms(values: FloatArray) -> float:
    """Standard deviation of normal values of zero mean from the median of their sizes."""
    return ROBUST_SIGMA * float(np.median(np.abs(values)))


def robust_ratio_limit(count: int, margin: float, false_alarm: float) -> tuple[float, float]:
    """Uncertainty of the ratio of a robust scatter of 2 n values to their true one, and its upper limit.

    The median absolute deviation tells the standard deviation to 1.166 / sqrt(2 n) of it; the limit is exceeded with
    the probability ``false_alarm`` by a ratio of ``margin``.
    """
    spread = 1.166 / float(np.sqrt(2.0 * max(count, 1)))
    return spread, margin + float(norm.isf(false_alarm)) * spread


def missed_limit(count: int, fraction: float, false_alarm: float) -> float:
    """Fraction of ``count`` stars that are missed at most, but for a probability, if each is with ``fraction``."""
    return float(binom.isf(false_alarm, max(count, 1), fraction)) / max(count, 1)


def rate_excess_sigma(count: int, exposures: int, other: int, other_exposures: int) -> float:
    """Difference of two Poisson rates over its standard deviation, one count added to each for small numbers."""
    spread = np.sqrt((count + 1) / exposures**2 + (other + 1) / other_exposures**2)
    return float((count / exposures - other / other_exposures) / spread)


def completeness_magnitude(magnitude: FloatArray, detected: FloatArray, fraction: float = 0.5) -> float:
    """Magnitude where the detected fraction (n,) in bins (n,) falls below a fraction for good; NaN if it never does."""
    above = np.flatnonzero(detected >= fraction)
    if not len(above) or above[-1] + 1 >= len(detected):
        return float("nan")
    pair = slice(int(above[-1]), int(above[-1]) + 2)
    return float(np.interp(fraction, detected[pair][::-1], magnitude[pair][::-1]))


def robust_median(values: FloatArray) -> tuple[float, float]:
    """Median of values (n,) and its standard error, for normal ones: 1.2533 sigma / sqrt(n)."""
    median = float(np.median(values))
    return median, 1.2533 * robust_rms(values - median) / float(np.sqrt(len(values)))


def rms_pull(pull: FloatArray) -> tuple[float, float]:
    """RMS of pulls (n, k) and its standard error, where values of a row may share errors: rows then scatter more."""
    square = (pull**2).mean(axis=1)
    rms = float(np.sqrt(square.mean()))
    chance = 1.0 / float(np.sqrt(2.0 * pull.size))
    return rms, max(chance, float(square.std(ddof=1)) / float(np.sqrt(len(square))) / (2.0 * rms))


def flux_snr(electrons: FloatArray, area_px2: FloatArray, *, noise_e2: float) -> FloatArray:
    """Signal-to-noise ratio of the flux measured with optimal weights; 0 without light.

    Its square is the sum over pixels of (N p)^2 / (N p + n), with fractions p of N electrons and noise n of a pixel.
    For a Gaussian image of noise-equivalent area A that is N (1 - u ln(1 + 1 / u)), u = A n / 2 N; for faint stars
    N^2 / A n for any image (I. R. King, PASP 95, 163 (1983)).
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        u = area_px2 * noise_e2 / (2.0 * electrons)
        # beyond 1e6 the difference of two ones has no digits left
        part = np.where(u < 1e6, 1.0 - u * np.log1p(1.0 / u), 0.5 / u)
    return np.asarray(np.sqrt(np.where(electrons > 0.0, electrons * np.nan_to_num(part, nan=1.0), 0.0)))
