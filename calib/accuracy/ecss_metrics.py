"""Attitude errors at a confidence level, in the terms of ECSS-E-ST-60-20C, annex B.

A series :math:`e_r(t)` has realisations r (sensors, attitudes in the sky) and times t. A level P is the fraction of
errors :math:`|e|` below the stated number; the interpretation states over which errors: *temporal*, over time for the
worst realisation; *ensemble*, over realisations at the worst time; *mixed*, over both.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import bdtr, betaincinv, erf, ndtri

from optics.arrays import FloatArray
from optics.errors import DomainError

Interpretation = Literal["temporal", "ensemble", "mixed"]


def _check_level(fraction: float, name: str = "level") -> None:
    if not 0.0 < fraction < 1.0:
        raise DomainError(f"{name} = {fraction:g}; a fraction between 0 and 1 is needed, e.g. 0.997")


def ecss_metrics(
    error: ArrayLike, window: int, level: float, interpretation: Interpretation = "mixed"
) -> dict[str, float]:
    """Measurement errors of an axis at a confidence level, from a series of errors (measured less true).

    Parameters
    ----------
    error : (r, t) or (t,)
        Realisations and times, in any unit; NaN where there is no measurement. Times that do not fill the last window
        are left out of all but AME.
    window : int
        Times of a window.
    level : float
        Fraction of the errors below the returned numbers, between 0 and 1.
    interpretation : "mixed", "temporal", "ensemble"
        What the fraction is taken over.

    Returns
    -------
    dict
        ``AME``: absolute, any error; ``MME``: mean over a window; ``RME``: relative, about the mean of its window;
        ``MDE``: drift, change of that mean from one window to the next (absent with a single window).

    Raises
    ------
    DomainError
        No whole window, no measurement, a level that is no fraction.
    """
    series = np.atleast_2d(np.asarray(error, float))
    count = series.shape[1] // window if window > 0 else 0
    if not count:
        raise DomainError(f"window of {window} times in {series.shape[1]}; at least one whole window is needed")
    parts = series[:, : count * window].reshape(len(series), count, window)
    measured = np.isfinite(parts)
    number = measured.sum(axis=2)
    mean = np.where(measured, parts, 0.0).sum(axis=2) / np.where(number > 0, number, np.nan)
    relative = (parts - mean[..., None]).reshape(len(series), -1)
    errors = {"AME": series, "MME": mean, "RME": relative} | ({"MDE": np.diff(mean, axis=1)} if count > 1 else {})
    return {name: bound_at_level(values, level, interpretation) for name, values in errors.items()}


def bound_at_level(error: ArrayLike, level: float, interpretation: Interpretation = "mixed") -> float:
    """Number below which the fraction ``level`` of the moduli of errors (realisations, times) lies; NaN is left out."""
    _check_level(level)
    size = np.abs(np.atleast_2d(np.asarray(error, float)))
    measured = np.isfinite(size)
    if not measured.any():
        raise DomainError("there is no finite error in the series; at least one is needed")
    if interpretation == "mixed":
        return float(np.quantile(size[measured], level))
    rows, finite = (size, measured) if interpretation == "temporal" else (size.T, measured.T)
    return max(float(np.quantile(row[at], level)) for row, at in zip(rows, finite, strict=True) if at.any())


def normal_factor(level: float) -> float:
    """Bound of the modulus of a normal error of mean zero, in standard deviations."""
    _check_level(level)
    return -float(ndtri(0.5 * (1.0 - level)))


def mixture_bound(sigma: FloatArray, level: float) -> float:
    """Bound of the modulus of normal errors whose standard deviations (n,) are equally likely; inf if it has none.

    An infinite standard deviation is a realisation without a solution.
    """
    _check_level(level)
    finite = sigma[np.isfinite(sigma)]
    largest = 10.0 * float(finite.max(initial=0.0))

    def excess(bound: float) -> float:
        return float(erf(bound / (np.sqrt(2.0) * finite)).sum()) / len(sigma) - level

    return float(brentq(excess, 0.0, largest, xtol=1e-15 * largest)) if largest and excess(largest) >= 0.0 else np.inf


def quantile_limit(values: FloatArray, fraction: float, confidence: float) -> float:
    """Upper confidence limit of a quantile from independent values (n,) of any distribution.

    The least value that exceeds the quantile with this confidence; inf if there are too few (Wilks 1941, Ann. Math.
    Stat. 12, 91).
    """
    _check_level(fraction, "fraction")
    _check_level(confidence, "confidence")
    ordered = np.sort(np.asarray(values, float))
    below = np.arange(len(ordered) + 1)  # so many of n values lie below the quantile at most
    rank = int(np.searchsorted(bdtr(below, len(ordered), fraction), confidence)) + 1
    return float(ordered[rank - 1]) if rank <= len(ordered) else np.inf


def success_limit(successes: int, runs: int, confidence: float) -> float:
    """Lower confidence limit of the probability of success (Clopper and Pearson 1934, Biometrika 26, 404)."""
    _check_level(confidence, "confidence")
    if not 0 <= successes <= runs:
        raise DomainError(f"{successes} successes in {runs} runs; between 0 and the number of runs are possible")
    return float(betaincinv(successes, runs - successes + 1, 1.0 - confidence)) if successes else 0.0


def runs_needed(fraction: float, confidence: float, failures: int = 0) -> int:
    """Runs after which this many failures at most show with this confidence that a fraction of all runs succeeds."""
    _check_level(fraction, "fraction")
    _check_level(confidence, "confidence")
    if failures < 0:
        raise DomainError(f"failures = {failures}; it must not be negative")
    low, high = failures, failures + 1
    while bdtr(failures, high, 1.0 - fraction) > 1.0 - confidence:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if bdtr(failures, middle, 1.0 - fraction) > 1.0 - confidence else (low, middle)
    return high
