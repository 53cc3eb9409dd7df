"""Robust statistics of samples with a few outliers."""

from __future__ import annotations

import numpy as np

from calib.measure.detection_score import robust_rms
from optics.arrays import FloatArray

CLIP_SIGMA, FEWEST = 4.0, 8


def clipped_mean(values: FloatArray) -> float:
    """Mean without values (n,) beyond four robust standard deviations from the median; NaN with fewer than three."""
    known = values[np.isfinite(values)]
    if len(known) < 3:
        return float("nan")
    deviation = known - np.median(known)
    return float(known[np.abs(deviation) < CLIP_SIGMA * (robust_rms(deviation) + 1e-12)].mean())


def quantile_sigma(values: FloatArray) -> float:
    """Standard deviation by the quantiles 0.16 and 0.84; NaN with fewer than eight values."""
    known = values[np.isfinite(values)]
    return float(np.ptp(np.quantile(known, [0.16, 0.84]))) / 2.0 if len(known) >= FEWEST else float("nan")


def rms_within(vectors: FloatArray, length: float) -> float:
    """Root mean square per axis of vectors (n, 2) shorter than ``length``; NaN with fewer than eight."""
    near = np.hypot(*vectors.T) < length
    return float(np.sqrt((vectors[near] ** 2).mean())) if near.sum() >= FEWEST else float("nan")
