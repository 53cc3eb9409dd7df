"""Gain, noise and fixed pattern from photon transfer on the sky, without lamp and dark frames.

Blocks of 32 px have a level and a variance after a quadratic surface is subtracted, stars are masked and outliers are
clipped (the variance is corrected for the truncation). The pattern common to all frames is separated by the covariance
of two frames' residuals, pixel by pixel: DSNU^2 + PRNU^2 m_i m_j. The rest follows EMVA 1288,

    var = read noise^2 + 1/12 + (mean - black level) / gain         [DN^2; gain in e-/DN].

Frames of the sky do not determine the black level: read noise and black level are given as an interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from experiments.harness.summary import Measured
from optics.arrays import FloatArray
from optics.errors import DomainError

BLOCK_PX = 32
CLIP_SIGMA = 3.5
CLIP_ROUNDS = 4
FEWEST_OF_A_BLOCK = 0.4
"""Share of the pixels of a block that must be left for it to count."""
QUANTISATION_DN2 = 1.0 / 12.0
SURE_SIGMA = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Blocks:
    """A frame in blocks: residual without stars and without its smooth background."""

    left_dn: FloatArray  # (h, w) Residuals; NaN where masked or clipped
    level_dn: FloatArray  # (b,) Mean of the blocks
    variance_dn2: FloatArray  # (b,) Corrected for the truncation; NaN where too few pixels are left
    count: NDArray[np.int64]  # (b,) Pixels

    @property
    def columns(self) -> int:
        """Blocks in a row of them."""
        return self.left_dn.shape[1] // BLOCK_PX


def blocks_of(dn: FloatArray, masked: NDArray[np.bool_]) -> Blocks:
    """Residuals of a frame (h, w) about a quadratic surface in every block."""
    rows, columns = dn.shape[0] // BLOCK_PX, dn.shape[1] // BLOCK_PX
    if rows < 2 or columns < 2:
        raise DomainError(
            f"frames of {dn.shape[1]} x {dn.shape[0]} px; at least {2 * BLOCK_PX} x {2 * BLOCK_PX} are needed"
        )

    def cut(values: NDArray[np.generic]) -> NDArray[np.generic]:
        whole = values[: rows * BLOCK_PX, : columns * BLOCK_PX].reshape(rows, BLOCK_PX, columns, BLOCK_PX)
        return whole.transpose(0, 2, 1, 3).reshape(rows * columns, -1)

    values, good = np.asarray(cut(dn), float), ~np.asarray(cut(masked), bool)
    y, x = np.divmod(np.arange(BLOCK_PX**2), BLOCK_PX)
    x, y = (2.0 * one / (BLOCK_PX - 1) - 1.0 for one in (x, y))
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    kept = 1.0 - 2.0 * CLIP_SIGMA * norm.pdf(CLIP_SIGMA) / (2.0 * norm.cdf(CLIP_SIGMA) - 1.0)
    left = np.zeros_like(values)
    for _ in range(CLIP_ROUNDS):
        w = good.astype(float)
        normal = np.einsum("bp,pi,pj->bij", w, design, design, optimize=True) + 1e-9 * np.eye(6)
        right = (w * values) @ design
        left = values - np.linalg.solve(normal, right[:, :, None])[:, :, 0] @ design.T
        count = good.sum(axis=1)
        variance = (w * left**2).sum(axis=1) / np.maximum(count - 6, 1) / kept
        good &= np.abs(left) < CLIP_SIGMA * np.sqrt(variance)[:, None]
    count = good.sum(axis=1)
    enough = count > FEWEST_OF_A_BLOCK * BLOCK_PX**2
    variance = np.where(good, left**2, 0.0).sum(axis=1) / np.maximum(count - 6, 1) / kept
    level = np.where(good, values, 0.0).sum(axis=1) / np.maximum(count, 1)
    image = np.full(dn.shape, np.nan)
    whole = np.where(good & enough[:, None], left, np.nan).reshape(rows, columns, BLOCK_PX, BLOCK_PX)
    image[: rows * BLOCK_PX, : columns * BLOCK_PX] = whole.transpose(0, 2, 1, 3).reshape(
        rows * BLOCK_PX, columns * BLOCK_PX
    )
    return Blocks(
        left_dn=image, level_dn=level, variance_dn2=np.where(enough, variance, np.nan), count=count.astype(np.int64)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseFit:
    """Detector noise from the sky."""

    gain_e_per_dn: Measured
    intercept_dn2: Measured  # Temporal variance extrapolated to the lowest black level
    dsnu_dn: Measured
    prnu_fraction: Measured
    third_dn3: Measured  # Third moment of the pattern: warm pixels that no mask tells
    read_noise_e: tuple[float, float]  # For the lowest and the highest black level
    black_level_dn: tuple[float, float]  # That the frames allow
    levels_dn: FloatArray  # (k,) Photon transfer curve in bins of the mean
    variances_dn2: FloatArray  # (k,) Total variance of a pixel about its background
    correlation: FloatArray  # (3,) Of neighbours along x, y and the diagonal
    averaging: FloatArray  # (3,) Noise of means of 2, 8, 32 px squares over that of white noise

    def variance_dn2(self, mean_dn: FloatArray | float) -> FloatArray:
        """Total variance of a pixel, pattern included."""
        mean = np.maximum(np.asarray(mean_dn, float) - self.black_level_dn[0], 0.0)
        pattern = self.dsnu_dn.value**2 + (self.prnu_fraction.value * mean) ** 2
        return np.asarray(self.intercept_dn2.value + mean / self.gain_e_per_dn.value + pattern)


def fit_noise(frames: Sequence[Blocks], *, lowest_dn: float, black_level_dn: float | None = None) -> NoiseFit:
    """Photon transfer of all blocks of all frames; the black level, if it is not known, is not above ``lowest_dn``."""
    black = (0.0, max(float(lowest_dn), 0.0)) if black_level_dn is None else (black_level_dn, black_level_dn)
    if black[0]:
        frames = [replace(one, level_dn=one.level_dn - black[0]) for one in frames]
    level = np.concatenate([one.level_dn for one in frames])
    variance = np.concatenate([one.variance_dn2 for one in frames])
    frame = np.repeat(np.arange(len(frames)), [len(one.level_dn) for one in frames])
    weight = np.concatenate([one.count for one in frames]).astype(float)
    good = np.isfinite(variance)
    level, variance, frame, weight = level[good], variance[good], frame[good], weight[good]
    if not len(level):
        raise DomainError("no part of the frames is free of stars; gain and noise cannot be measured")
    dsnu2, prnu2 = _pattern(frames)
    temporal = variance - dsnu2.value - prnu2.value * level**2
    coefficients, covariance = _line(level, temporal, weight, frame)
    # the pattern's own error moves the slope: d slope = -d(PRNU^2) * slope of mean^2 on mean
    steep = np.polyfit(level, level**2, 1, w=np.sqrt(weight))
    slope_error = float(np.hypot(np.sqrt(covariance[0, 0]), (prnu2.uncertainty or 0.0) * abs(steep[0])))
    offset_error = float(
        np.sqrt(covariance[1, 1] + (dsnu2.uncertainty or 0.0) ** 2 + ((prnu2.uncertainty or 0.0) * steep[1]) ** 2)
    )
    slope, intercept = coefficients
    if not slope > 4.0 * slope_error:
        raise DomainError(
            f"photon transfer: variance rises by {slope:.3g} +/- {slope_error:.2g} DN^2 per DN over backgrounds from "
            f"{level.min():.4g} to {level.max():.4g} DN; the gain is not determined: frames with different "
            "backgrounds are needed"
        )
    gain = 1.0 / slope
    read = tuple(
        float(np.sqrt(max(intercept - QUANTISATION_DN2 + slope * (one - black[0]), 0.0)) * gain) for one in black
    )
    order = np.argsort(level)
    bins = np.array_split(order, min(24, max(len(order) // 20, 1)))
    return NoiseFit(
        gain_e_per_dn=Measured(value=gain, uncertainty=slope_error * gain**2, n=len(level)),
        intercept_dn2=Measured(value=intercept, uncertainty=offset_error),
        dsnu_dn=_root(dsnu2),
        prnu_fraction=_root(prnu2),
        third_dn3=_third(frames),
        read_noise_e=(read[0], read[1]),
        black_level_dn=black,
        levels_dn=np.array([level[one].mean() for one in bins]) + black[0],
        variances_dn2=np.array([np.average(variance[one], weights=weight[one]) for one in bins]),
        correlation=correlation_of(frames),
        averaging=whiteness(frames),
    )


def _root(square: Measured) -> Measured:
    value = float(np.sqrt(max(square.value, 0.0)))
    error = float(square.uncertainty or 0.0)
    return Measured(value=value, uncertainty=error / (2.0 * value) if value > 0 else float(np.sqrt(error)))


def _line(x: FloatArray, y: FloatArray, weight: FloatArray, frame: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Slope and intercept of variances, each with an uncertainty equal to its value, and their covariance, with errors
    that the blocks of a frame share (sandwich over frames) if there are enough frames."""
    coefficients = np.array([0.0, float(np.median(y))])
    design = np.stack([x, np.ones_like(x)], axis=1)
    w = weight
    for _ in range(4):
        expected = np.maximum(design @ coefficients, 1e-3 * float(np.median(y)) + 1e-9)
        w = weight / (2.0 * expected**2)
        coefficients = np.linalg.solve(design.T @ (w[:, None] * design), design.T @ (w * y))
        pull = (y - design @ coefficients) * np.sqrt(w)
        spread = 1.4826 * np.median(np.abs(pull))
        w = np.where(np.abs(pull) < 4.0 * spread, w, 0.0)
        coefficients = np.linalg.solve(design.T @ (w[:, None] * design), design.T @ (w * y))
    inverse = np.linalg.inv(design.T @ (w[:, None] * design))
    left = (y - design @ coefficients) * w
    covariance = inverse * float((left**2 / np.maximum(w, 1e-300)).sum() / max((w > 0).sum() - 2, 1))
    number = len(np.unique(frame))
    if number >= 6:
        score = np.stack([(design * left[:, None])[frame == k].sum(axis=0) for k in np.unique(frame)])
        clustered = inverse @ (score.T @ score * number / (number - 1)) @ inverse
        covariance = np.where(np.diag(clustered).sum() > np.diag(covariance).sum(), clustered, covariance)
    return np.asarray(coefficients, float), np.asarray(covariance, float)


