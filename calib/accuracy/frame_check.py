"""Centroids and detections of frames, of any origin, against their prediction (`calib.accuracy.star_errors`)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from calib.accuracy.star_errors import DetectionLimit, StarErrors
from optics.arrays import FloatArray

MODEL_FRACTION, MODEL_MAG = 0.03, 0.05
"""Error of the prediction's simplifications (fields between five, PSFs in cells, a linear response), three standard
deviations."""
WIDEST_MAG = 3.0
"""Largest shift of the detection limit that is sought."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredAgainst:
    """A measured and a predicted quantity, and the standard deviation of their difference."""

    measured: float
    predicted: float
    error: float
    n: int  # Samples


def centroid_scatter(
    error_px: FloatArray, electrons: FloatArray, radius_px: FloatArray, stars: StarErrors, limit: DetectionLimit
) -> MeasuredAgainst:
    """Scatter over k readouts of n stars, RMS per axis [px], against the predicted noise.

    The stated error counts the sample, the prediction between its fields (a quarter of the change from one to the
    next), and that pixels differ in read noise: of the some 4 pi s^2 under a star each has another.

    Shapes: ``error_px`` (k, n, 2), ``electrons``, ``radius_px`` (n,).
    """
    readouts, count = error_px.shape[:2]
    noise_px, samples = stars.centroid.noise_px, 2 * count * (readouts - 1)
    predicted = stars.rms_at(noise_px, electrons, radius_px)
    knots = np.log(stars.sigma_at(noise_px, np.full_like(stars.radius_px, electrons.mean()), stars.radius_px))
    gap = np.clip(np.searchsorted(stars.radius_px, radius_px) - 1, 0, len(knots) - 2)
    model = max(MODEL_FRACTION, 0.25 * float(np.sqrt((np.diff(knots)[gap] ** 2).mean())))
    pixels = max(4.0 * np.pi * limit.sigma_px**2 * count, 1.0)
    chips = 0.5 * np.sqrt(limit.frame.spread_e4 / pixels) / limit.frame.pixel.floor_e2
    return MeasuredAgainst(
        measured=float(np.sqrt(error_px.var(axis=0, ddof=1).mean())),
        predicted=predicted,
        error=predicted * math.hypot(1.0 / math.sqrt(2.0 * samples), chips, model / 3.0),
        n=samples,
    )


def limit_shift(
    detected: FloatArray, electrons: FloatArray, radius_px: FloatArray, stars: StarErrors
) -> tuple[float, float]:
    """Shift [mag] of the predicted completeness that makes stars detected as often as they were, and its error.

    NaN beyond `WIDEST_MAG`. ``detected`` (n,): fraction of the readouts in which a star is detected, whose places in
    their pixels differ from star to star, not from readout to readout.
    """

    def probability(shift_mag: float) -> FloatArray:
        return stars.detected_at(electrons * 10.0 ** (0.4 * shift_mag), radius_px)

    def excess(shift_mag: float) -> float:
        return float(probability(shift_mag).mean() - detected.mean())

    inside = excess(-WIDEST_MAG) < 0.0 < excess(WIDEST_MAG)
    shift = float(brentq(excess, -WIDEST_MAG, WIDEST_MAG)) if inside else float("nan")
    slope = (excess(0.02) - excess(-0.02)) / 0.04
    spread = (detected - probability(0.0)).std(ddof=1) / np.sqrt(len(detected))
    return shift, math.hypot(spread / slope, MODEL_MAG / 3.0)


def rms_against_sigma(error: FloatArray, sigma: FloatArray) -> MeasuredAgainst:
    """Root mean square of normal errors, any shape, against that of their standard deviations."""
    predicted = float(np.sqrt((sigma**2).mean()))
    return MeasuredAgainst(
        measured=float(np.sqrt((error**2).mean())),
        predicted=predicted,
        # the mean square of normal errors of different sigma
        error=float(np.sqrt(2.0 * (sigma**4).sum())) / error.size / (2.0 * predicted),
        n=error.size,
    )


def false_alarms_against(counts: FloatArray, per_frame: float, dark_frames: int) -> MeasuredAgainst:
    """False alarms in k frames: Poisson, but the noise of the mean dark frame repeats in all; to a tenth."""
    predicted = per_frame * len(counts)
    repeated = 1.0 + len(counts) / (1.0 + dark_frames)
    return MeasuredAgainst(
        measured=float(counts.sum()),
        predicted=predicted,
        error=float(np.sqrt(predicted * repeated + 1.0 + (0.1 * predicted) ** 2)),
        n=int(counts.sum()),
    )
