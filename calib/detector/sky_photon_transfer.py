"""Gain, noise and fixed pattern from photon transfer on the sky, without lamp and dark frames.

Level and variance of blocks of 32 px are taken without a quadratic surface, stars and outliers (the variance is
corrected for the truncation). The pattern common to all frames is separated by the covariance of two frames' residuals,
pixel by pixel: DSNU^2 + PRNU^2 m_i m_j. The temporal variance follows EMVA 1288,

    var = read noise^2 + 1/12 + (mean - black level) / gain         [DN^2; gain in e-/DN].

Frames of the sky do not determine the black level: read noise and black level are given as an interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2, norm

from calib.detector.photon_transfer import QUANTISATION_DN2, deviation
from calib.measure.statistics.robust import robust_rms, robust_sigma
from optics.arrays import FloatArray
from optics.errors import DomainError

BLOCK_PX = 32
CLIP_SIGMA = 3.5
CLIP_ROUNDS = 4
TRUNCATED_VARIANCE = float(1.0 - 2.0 * CLIP_SIGMA * norm.pdf(CLIP_SIGMA) / (2.0 * norm.cdf(CLIP_SIGMA) - 1.0))
"""Variance of a normal distribution truncated at `CLIP_SIGMA`, over that of the full one."""
TRUNCATED_COVARIANCE = TRUNCATED_VARIANCE**2 * (1.0 - 6.0 / BLOCK_PX**2)
"""Covariance of two such residuals over that of the pattern: truncated twice, less a surface of 6 terms."""
LEAST_FRACTION = 0.4
"""Smallest fraction of usable pixels of a block."""
FEWEST_FRAMES, FRAME_ALARM = 6, 0.01
"""Frames from which an error common to the blocks of a frame is tested, and its false alarm probability."""
DETERMINED_SIGMA = 4.0
"""Slope over its error from which the gain is determined."""
SIGNIFICANT_SIGMA = 3.0
"""Third moment over its error from which it is used."""
WARM_FRACTION = 0.95
"""Fraction of a skewed pattern that is dark current."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SkyBlocks:
    """A frame in blocks: residual without stars and without its smooth background."""

    residual_dn: FloatArray  # (h, w) NaN where masked or clipped
    level_dn: FloatArray  # (b,) Mean of the blocks
    variance_dn2: FloatArray  # (b,) Corrected for the truncation; NaN where too few pixels remain
    count: NDArray[np.int64]  # (b,) Pixels

    @property
    def columns(self) -> int:
        """Number of columns of blocks."""
        return self.residual_dn.shape[1] // BLOCK_PX


def sky_blocks(dn: ArrayLike, masked: ArrayLike) -> SkyBlocks:
    """Residuals of a frame (h, w) about a quadratic surface in every block of 32 px, without masked stars and defects.

    Raises
    ------
    DomainError
        A frame of fewer than two blocks along a side.
    """
    dn = np.asarray(dn, float)
    rows, columns = dn.shape[0] // BLOCK_PX, dn.shape[1] // BLOCK_PX
    if rows < 2 or columns < 2:
        raise DomainError(
            f"frames of {dn.shape[1]} x {dn.shape[0]} px; at least {2 * BLOCK_PX} x {2 * BLOCK_PX} are needed"
        )
    inside = (slice(rows * BLOCK_PX), slice(columns * BLOCK_PX))

    def cut(values: NDArray[np.generic]) -> NDArray[np.generic]:
        tiles = values[inside].reshape(rows, BLOCK_PX, columns, BLOCK_PX)
        return tiles.transpose(0, 2, 1, 3).reshape(rows * columns, -1)

    values, good = np.asarray(cut(dn), float), ~np.asarray(cut(np.asarray(masked, bool)), bool)
    y, x = np.divmod(np.arange(BLOCK_PX**2), BLOCK_PX)
    x, y = (2.0 * axis / (BLOCK_PX - 1) - 1.0 for axis in (x, y))
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    residual = np.zeros_like(values)
    for _ in range(CLIP_ROUNDS):
        weight = good.astype(float)
        normal = np.einsum("bp,pi,pj->bij", weight, design, design, optimize=True) + 1e-9 * np.eye(6)
        right = (weight * values) @ design
        residual = values - np.linalg.solve(normal, right[:, :, None])[:, :, 0] @ design.T
        variance = (weight * residual**2).sum(axis=1) / np.maximum(good.sum(axis=1) - 6, 1) / TRUNCATED_VARIANCE
        good &= np.abs(residual) < CLIP_SIGMA * np.sqrt(variance)[:, None]
    count = good.sum(axis=1)
    enough = count > LEAST_FRACTION * BLOCK_PX**2
    variance = np.where(good, residual**2, 0.0).sum(axis=1) / np.maximum(count - 6, 1) / TRUNCATED_VARIANCE
    level = np.where(good, values, 0.0).sum(axis=1) / np.maximum(count, 1)
    image = np.full(dn.shape, np.nan)
    tiles = np.where(good & enough[:, None], residual, np.nan).reshape(rows, columns, BLOCK_PX, BLOCK_PX)
    image[inside] = tiles.transpose(0, 2, 1, 3).reshape(rows * BLOCK_PX, columns * BLOCK_PX)
    variance = np.where(enough, variance, np.nan)
    return SkyBlocks(residual_dn=image, level_dn=level, variance_dn2=variance, count=count.astype(np.int64))