def _pattern(frames: Sequence[Blocks]) -> tuple[Measured, Measured]:
    """DSNU^2 [DN^2] and PRNU^2 from the covariance of residuals of different frames, pixel by pixel."""
    if len(frames) < 2:
        return Measured(value=0.0, uncertainty=0.0), Measured(value=0.0, uncertainty=0.0)
    product, both, frame = [], [], []
    for i in range(len(frames)):
        for j in range(i):
            together = _per_block(frames[i].left_dn * frames[j].left_dn)
            product.append(together)
            both.append(frames[i].level_dn * frames[j].level_dn)
            frame.append(np.arange(len(together)))  # a block of the detector has its own pattern in every pair
    y, x, block = np.concatenate(product), np.concatenate(both), np.concatenate(frame)
    known = np.isfinite(y)
    y, x, block = y[known], x[known], block[known]
    design = np.stack([np.ones_like(x), x], axis=1)
    w = 1.0 / np.maximum(x, 1.0)  # products of two frames scatter as the product of their noise
    inverse = np.linalg.inv(design.T @ (w[:, None] * design))
    found = inverse @ (design.T @ (w * y))
    score = np.zeros((int(block.max()) + 1, 2))
    np.add.at(score, block, design * (w * (y - design @ found))[:, None])
    error = np.sqrt(np.diag(inverse @ (score.T @ score) @ inverse))
    if found[0] < 0.0 or found[1] < 0.0:  # one of them alone then
        alone = 1 if found[0] < found[1] or found[0] < 0.0 else 0
        found = np.zeros(2)
        found[alone] = (w * y * design[:, alone]).sum() / (w * design[:, alone] ** 2).sum()
    return (
        Measured(value=float(max(found[0], 0.0)), uncertainty=float(error[0])),
        Measured(value=float(max(found[1], 0.0)), uncertainty=float(error[1])),
    )


