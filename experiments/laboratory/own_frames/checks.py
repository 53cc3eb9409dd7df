"""What own frames say about themselves: gain, motion, noise, copies, the ends of the converter.

Every number has its own statistic, and none needs more than the frames:

``gain``
    Photon transfer (Janesick 2007; EMVA 1288 Release 4.0, sec. 6.6): the temporal variance of a pixel grows with its
    mean by K. What a moving image and a flickering lamp add is projected out frame by frame and window by window (the
    mean image, and itself shifted by whole pixels, of which a shift by parts of one is made); the variance that the
    projection takes from every pixel is accounted for.
``motion``
    What all points of a frame have in common. Without motion J times the variance of the common part over the variance
    of what is left of the points follows Fisher's F with (N - 1) and (N - 1)(J - 1) degrees of freedom; with a motion
    of the variance m^2 it is larger by 1 + J m^2 / s^2.
``noise``
    Variance of the centroids over the variance that the noise model predicts for them.
``copies``, ``step``, ``clipped``, ``zero``
    Frames of a series that equal another one; common divisor of all readings; how often the highest reading comes
    against the four below it; share of readings of 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve, shift
from scipy.stats import f as fisher_f
from scipy.stats import poisson

from experiments.harness.summary import Measured
from experiments.laboratory.own_frames.folder import FrameSeries
from experiments.laboratory.own_frames.series import SeriesFrames
from optics.arrays import FloatArray

__all__ = ["FALSE_ALARM", "MOTION_SHARE", "FrameChecks", "Motion", "check_frames", "common_motion", "photon_transfer"]

FALSE_ALARM = 1e-3
"""Probability that a check objects to frames that are as they should be."""
MOTION_SHARE = 0.21
"""Motion that raises the scatter of a point by 10 % is let pass: its variance over that of the point."""
FEWEST_FOR_MOTION = 3
TOP_READINGS = 5
FEWEST_PIXELS = 30
ITERATIONS = 8
SHIFTS = (-2, -1, 1, 2)
AROUND = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Common motion of the points of a series along an axis."""

    series: str  # Where
    axis: str  # Where
    rms_px: float  # Standard deviation of the common part from frame to frame, noise of the points included
    limit_px: float  # What it may be (see the module)
    drift_px: float  # Least-squares trend from the first frame to the last
    drift_share: float  # Part of the variance that the trend explains


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameChecks:
    """Of all series of a folder together."""

    gain_dn_per_e: Measured | None  # K by photon transfer; None without two frames in a series or enough light
    motion: Motion | None  # The largest against its limit; None for single points or fewer than three frames
    noise_ratio: Measured | None  # Standard deviation of a frame's centroid, measured over modelled
    copies: int  # Frames that equal another one of their series; of so many
    frames: int  # Frames that equal another one of their series; of so many
    step_dn: int  # Largest number that divides all differences of readings
    top_dn: int  # Highest reading, how often it comes, how often chance lets it come
    top_count: int  # Highest reading, how often it comes, how often chance lets it come
    top_limit: int  # Highest reading, how often it comes, how often chance lets it come
    zero_fraction: float  # Share of readings of 0


def check_frames(series: Sequence[FrameSeries], reduced: Sequence[SeriesFrames], method: str) -> FrameChecks:
    """Look at all series of a folder; ``method`` is the centroider that counts."""
    several = [one for one in series if len(one.windows.dn) > 1]
    motions = [
        motion
        for one in reduced
        for motion in common_motion(one.points.position_px[method], one.name, tests=2 * len(reduced))
    ]
    readings = [np.unique(_each_once(one), return_counts=True) for one in series]
    top, count, limit = _top(readings)
    every = sum(int(counts.sum()) for _, counts in readings)
    zero = sum(int(counts[values == 0].sum()) for values, counts in readings)
    steps = np.concatenate([np.diff(values.astype(np.int64)) for values, _ in readings])
    return FrameChecks(
        gain_dn_per_e=photon_transfer([one.windows.dn for one in several], [~one.windows.defect for one in several]),
        motion=max(motions, key=lambda one: one.rms_px / one.limit_px, default=None),
        noise_ratio=_noise_ratio(reduced, method),
        copies=sum(len(one.windows.dn) - len(_unique(one)) for one in series),
        frames=sum(len(one.windows.dn) for one in series),
        step_dn=int(np.gcd.reduce(steps)) if steps.size else 1,
        top_dn=top,
        top_count=count,
        top_limit=limit,
        zero_fraction=zero / every,
    )


def _unique(series: FrameSeries) -> list[int]:
    """Numbers of the frames of a series that equal none before them."""
    seen: dict[bytes, int] = {}
    for number, frame in enumerate(series.windows.dn):
        seen.setdefault(frame.tobytes(), number)
    return list(seen.values())


def _each_once(series: FrameSeries) -> NDArray[np.uint16]:
    """Readings of usable pixels, copies of frames left out."""
    return np.asarray(series.windows.dn[_unique(series)][:, ~series.windows.defect])


def _top(readings: Sequence[tuple[NDArray[np.uint16], NDArray[np.int64]]]) -> tuple[int, int, int]:
    """Highest reading, how often it comes, and how often a Poisson variate with the mean of the four below it would."""
    top = max(int(values[-1]) for values, _ in readings)
    steps = [int(np.diff(values.astype(np.int64)).min()) for values, _ in readings if len(values) > 1]
    step = min(steps, default=1)
    counts = np.zeros(TOP_READINGS, np.int64)
    for values, number in readings:
        below = (top - values.astype(np.int64)) // step
        near = below < TOP_READINGS
        np.add.at(counts, below[near], number[near])
    expected = max(float(counts[1:].mean()), 1.0)
    return top, int(counts[0]), int(poisson.isf(FALSE_ALARM, expected))


