"""Attitude errors at a confidence level, in the terms of ECSS-E-ST-60-20C, annex B.

A series :math:`e_r(t)` has realisations r (sensors, places in the sky) and times t. A level P is the share of errors
:math:`|e|` below the stated number; the interpretation states over which errors: *temporal*, over time for the worst
realisation; *ensemble*, over realisations at the worst time; *mixed*, over both.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.special import bdtr, erf, ndtri

from optics.arrays import FloatArray
from optics.errors import DomainError

Interpretation = Literal["temporal", "ensemble", "mixed"]


def _check_level(share: float, name: str = "level") -> None:
    if not 0.0 < share < 1.0:
        raise DomainError(f"{name} = {share:g}; a share between 0 and 1 is needed, e.g. 0.997")


def normal_factor(level: float) -> float:
    """Bound of the modulus of a normal error of mean zero, in standard deviations."""
    _check_level(level)
    return -float(ndtri(0.5 * (1.0 - level)))


def mixture_bound(sigma: FloatArray, level: float) -> float:
    """Bound of the modulus of normal errors whose standard deviations (n,) are equally likely; inf if it has none.

    An infinite standard deviation is a realisation without a solution.
    """
    _check_level(level)
    known = sigma[np.isfinite(sigma)]
    if not len(known) or len(known) < level * len(sigma):
        return np.inf
    low, high = 0.0, 10.0 * float(known.max())
    for _ in range(60):
        middle = 0.5 * (low + high)
        inside = float(erf(middle / (np.sqrt(2.0) * known)).sum()) / len(sigma)
        low, high = (middle, high) if inside < level else (low, middle)
    return high


def quantile_limit(values: FloatArray, share: float, confidence: float) -> float:
    """Upper confidence limit of a quantile from independent values (n,) of any distribution.

    The least value that exceeds the quantile with this confidence; inf if there are too few (Wilks 1941, Ann. Math.
    Stat. 12, 91).
    """
    _check_level(share, "share")
    _check_level(confidence, "confidence")
    ordered = np.sort(np.asarray(values, float))
    below = np.arange(len(ordered) + 1)  # so many of n values lie below the quantile at most
    rank = int(np.searchsorted(bdtr(below, len(ordered), share), confidence)) + 1
    return float(ordered[rank - 1]) if rank <= len(ordered) else np.inf


def runs_needed(share: float, confidence: float, failures: int = 0) -> int:
    """Runs after which at most a number of failures show, with this confidence, that a share of all runs succeeds."""
    _check_level(share, "share")
    _check_level(confidence, "confidence")
    if failures < 0:
        raise DomainError(f"failures = {failures}; it must not be negative")
    low, high = failures, failures + 1
    while bdtr(failures, high, 1.0 - share) > 1.0 - confidence:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if bdtr(failures, middle, 1.0 - share) > 1.0 - confidence else (low, middle)
    return high


def level_of(error: FloatArray, level: float, interpretation: Interpretation = "mixed") -> float:
    """Number below which the share ``level`` of the moduli of errors (realisations, times) lies."""
    _check_level(level)
    size = np.abs(np.atleast_2d(np.asarray(error, float)))
    if interpretation == "mixed":
        return float(np.quantile(size, level))
    return float(np.quantile(size, level, axis=1 if interpretation == "temporal" else 0).max())


def metrics(error: FloatArray, window: int, level: float, interpretation: Interpretation = "mixed") -> dict[str, float]:
    """Measurement errors of one axis (realisations, times), measured less true, at a level: share of the errors below.

    AME: any error; MME: mean over a window of times; RME: about the mean of its window; MDE: change of that mean from
    one window to the next (absent with a single one). What does not fill the last window is left out.
    """
    series = np.atleast_2d(np.asarray(error, float))
    count = series.shape[1] // window if window > 0 else 0
    if not count:
        raise DomainError(f"window of {window} times in {series.shape[1]}; at least one whole window is needed")
    parts = series[:, : count * window].reshape(len(series), count, window)
    mean = parts.mean(axis=2)
    about = (parts - mean[..., None]).reshape(len(series), -1)
    found = {"AME": series, "MME": mean, "RME": about} | ({"MDE": np.diff(mean, axis=1)} if count > 1 else {})
    return {name: level_of(one, level, interpretation) for name, one in found.items()}
