"""Detections against true positions: pairs, and limits that a sample allows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.stats import binom, norm

from optics.arrays import FloatArray, IntArray


class Pairs(NamedTuple):
    """Stars (n) and detections (m)."""

    detection: IntArray  # (n,) Detection of each star, -1 for none
    star: IntArray  # (m,) Nearest star of each detection, -1 without stars
    distance_px: FloatArray  # (m,) Its distance; infinite without stars


def nearest_pairs(star_px: FloatArray, detected_px: FloatArray, radius_px: ArrayLike) -> Pairs:
    """Stars (n, 2) and detections (m, 2) that are each other's nearest, within a radius, () or one per star (n,)."""
    stars, count = len(star_px), len(detected_px)
    if not stars or not count:
        return Pairs(np.full(stars, -1), np.full(count, -1), np.full(count, np.inf))
    distance, nearest = cKDTree(detected_px).query(star_px)
    star_distance, nearest_star = cKDTree(star_px).query(detected_px)
    mutual = (nearest_star[nearest] == np.arange(stars)) & (distance <= radius_px)
    return Pairs(np.where(mutual, nearest, -1), nearest_star, star_distance)


def robust_ratio_limit(count: int, margin: float, false_alarm: float) -> tuple[float, float]:
    """Relative standard error 1.166 / sqrt(2 n) of a robust scatter of 2 n values, and the limit that a ratio of
    ``margin`` to the true scatter exceeds with the probability ``false_alarm``."""
    spread = 1.166 / float(np.sqrt(2.0 * max(count, 1)))
    return spread, margin + float(norm.isf(false_alarm)) * spread


def missed_limit(count: int, fraction: float, false_alarm: float) -> float:
    """Fraction of missed stars that ``count`` stars, each missed with ``fraction``, exceed with a probability."""
    return float(binom.isf(false_alarm, max(count, 1), fraction)) / max(count, 1)


def rate_excess_sigma(count: int, exposures: int, other: int, other_exposures: int) -> float:
    """Difference of two Poisson rates over its standard deviation, one count added to each for small numbers."""
    spread = np.sqrt((count + 1) / exposures**2 + (other + 1) / other_exposures**2)
    return float((count / exposures - other / other_exposures) / spread)