def _third(frames: Sequence[Blocks]) -> Measured:
    """Third moment of the pattern [DN^3], by products of three frames, in which noise averages out; 0 if not sure."""
    if len(frames) < 3:
        return Measured(value=0.0, uncertainty=0.0)
    shape = frames[0].left_dn.shape
    power, count = [np.zeros(shape) for _ in range(3)], np.zeros(shape)
    for one in frames:
        left, known = np.nan_to_num(one.left_dn), np.isfinite(one.left_dn)
        count += known
        for k in range(3):
            power[k] += left ** (k + 1)
    triples = count * (count - 1) * (count - 2)  # each of them six times, in either sum
    product = power[0] ** 3 - 3.0 * power[0] * power[1] + 2.0 * power[2]
    mean = _per_block(np.where(triples > 0, product / np.maximum(triples, 1.0), np.nan))
    mean = mean[np.isfinite(mean)]
    if len(mean) < 4:
        return Measured(value=0.0, uncertainty=0.0)
    value, error = float(mean.mean()), float(mean.std(ddof=1) / np.sqrt(len(mean)))
    return Measured(value=value if value > SURE_SIGMA * error else 0.0, uncertainty=error)


def _per_block(values: FloatArray, side: int = BLOCK_PX) -> FloatArray:
    """Means of blocks (b,) of an image, NaN left out; NaN where more than half is missing."""
    rows, columns = values.shape[0] // side, values.shape[1] // side
    whole = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
    known = np.isfinite(whole)
    count = known.sum(axis=(1, 3))
    mean = np.where(known, whole, 0.0).sum(axis=(1, 3)) / np.maximum(count, 1)
    return np.asarray(np.where(count > side * side / 2, mean, np.nan).ravel())


