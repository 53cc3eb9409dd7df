"""Numbers of consecutive frames of a scene at rest: jump, drift, correlation from frame to frame, scatter over a model.

``largest_change``
    Least squares of a step between two frames, of a single outlying frame, of a trend, against the residual scatter of
    each; Student's t, with Bonferroni's factor for all possible positions of a change.
``lag_one``
    Correlation of a frame with the next one. For white noise its moments are known for any variance (Henshaw 1966,
    Econometrica 34, 646, who also has the beta distribution between the extreme eigenvalues).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import beta
from scipy.stats import t as student_t

from optics.arrays import FloatArray

FEWEST_FOR_CHANGE = 4
"""Frames from which a change is looked for."""
FEWEST_FOR_LAG = 6
"""With fewer the beta distribution is not that of the correlation (three times the stated false alarm with four)."""
CHANCE_SIGMA = 3.0
"""Standard deviations up to which points that move alike are so by chance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """The most significant change of a number over consecutive frames."""

    kind: Literal["step", "frame", "drift"]
    frame: int  # First frame after the step; the frame that is off; the last one
    size: float  # By how much; of a drift from the first frame to the last
    error: float  # Its standard deviation
    limit: float  # Size that noise reaches with the stated false alarm


def largest_change(values: ArrayLike, *, false_alarm: float) -> Change | None:
    """The change of a number (n,) that is most significant; None for fewer than four frames, or without any change."""
    track = np.asarray(values, float)
    count = len(track)
    if count < FEWEST_FOR_CHANGE or not np.ptp(track) > 0.0:
        return None
    deviation = track - track.mean()
    after, time = np.arange(1, count), np.linspace(-0.5, 0.5, count)
    projection = np.concatenate([-np.cumsum(deviation)[:-1], deviation, [time @ deviation]])
    norm2 = np.concatenate([after * (count - after) / count, np.full(count, 1.0 - 1.0 / count), [time @ time]])
    residual = np.maximum(deviation @ deviation - projection**2 / norm2, 1e-30) / (count - 2)
    best = int(np.argmax(projection**2 / norm2))
    size = float(projection[best] / norm2[best])
    error = float(np.sqrt(residual[best] / norm2[best]) * _wander(deviation - size * _shape(best, count, time)))
    kind: Literal["step", "frame", "drift"] = "step"
    frame = best + 1
    if best >= count - 1:
        kind, frame = ("frame", best - count + 1) if best < 2 * count - 1 else ("drift", count - 1)
    elif best in (0, count - 2):  # a step at the end is a frame that is off
        kind, frame = "frame", 0 if best == 0 else count - 1
    return Change(
        kind=kind,
        frame=frame,
        size=-size if kind == "frame" and best == 0 else size,
        error=error,
        limit=error * float(student_t.isf(false_alarm / (4.0 * count), count - 2)),
    )


def _shape(index: int, count: int, time: FloatArray) -> FloatArray:
    """The change with a number, without its mean: steps, single frames, the trend."""
    if index >= 2 * count - 1:
        return time
    number = np.arange(count)
    shape = np.asarray(number > index if index < count - 1 else number == index - count + 1, float)
    return np.asarray(shape - shape.mean())


def _wander(residual: FloatArray) -> float:
    """Factor of errors of the mean where residuals are correlated from frame to frame: wander is no jump."""
    count = len(residual)
    rho = float(residual[1:] @ residual[:-1]) / max(float(residual @ residual), 1e-300) + 1.0 / count
    return float(np.sqrt((1.0 + rho) / (1.0 - rho))) if rho > 2.0 / np.sqrt(count) else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LagOne:
    """Correlation of frames with the next one, above what white noise has on average."""

    correlation: float
    limit: float  # Size that white noise reaches with the stated false alarm


def lag_one(values: ArrayLike, *, independent: float, false_alarm: float) -> LagOne | None:
    """Mean correlation of m numbers (n, m) with their next value, ``independent`` of them; None below six frames."""
    rows = np.asarray(values, float)
    count = len(rows)
    if count < FEWEST_FOR_LAG or independent <= 0:
        return None
    deviation = rows - rows.mean(0)
    square = (deviation**2).sum(0)
    if not (square > 0.0).all():
        return None
    measured = float(((deviation[1:] * deviation[:-1]).sum(0) / square).mean())
    free = count - 1.0
    mean = -1.0 / count  # of the eigenvalues of the lag, projected on what has no mean; then that of their squares
    second = (free / 2.0 - 2.0 * (count - 1.5) / count + (free / count) ** 2) / free
    variance = 2.0 * (second - mean**2) / (free + 2.0) / independent
    high = float(np.cos(np.pi / (count + 1.0)))
    middle = (mean + high) / (2.0 * high)
    size = middle * (1.0 - middle) * (2.0 * high) ** 2 / variance - 1.0
    sides = beta.ppf([false_alarm / 2.0, 1.0 - false_alarm / 2.0], middle * size, (1.0 - middle) * size)
    low, top = 2.0 * high * sides - high - mean
    correlation = measured - mean
    return LagOne(correlation=correlation, limit=float(top if correlation > 0 else -low))


def effective_frames(frames: int, correlation: float) -> float:
    """Independent frames whose mean is as good as that of frames correlated as rho^lag (Bayley and Hammersley 1946)."""
    rho = min(max(correlation, 0.0), 0.99)
    return max(frames * (1.0 - rho) / (1.0 + rho), 1.0)


def common_part(position_px: FloatArray) -> float:
    """Mean squared correlation of the points' positions (f, n, 2) with each other, 0 where it is no more than chance.

    A mean over n points whose scatters are so alike has the error of n / (1 + (n - 1) x this) of them.
    """
    frames, points, _ = position_px.shape
    if points < 2 or frames < 3:
        return 0.0
    unit = position_px - position_px.mean(0)
    unit = unit / np.maximum(np.linalg.norm(unit, axis=0), 1e-300)
    squares = np.einsum("fja,fka->ajk", unit, unit) ** 2
    between = float(squares.sum() - 2 * points) / (2 * points * (points - 1))
    excess, chance = between * (frames - 1) - 1.0, np.sqrt(2.0 / (points * (points - 1)))
    return excess / (frames - 1) if excess > CHANCE_SIGMA * chance else 0.0


def scatter_ratio(
    variance: ArrayLike, predicted: ArrayLike, *, degrees: ArrayLike, effective_fraction: ArrayLike = 1.0
) -> tuple[float, float]:
    """Root of the sum of measured variances over that of predicted ones, and its standard error.

    Shapes (k,): normal samples of the variance ``variance`` with ``degrees`` of freedom; ``effective_fraction`` is the
    number of independent frames over that of frames, where these are correlated.
    """
    predicted, degrees = np.asarray(predicted, float), np.asarray(degrees, float)
    total = float((predicted * degrees).sum())
    spread = float((2.0 * predicted**2 * degrees / np.asarray(effective_fraction, float)).sum())
    ratio = float(np.sqrt((np.asarray(variance, float) * degrees).sum() / total))
    return ratio, 0.5 * float(np.sqrt(spread)) / total
