"""Robust statistics of samples with a few outliers."""

from __future__ import annotations

import numpy as np

from optics.arrays import FloatArray

CLIP_SIGMA, FEWEST = 4.0, 8
ROBUST_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution."""


def robust_rms(values: FloatArray) -> float:
    """Standard deviation of normal values of zero mean from the median of their absolute values."""
    return ROBUST_SIGMA * float(np.median(np.abs(values)))


def robust_sigma(values: FloatArray) -> float:
    """Standard deviation of normal values (n,) about their median, NaN left out."""
    values = values[np.isfinite(values)]
    return robust_rms(values - np.median(values))


def robust_scatter(deviation: FloatArray) -> tuple[float, float]:
    """Standard deviation of normal values (n, k) about their medians (k,), and its standard error.

    The variance of the median absolute deviation of N values, times 1.4826 squared, is 1.3604 sigma^2 / N.
    """
    sigma = robust_rms(deviation - np.median(deviation, axis=0))
    return sigma, sigma * float(np.sqrt(1.3604 / deviation.size))


def robust_median(values: FloatArray) -> tuple[float, float]:
    """Median of values (n,) and its standard error, for normal ones: 1.2533 sigma / sqrt(n)."""
    median = float(np.median(values))
    return median, 1.2533 * robust_rms(values - median) / float(np.sqrt(len(values)))


def rms_pull(pull: FloatArray) -> tuple[float, float]:
    """RMS of pulls (n, k) and its standard error; values of a row may have errors in common, which add scatter."""
    square = (pull**2).mean(axis=1)
    rms = float(np.sqrt(square.mean()))
    independent = 1.0 / float(np.sqrt(2.0 * pull.size))
    return rms, max(independent, float(square.std(ddof=1)) / float(np.sqrt(len(square))) / (2.0 * rms))


def clipped_mean(values: FloatArray) -> float:
    """Mean without values (n,) beyond four robust standard deviations from the median; NaN with fewer than three."""
    values = values[np.isfinite(values)]
    if len(values) < 3:
        return float("nan")
    deviation = values - np.median(values)
    return float(values[np.abs(deviation) < CLIP_SIGMA * (robust_rms(deviation) + 1e-12)].mean())


def quantile_sigma(values: FloatArray) -> float:
    """Standard deviation by the quantiles 0.16 and 0.84; NaN with fewer than eight values."""
    values = values[np.isfinite(values)]
    return float(np.ptp(np.quantile(values, [0.16, 0.84]))) / 2.0 if len(values) >= FEWEST else float("nan")


def rms_within(vectors: FloatArray, length: float) -> float:
    """Root mean square per axis of vectors (n, 2) shorter than ``length``; NaN with fewer than eight."""
    near = np.hypot(*vectors.T) < length
    return float(np.sqrt((vectors[near] ** 2).mean())) if near.sum() >= FEWEST else float("nan")