def common_motion(position_px: FloatArray, name: str, *, tests: int = 1) -> list[Motion]:
    """Common motion along x and y from centroids (f, j, 2); nothing for one point or fewer than three whole frames."""
    number = np.flatnonzero(np.isfinite(position_px).all((1, 2)))
    place = position_px[number]
    frames, points, _ = place.shape
    if points < 2 or frames < FEWEST_FOR_MOTION:
        return []
    apart = place - place.mean(0)
    common = apart.mean(1)
    left = ((apart - common[:, None]) ** 2).sum((0, 1)) / ((frames - 1) * (points - 1))
    quantile = float(fisher_f.isf(FALSE_ALARM / tests, frames - 1, (frames - 1) * (points - 1)))
    limit = np.sqrt(np.maximum(left, 1e-24) / points * quantile * (1.0 + points * MOTION_SHARE))
    time = (number - number.mean()) / (number[-1] - number[0])
    slope = time @ common / (time @ time)
    total = (common**2).sum(0)
    share = slope**2 * (time @ time) / np.where(total > 0, total, 1.0)
    rms = np.sqrt(total / (frames - 1))
    return [
        Motion(
            series=name,
            axis="xy"[a],
            rms_px=float(rms[a]),
            limit_px=float(limit[a]),
            drift_px=float(slope[a]),
            drift_share=float(share[a]),
        )
        for a in range(2)
    ]


def _noise_ratio(reduced: Sequence[SeriesFrames], method: str) -> Measured | None:
    """Root of the sum of measured variances over that of modelled ones, points, axes and series together."""
    seen = modelled = spread = 0.0
    samples = 0
    for one in reduced:
        if one.frames < 2:
            continue
        model = one.predicted_px(method) ** 2
        seen += float(np.nansum(one.points.sigma_px(method) ** 2) * (one.frames - 1))
        modelled += float(model.sum() * (one.frames - 1))
        spread += float(2.0 * (model**2).sum() * (one.frames - 1))
        samples += one.frames * len(model)
    if not modelled:
        return None
    ratio = float(np.sqrt(seen / modelled))
    return Measured(value=ratio, uncertainty=0.5 * float(np.sqrt(spread)) / modelled, n=samples)


def photon_transfer(dn: Sequence[NDArray[np.uint16]], usable: Sequence[NDArray[np.bool_]]) -> Measured | None:
    """System gain K [DN/e-] by the growth of the temporal variance of pixels with their mean.

    Offsets differ from pixel to pixel, so that the mean of a pixel is its light with an error, which would lower the
    slope of least squares; the mean of its neighbours has the light without that error and serves as the instrument
    (Durbin 1954). Offsets that scatter by 3 % of the brightest pixel still lower K by some 6 %. The standard deviation
    is that of White (1980): it needs no word about how read noise differs.
    """
    parts = [_window_variances(np.asarray(one, float), ok) for one, ok in zip(dn, usable, strict=True)]
    if not parts or sum(len(variance) for variance, *_ in parts) < FEWEST_PIXELS:
        return None
    variance, design, instrument, degrees = (np.concatenate(column) for column in zip(*parts, strict=True))
    weight = degrees / np.maximum(np.full(len(variance), variance.mean()), 1e-12) ** 2
    for _ in range(ITERATIONS):
        back = np.linalg.pinv(instrument.T @ (weight[:, None] * design))
        found = back @ (instrument.T @ (weight * variance))
        expected = np.maximum(design @ found, max(1e-3 * float(variance.mean()), 1e-12))
        weight = degrees / expected**2
    moved = back @ (instrument * (weight * (variance - design @ found))[:, None]).T
    covariance = moved @ moved.T
    return Measured(value=float(found[1]), unit="DN/e-", uncertainty=float(np.sqrt(covariance[1, 1])), n=len(variance))


def _window_variances(
    dn: FloatArray, usable: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Temporal variances (n,) of pixels, what multiplies (floor, K) in their expectation (n, 2), degrees of freedom.

    Third of four: the same with the mean of a pixel's neighbours in place of its own (n, 2).

    With M the projection on what is neither the mean image nor a shifted one, the residual of pixel i has the variance
    sum_k M_ik^2 v_k, v_k = floor + K mean_k.
    """
    frames = len(dn)
    variances, designs, instruments = [], [], []
    for number in range(dn.shape[1]):
        mean, ok = dn[:, number].mean(0), usable[number]
        edge = np.ones(mean.shape, bool)
        edge[1:-1, 1:-1] = False
        light = mean - np.median(mean[edge])
        moved = [shift(light, at, order=0) for step in SHIFTS for at in ((step, 0), (0, step))]
        modes = np.stack([light, *moved], axis=-1)[ok]
        base = np.linalg.qr(modes / np.maximum(np.linalg.norm(modes, axis=0), 1e-300))[0]
        keep = np.eye(len(base)) - base @ base.T
        left = (dn[:, number][:, ok] - mean[ok]) @ keep
        taken = keep**2
        variances.append((left**2).sum(0) / (frames - 1))
        around = convolve(np.where(ok, mean, 0.0), AROUND) / np.maximum(convolve(ok.astype(float), AROUND), 1.0)
        designs.append(np.column_stack([taken.sum(1), taken @ mean[ok]]))
        instruments.append(np.column_stack([taken.sum(1), taken @ around[ok]]))
    variance = np.concatenate(variances)
    return variance, np.concatenate(designs), np.concatenate(instruments), np.full(len(variance), frames - 1.0)