@dataclass(frozen=True, slots=True, kw_only=True)
class SkyNoise:
    """Detector noise from the sky; errors are standard deviations."""

    gain_e_per_dn: float
    gain_error_e_per_dn: float
    blocks: int  # Of all frames
    intercept_dn2: float  # Temporal variance extrapolated to the lowest black level
    intercept_error_dn2: float
    dsnu_dn: float
    dsnu_error_dn: float
    prnu: float  # Of the response 1
    prnu_error: float
    third_moment_dn3: float  # Of the pattern, by unmasked warm pixels; 0 if it is not significant
    third_moment_error_dn3: float
    read_noise_e: tuple[float, float]  # For the lowest and the highest black level
    black_level_dn: tuple[float, float]  # Lowest and highest possible value
    levels_dn: FloatArray  # (k,) Photon transfer curve in bins of the mean
    variances_dn2: FloatArray  # (k,) Temporal variance there
    correlation: FloatArray  # (3,) Of neighbours along x, y and the diagonal
    averaging: FloatArray  # (3,) Noise of means of 2, 8, 32 px squares over that of white noise

    def variance_dn2(self, mean_dn: FloatArray | float) -> FloatArray:
        """Total variance of a pixel, pattern included."""
        mean = np.maximum(np.asarray(mean_dn, float) - self.black_level_dn[0], 0.0)
        pattern = self.dsnu_dn**2 + (self.prnu * mean) ** 2
        return np.asarray(self.intercept_dn2 + mean / self.gain_e_per_dn + pattern)


