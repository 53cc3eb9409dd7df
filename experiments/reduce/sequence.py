"""Tests of the sequence of frames: jumps, drift, correlation from frame to frame, repeated noise.

``largest_change``
    Least squares of a step between two frames, of a single outlying frame, of a trend, against the residual scatter of
    each; Student's t, with Bonferroni's factor for all possible positions of a change.
``lag_one``
    Correlation of a frame with the next one. For white noise its moments are known for any variance (Henshaw 1966,
    Econometrica 34, 646, who also has the beta distribution between the extreme eigenvalues).
``shared_noise``
    Correlation of the noise of all pixels between two frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import shift
from scipy.stats import beta, norm
from scipy.stats import t as student_t

from optics.arrays import FloatArray

FALSE_ALARM = 1e-3
"""Probability that a check objects to frames that are as they should be."""
FEWEST = 4
"""Smallest number of frames for tests of their order."""
FEWEST_FOR_LAG = 6
"""With fewer the beta distribution is not that of the correlation (three times the stated false alarm with four)."""
SHIFTS = (-2, -1, 1, 2)
SHARED = 0.2
"""Tolerated correlation of the noise of two frames: crosstalk and slow patterns make some of it."""
MANY_PAIRS = 28
MOST_PIXELS = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """The most significant change of a number over the frames of a series."""

    series: str  # Where
    what: str  # Of what
    kind: Literal["step", "frame", "drift"]
    frame: str  # First frame after the step; the frame that is off; the last one
    before: str  # The frame before it
    size: float  # By how much; of a drift from the first frame to the last
    error: float  # Its standard deviation
    limit: float  # Size that noise reaches with the stated false alarm

    @property
    def value(self) -> float:
        """The same as ``size``."""
        return self.size

    @property
    def found(self) -> bool:
        """Whether it is more than noise."""
        return abs(self.size) > self.limit

    def words(self, format: str, unit: str) -> str:
        """Frame, change and size in words."""
        size = f"{self.size:{format}} ± {self.error:{format.lstrip('+')}}{unit}"
        if self.kind == "drift":
            return f"{self.what} drifts by {size} from the first to the last frame of {self.series}"
        if self.kind == "frame":
            return f"{self.what} is off by {size} in {self.frame} alone ({self.series})"
        return f"{self.what} jumps by {size} between {self.before} and {self.frame} ({self.series})"


def largest_change(
    track: FloatArray, names: Sequence[str], series: str, what: str, *, false_alarm: float
) -> Change | None:
    """The change (see the module) of a number (n,) that is most significant; None for fewer than four frames."""
    count = len(track)
    if count < FEWEST or not np.ptp(track) > 0.0:
        return None
    apart = track - track.mean()
    after = np.arange(1, count)
    time = np.linspace(-0.5, 0.5, count)
    along = np.concatenate([-np.cumsum(apart)[:-1], apart, [time @ apart]])
    norm2 = np.concatenate([after * (count - after) / count, np.full(count, 1.0 - 1.0 / count), [time @ time]])
    left = np.maximum(apart @ apart - along**2 / norm2, 1e-30) / (count - 2)
    place = int(np.argmax(along**2 / norm2))
    size = float(along[place] / norm2[place])
    error = float(np.sqrt(left[place] / norm2[place]) * _wander(apart - size * _shape(place, count, time)))
    kind: Literal["step", "frame", "drift"] = "step"
    frame = place + 1
    if place >= count - 1:
        kind, frame = ("frame", place - count + 1) if place < 2 * count - 1 else ("drift", count - 1)
    elif place in (0, count - 2):  # a step at the end is a frame that is off
        kind, frame = "frame", 0 if place == 0 else count - 1
    return Change(
        series=series,
        what=what,
        kind=kind,
        frame=names[frame],
        before=names[max(frame - 1, 0)],
        size=-size if kind == "frame" and place == 0 else size,
        error=error,
        limit=error * float(student_t.isf(false_alarm / (4.0 * count), count - 2)),
    )


def _shape(place: int, count: int, time: FloatArray) -> FloatArray:
    """The change with a number, without its mean: steps, single frames, the trend."""
    if place >= 2 * count - 1:
        return time
    number = np.arange(count)
    shape = np.asarray(number > place if place < count - 1 else number == place - count + 1, float)
    return np.asarray(shape - shape.mean())


def _wander(left: FloatArray) -> float:
    """Factor of errors of the mean where what is left is correlated from frame to frame: wander is no jump."""
    count = len(left)
    rho = float(left[1:] @ left[:-1]) / max(float(left @ left), 1e-300) + 1.0 / count
    return float(np.sqrt((1.0 + rho) / (1.0 - rho))) if rho > 2.0 / np.sqrt(count) else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Lag:
    """Correlation of frames with the next one, above what white noise has on average."""

    series: str  # Where
    what: str  # Of what
    value: float  # Correlation
    limit: float  # Which white noise reaches with the stated false alarm


def lag_one(rows: FloatArray, series: str, what: str, *, independent: float, false_alarm: float) -> Lag | None:
    """Mean correlation of rows (n, m) with their next value, ``independent`` of them; None below six frames."""
    count = len(rows)
    if count < FEWEST_FOR_LAG or independent <= 0:
        return None
    apart = rows - rows.mean(0)
    square = (apart**2).sum(0)
    if not (square > 0.0).all():
        return None
    found = float(((apart[1:] * apart[:-1]).sum(0) / square).mean())
    free = count - 1.0
    mean = -1.0 / count  # of the eigenvalues of the lag, projected on what has no mean; then that of their squares
    second = (free / 2.0 - 2.0 * (count - 1.5) / count + (free / count) ** 2) / free
    variance = 2.0 * (second - mean**2) / (free + 2.0) / independent
    high = float(np.cos(np.pi / (count + 1.0)))
    middle = (mean + high) / (2.0 * high)
    size = middle * (1.0 - middle) * (2.0 * high) ** 2 / variance - 1.0
    sides = beta.ppf([false_alarm / 2.0, 1.0 - false_alarm / 2.0], middle * size, (1.0 - middle) * size)
    low, top = 2.0 * high * sides - high - mean
    value = found - mean
    return Lag(series=series, what=what, value=value, limit=float(top if value > 0 else -low))


def position_lags(position_px: FloatArray, series: str, *, tests: int) -> tuple[Lag, ...]:
    """Correlations of centroids (f, j, 2) of a series, one of ``tests``: of all points together, x and y, and apart."""
    place = position_px[np.isfinite(position_px).all((1, 2))]
    points, alarm = place.shape[1], FALSE_ALARM / (3 * tests)
    common = place.mean(1)
    apart = (place - common[:, None]).reshape(len(place), -1)
    every = [
        lag_one(common[:, :1], series, "x of all points", independent=1, false_alarm=alarm),
        lag_one(common[:, 1:], series, "y of all points", independent=1, false_alarm=alarm),
        lag_one(apart, series, "the points' own motion", independent=2 * (points - 1), false_alarm=alarm),
    ]
    return tuple(one for one in every if one is not None)


def effective_frames(frames: int, correlation: float) -> float:
    """Independent frames whose mean is as good as that of frames correlated as rho^lag (Bayley and Hammersley 1946)."""
    rho = min(max(correlation, 0.0), 0.99)
    return max(frames * (1.0 - rho) / (1.0 + rho), 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shared:
    """The two frames of a series whose noise is most alike."""

    series: str  # Where
    frames: tuple[str, str]
    value: float  # Correlation of their noise over the pixels
    limit: float  # Which independent noise reaches with the stated false alarm


def without_modes(dn: FloatArray, usable: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Frames (n, h, w) of a window without the contributions of a moving image and a flickering lamp: (n, p), and the
    projector."""
    mean = dn.mean(0)
    edge = np.ones(mean.shape, bool)
    edge[1:-1, 1:-1] = False
    light = mean - np.median(mean[edge])
    moved = [shift(light, at, order=0) for step in SHIFTS for at in ((step, 0), (0, step))]
    modes = np.stack([light, *moved], axis=-1)[usable]
    base = np.linalg.qr(modes / np.maximum(np.linalg.norm(modes, axis=0), 1e-300))[0]
    keep = np.eye(len(base)) - base @ base.T
    return (dn[:, usable] - mean[usable]) @ keep, keep