def correlation_of(frames: Sequence[Blocks]) -> FloatArray:
    out = np.zeros((len(frames), 3))
    for k, one in enumerate(frames):
        left = one.left_dn
        variance = np.nanmean(left**2)
        pairs = ((left[:, 1:], left[:, :-1]), (left[1:], left[:-1]), (left[1:, 1:], left[:-1, :-1]))
        out[k] = [np.nanmean(a * b) / variance for a, b in pairs]
    return out.mean(axis=0) + 6.0 / BLOCK_PX**2  # the surface that was taken out correlates what is left


def whiteness(frames: Sequence[Blocks]) -> FloatArray:
    """Noise of means of squares over that of white noise, mean over the frames; of 2 and 8 px within blocks."""
    out = []
    for side in (2, 8, BLOCK_PX):
        ratios = []
        for one in frames:
            left = one.left_dn
            known = np.isfinite(left)
            mean = _per_block(left, side)
            count = _per_block(known.astype(float), side) * side * side
            good = np.isfinite(mean) & (count > 0.5 * side * side)
            if side < BLOCK_PX and good.sum() > 10:
                # a quadratic surface takes 6 of the degrees of freedom of a block, all of them slow ones
                slow = 6.0 * side * side / BLOCK_PX**2
                expected = np.nanmean(left**2) * (1.0 - slow) * np.mean(1.0 / count[good])
                centre, spread = np.median(mean[good]), 1.4826 * np.median(np.abs(mean[good] - np.median(mean[good])))
                inside = np.abs(mean[good] - centre) < 3.5 * spread
                kept = 1.0 - 2.0 * 3.5 * norm.pdf(3.5) / (2.0 * norm.cdf(3.5) - 1.0)
                ratios.append(float(np.sqrt(np.mean((mean[good][inside] - centre) ** 2) / kept / expected)))
            elif side >= BLOCK_PX:
                ratios.append(_block_noise(one))
        out.append(float(np.mean(ratios)) if ratios else float("nan"))
    return np.array(out)


def _block_noise(one: Blocks) -> float:
    """Scatter of block levels about their neighbours' plane over what white noise gives."""
    level = one.level_dn.reshape(-1, one.columns)
    second = level[:, 2:] - 2.0 * level[:, 1:-1] + level[:, :-2]
    white = np.sqrt(6.0 * np.nanmedian(one.variance_dn2) / np.median(one.count))
    return float(1.4826 * np.nanmedian(np.abs(second - np.nanmedian(second))) / white)