def sky_photon_transfer(
    frames: Sequence[SkyBlocks], *, lowest_dn: float, black_level_dn: float | None = None
) -> SkyNoise:
    """Photon transfer of all blocks of all frames.

    Parameters
    ----------
    frames : sequence of SkyBlocks
        Frames of one camera and exposure, with different backgrounds.
    lowest_dn : float
        Lowest background of the frames: upper limit of an unknown black level.
    black_level_dn : float, optional
        Black level, if it is known.

    Raises
    ------
    DomainError
        No block without stars, or backgrounds that do not determine the slope.
    """
    black = (0.0, max(float(lowest_dn), 0.0)) if black_level_dn is None else (black_level_dn, black_level_dn)
    if black[0]:
        frames = [replace(blocks, level_dn=blocks.level_dn - black[0]) for blocks in frames]
    level = np.concatenate([blocks.level_dn for blocks in frames])
    variance = np.concatenate([blocks.variance_dn2 for blocks in frames])
    frame = np.repeat(np.arange(len(frames)), [len(blocks.level_dn) for blocks in frames])
    block = np.concatenate([np.arange(len(blocks.level_dn)) for blocks in frames])
    weight = np.concatenate([blocks.count for blocks in frames]).astype(float)
    good = np.isfinite(variance)
    level, variance, frame, block, weight = (row[good] for row in (level, variance, frame, block, weight))
    if not len(level):
        raise DomainError("no part of the frames is free of stars; gain and noise cannot be measured")
    (dsnu2, prnu2), pattern_change = _pattern(frames)
    dsnu2_error, prnu2_error = np.sqrt(_sum_of_squares(pattern_change))
    temporal = variance - dsnu2 - prnu2 * level**2
    (slope, intercept), influence = _line(level, temporal, weight)
    change = influence * (temporal - slope * level - intercept)
    # error of the subtracted pattern, block by block of the detector
    by_pattern = influence @ np.stack([np.ones_like(level), level**2], axis=1)
    slope_error, intercept_error = _errors(change, block, frame, -pattern_change @ by_pattern.T)
    if not slope > DETERMINED_SIGMA * slope_error:
        raise DomainError(
            f"photon transfer: variance rises by {slope:.3g} +/- {slope_error:.2g} DN^2 per DN over backgrounds from "
            f"{level.min():.4g} to {level.max():.4g} DN; the gain is not determined: frames with different "
            "backgrounds are needed"
        )
    gain = float(1.0 / slope)
    low, high = (
        float(np.sqrt(max(intercept - QUANTISATION_DN2 + slope * (dark - black[0]), 0.0)) * gain) for dark in black
    )
    bins = np.array_split(np.argsort(level), min(24, max(len(level) // 20, 1)))
    third, third_error = pattern_third_moment(frames)
    dsnu, dsnu_error = deviation(dsnu2, dsnu2_error)
    prnu, prnu_error = deviation(prnu2, prnu2_error)
    return SkyNoise(
        gain_e_per_dn=gain,
        gain_error_e_per_dn=slope_error * gain**2,
        blocks=len(level),
        intercept_dn2=float(intercept),
        intercept_error_dn2=intercept_error,
        dsnu_dn=dsnu,
        dsnu_error_dn=dsnu_error,
        prnu=prnu,
        prnu_error=prnu_error,
        third_moment_dn3=third,
        third_moment_error_dn3=third_error,
        read_noise_e=(low, high),
        black_level_dn=black,
        levels_dn=np.array([level[rows].mean() for rows in bins]) + black[0],
        variances_dn2=np.array([np.average(variance[rows], weights=weight[rows]) for rows in bins]),
        correlation=neighbour_correlation(frames),
        averaging=averaging_ratio(frames),
    )


def _line(x: FloatArray, y: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slope and intercept of variances, with errors in proportion to them, and their influence functions (2, n)."""
    coefficients = np.array([0.0, float(np.median(y))])
    design = np.stack([x, np.ones_like(x)], axis=1)

    def influence(w: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.solve(design.T @ (w[:, None] * design), design.T * w))

    for _ in range(4):
        expected = np.maximum(design @ coefficients, 1e-3 * float(np.median(y)) + 1e-9)
        w = weight / (2.0 * expected**2)
        residual = (y - design @ (influence(w) @ y)) * np.sqrt(w)
        w = np.where(np.abs(residual) < 4.0 * robust_rms(residual), w, 0.0)
        coefficients = influence(w) @ y
    return coefficients, influence(w)


def _errors(
    change: FloatArray, block: NDArray[np.int64], frame: NDArray[np.int64], pattern_change: FloatArray
) -> FloatArray:
    """Errors (2,) of slope and intercept from their changes (2, n) by each block of each frame.

    Blocks of the detector, with the pattern subtracted in all frames, are independent of each other; an error common to
    the blocks of a frame is added if it is significant.
    """
    by_block = np.array([np.bincount(block, row, minlength=len(pattern_change)) for row in change]).T + pattern_change
    square = _sum_of_squares(by_block)
    number = len(np.unique(frame))
    if number >= FEWEST_FRAMES:
        by_frame = np.array([np.bincount(frame, row) for row in change])
        common, single = (by_frame**2).sum(axis=1) * number / (number - 2), (change**2).sum(axis=1)
        beyond = common > single * chi2.isf(FRAME_ALARM, number - 2) / (number - 2)
        square += np.where(beyond, common - single, 0.0)
    return np.asarray(np.sqrt(square))


def _sum_of_squares(change: FloatArray) -> FloatArray:
    """Variance (2,) of two parameters from their changes (b, 2) by independent blocks, less two degrees of freedom."""
    count = max(int(np.count_nonzero(change.any(axis=1))), 3)
    return np.asarray((change**2).sum(axis=0) * count / (count - 2))


def _pattern(frames: Sequence[SkyBlocks]) -> tuple[FloatArray, FloatArray]:
    """DSNU^2 [DN^2] and PRNU^2 (2,) from the covariance of residuals of different frames, and their changes (b, 2) with
    each block, whose pattern is the same in every pair of frames."""
    blocks = len(frames[0].level_dn)
    if len(frames) < 2:
        return np.zeros(2), np.zeros((blocks, 2))
    pairs = [(frames[i], frames[j]) for i in range(len(frames)) for j in range(i)]
    y = np.concatenate([_block_means(a.residual_dn * b.residual_dn) / TRUNCATED_COVARIANCE for a, b in pairs])
    x = np.concatenate([a.level_dn * b.level_dn for a, b in pairs])
    block = np.tile(np.arange(blocks), len(pairs))
    finite = np.isfinite(y)
    if np.count_nonzero(finite) < 2:
        raise DomainError("fewer than two blocks are free of stars in two frames; gain and noise cannot be measured")
    y, x, block = y[finite], x[finite], block[finite]
    design = np.stack([np.ones_like(x), x], axis=1)
    w = 1.0 / np.maximum(x, 1.0)  # products of two frames scatter as the product of their noise
    influence = np.linalg.solve(design.T @ (w[:, None] * design), design.T * w)
    squares = influence @ y
    if squares[0] < 0.0 or squares[1] < 0.0:  # a single term then
        single = 1 if squares[0] < squares[1] or squares[0] < 0.0 else 0
        row = design[:, single] * w
        influence = np.zeros_like(influence)
        influence[single] = row / (row @ design[:, single])
        squares = np.maximum(influence @ y, 0.0)
    change = influence * (y - design @ squares)
    return squares, np.array([np.bincount(block, row, minlength=blocks) for row in change]).T


def pattern_third_moment(frames: Sequence[SkyBlocks]) -> tuple[float, float]:
    """Third moment of the pattern [DN^3] and its error, by products of three frames, in which noise averages out.

    0 with fewer than three frames, and where it is not significant.
    """
    if len(frames) < 3:
        return 0.0, 0.0
    count = sum(np.isfinite(blocks.residual_dn).astype(float) for blocks in frames)
    power = [sum(np.nan_to_num(blocks.residual_dn) ** k for blocks in frames) for k in (1, 2, 3)]
    triples = count * (count - 1) * (count - 2)  # each six times, as in the sum of products
    product = power[0] ** 3 - 3.0 * power[0] * power[1] + 2.0 * power[2]
    mean = _block_means(np.where(triples > 0, product / np.maximum(triples, 1.0), np.nan))
    mean = mean[np.isfinite(mean)]
    if len(mean) < 4:
        return 0.0, 0.0
    value, error = float(mean.mean()), float(mean.std(ddof=1) / np.sqrt(len(mean)))
    return value if value > SIGNIFICANT_SIGMA * error else 0.0, error


def _block_means(values: FloatArray, side: int = BLOCK_PX) -> FloatArray:
    """Means of blocks (b,) of an image, NaN left out; NaN where more than half is missing."""
    rows, columns = values.shape[0] // side, values.shape[1] // side
    tiles = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
    finite = np.isfinite(tiles)
    count = finite.sum(axis=(1, 3))
    mean = np.where(finite, tiles, 0.0).sum(axis=(1, 3)) / np.maximum(count, 1)
    return np.asarray(np.where(count > side * side / 2, mean, np.nan).ravel())


def neighbour_correlation(frames: Sequence[SkyBlocks]) -> FloatArray:
    """Correlation (3,) of the noise of neighbouring pixels along x, y and the diagonal, mean over the frames."""
    correlation = np.zeros((len(frames), 3))
    for k, blocks in enumerate(frames):
        residual = blocks.residual_dn
        variance = np.nanmean(residual**2)
        pairs = (
            (residual[:, 1:], residual[:, :-1]),
            (residual[1:], residual[:-1]),
            (residual[1:, 1:], residual[:-1, :-1]),
        )
        correlation[k] = [np.nanmean(a * b) / variance for a, b in pairs]
    return correlation.mean(axis=0) + 6.0 / BLOCK_PX**2  # the subtracted surface correlates the residuals


def averaging_ratio(frames: Sequence[SkyBlocks]) -> FloatArray:
    """Noise of means of squares of 2, 8 and 32 px over that of white noise (3,), mean over the frames."""
    ratios = [[_mean_noise(blocks, side) for side in (2, 8)] + [_block_noise(blocks)] for blocks in frames]
    return np.array([float(np.mean([row[k] for row in ratios if row[k] is not None] or [np.nan])) for k in range(3)])


def _mean_noise(blocks: SkyBlocks, side: int) -> float | None:
    """Scatter of means of squares within blocks over that of white noise; None for too few of them."""
    residual = blocks.residual_dn
    mean = _block_means(residual, side)
    count = _block_means(np.isfinite(residual).astype(float), side) * side * side
    good = np.isfinite(mean) & (count > 0.5 * side * side)
    if good.sum() <= 10:
        return None
    # a quadratic surface takes 6 degrees of freedom of a block, all at low frequencies
    low_frequency = 6.0 * side * side / BLOCK_PX**2
    expected = np.nanmean(residual**2) * (1.0 - low_frequency) * np.mean(1.0 / count[good])
    deviation_dn = mean[good] - np.median(mean[good])
    deviation_dn = deviation_dn[np.abs(deviation_dn) < CLIP_SIGMA * robust_rms(deviation_dn)]
    return float(np.sqrt(np.mean(deviation_dn**2) / TRUNCATED_VARIANCE / expected))


def _block_noise(blocks: SkyBlocks) -> float:
    """Scatter of block levels about their neighbours' plane over what white noise gives."""
    level = blocks.level_dn.reshape(-1, blocks.columns)
    second = level[:, 2:] - 2.0 * level[:, 1:-1] + level[:, :-2]
    white = np.sqrt(6.0 * np.nanmedian(blocks.variance_dn2) / np.median(blocks.count))
    return robust_sigma(second) / float(white)


def tail_fraction(frames: Sequence[SkyBlocks]) -> float:
    """Fraction of the unclipped pixels beyond three standard deviations, mean over the frames."""
    residuals = [blocks.residual_dn[np.isfinite(blocks.residual_dn)] for blocks in frames]
    return float(np.mean([(np.abs(values) > 3.0 * values.std()).mean() for values in residuals]))


def lognormal_dark(noise: SkyNoise) -> tuple[float, float, float]:
    """DSNU [DN] as a normal distribution, and mean and spread [DN] of a dark current whose skewness was measured.

    The current is lognormal, the lightest tail with the second and third moment of the pattern: skewness is c^3 + 3 c
    of spread over mean c. Both are 0 without skewness, and where the mean would exceed the darkest sky.
    """
    spread = WARM_FRACTION * noise.dsnu_dn
    if noise.third_moment_dn3 > 0.0:
        skewness = noise.third_moment_dn3 / spread**3
        mean = spread / float(2.0 * np.sinh(np.arcsinh(skewness / 2.0) / 3.0))
        if mean < noise.levels_dn.min() - noise.black_level_dn[0]:
            return float(np.sqrt(noise.dsnu_dn**2 - spread**2)), mean, spread
    return noise.dsnu_dn, 0.0, 0.0