def shared_noise(
    dn: NDArray[np.uint16], usable: NDArray[np.bool_], names: Sequence[str], series: str, *, false_alarm: float
) -> Shared | None:
    """The two of n frames (n, j, h, w) whose noise is most alike; None for fewer than four."""
    count = len(dn)
    if count < FEWEST:
        return None
    left = np.hstack([without_modes(dn[:, j].astype(float), ok)[0] for j, ok in enumerate(usable) if ok.any()])
    left = left[:, :: -(-left.shape[1] // MOST_PIXELS)]
    scale = left.std(0)
    unit = left[:, scale > 0] / scale[scale > 0]
    unit /= np.maximum(np.linalg.norm(unit, axis=1, keepdims=True), 1e-300)
    pairs = np.triu_indices(count, 1)
    alike = (unit @ unit.T)[pairs] + 1.0 / (count - 1)
    spread = 1.0 / np.sqrt(unit.shape[1])
    if len(alike) >= MANY_PAIRS:  # neighbouring pixels may share noise: fewer of them than there are
        spread = max(spread, 1.4826 * float(np.median(np.abs(alike - np.median(alike)))))
    worst = int(np.argmax(alike))
    return Shared(
        series=series,
        frames=(names[pairs[0][worst]], names[pairs[1][worst]]),
        value=float(alike[worst]),
        limit=max(SHARED, spread * float(norm.isf(false_alarm / len(alike)))),
    )
