"""High spatial frequency error (ACC18 eq. 3-12): statistics of mean centroids of W stars at m steps of the image.

The paper takes differences of *consecutive* positions, removes the mean over the stars, and takes the RMS. That number
contains two effects other than the error of a position: averaged temporal noise, and a factor that depends on the
correlation of the errors at neighbouring positions. For independent errors the factor is sqrt(2); at steps of 0.2 px it
is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2
from scipy.stats import f as fisher_f

from calib.accuracy.error_budget import ErrorTerm
from optics.arrays import FloatArray
from optics.errors import DomainError

MOTION_TERMS = 3
"""Of the motion of the image at a position: shift, and its two derivatives over the field (roll, scale, shear)."""
FEWEST_ORDERED = 5
"""Positions below which the fit of the commands follows two exchanged ones."""
EXCHANGE_GAIN = 0.25
"""Two positions are exchanged where that lowers the sum of squares to this fraction."""


def _checked(mean_px: FloatArray) -> FloatArray:
    if mean_px.ndim != 3 or mean_px.shape[0] < 2 or mean_px.shape[1] < 2:
        raise DomainError(f"mean centroids of shape {mean_px.shape}; at least 2 positions of 2 stars are needed")
    return mean_px


def without_common_motion(position_px: FloatArray) -> FloatArray:
    """Positions (m, W, 2) minus their mean over the stars, the motion of the platform."""
    return np.asarray(position_px - position_px.mean(axis=1, keepdims=True))


def step_residual_px(mean_px: FloatArray) -> FloatArray:
    """Differences (m - 1, W, 2) of consecutive positions without their mean over the stars (ACC18 eq. 5-8)."""
    return without_common_motion(np.diff(_checked(mean_px), axis=0))


def averaged_noise_px(sigma_px: FloatArray, frames: int) -> FloatArray:
    """Part (2,) in `step_rms_px` of noise of the standard deviation (m, W, 2) per frame, averaged over N frames."""
    of_mean2 = sigma_px**2 / frames
    return np.sqrt((of_mean2[1:] + of_mean2[:-1]).mean((0, 1)) * (1.0 - 1.0 / sigma_px.shape[1]))


def sigma_without_common_motion_px(position_px: FloatArray) -> FloatArray:
    """Standard deviation (m, W, 2) of a frame of centroids (f, m, W, 2), without what all stars have in common."""
    stars = position_px.shape[2]
    residual_px = position_px - np.nanmean(position_px, axis=2, keepdims=True)
    return np.asarray(np.nanstd(residual_px, axis=0, ddof=1) * np.sqrt(stars / (stars - 1.0)))


def step_rms_px(mean_px: FloatArray, sigma_px: FloatArray | None = None, frames: int = 1) -> FloatArray:
    """RMS (2,) of the residuals over stars and steps (ACC18 eq. 9-10), as printed: divided by W (M - 1).

    Given the standard deviation (m, W, 2) of a frame, averaged temporal noise is subtracted, which the paper does not.
    """
    square = (step_residual_px(mean_px) ** 2).mean((0, 1))
    if sigma_px is not None:
        square = np.maximum(square - averaged_noise_px(sigma_px, frames) ** 2, 0.0)
    return np.asarray(np.sqrt(square))


def step_rms_standard_error_px(mean_px: FloatArray) -> FloatArray:
    """Standard error (2,) of `step_rms_px` by the jackknife over the stars; NaN for fewer than three."""
    stars = mean_px.shape[1]
    if stars < 3:
        return np.full(2, np.nan)
    replicates = np.stack([step_rms_px(np.delete(mean_px, j, axis=1)) for j in range(stars)])
    return np.asarray(np.sqrt((stars - 1) / stars * ((replicates - replicates.mean(0)) ** 2).sum(0)))


def high_frequency_error(mean_px: FloatArray, pixel_arcsec: float) -> ErrorTerm:
    """High spatial frequency error as printed (ACC18 eq. 11-12), 3 sigma.

    Parameters
    ----------
    mean_px : (m, W, 2)
        Mean centroids of W stars at m consecutive positions [px].
    pixel_arcsec : float
        Angle of a pixel [arcsec].

    Raises
    ------
    DomainError
        Fewer than two positions or stars.
    """
    scale = 3.0 * pixel_arcsec
    return ErrorTerm(
        arcsec=scale * step_rms_px(mean_px),
        uncertainty_arcsec=scale * step_rms_standard_error_px(mean_px),
        n=mean_px.shape[1] * (mean_px.shape[0] - 1),
    )


def independent_position_rms_px(step_px: FloatArray, sigma_px: FloatArray, frames: int) -> FloatArray:
    """Error (2,) of one position from `step_rms_px`, if errors of neighbouring positions were independent.

    ``sqrt((step^2 W / (W - 1) - 2 sigma^2 / N) / 2)``: temporal noise averaged over the N frames subtracted, the degree
    of freedom of the star mean restored; 0 where the difference is negative. ``sigma_px`` (m, W, 2): standard deviation
    of the centroid of a frame.
    """
    stars = sigma_px.shape[1]
    square = step_px**2 * stars / (stars - 1) - 2.0 * (sigma_px**2).mean((0, 1)) / frames
    return np.asarray(np.sqrt(np.maximum(square, 0.0) / 2.0))


def position_rms_scatter_px(single_px: FloatArray, sigma_px: FloatArray, frames: int) -> FloatArray:
    """Standard deviation (2,) of `position_rms_px` by the temporal noise that is subtracted, and by its product with
    the error."""
    noise2, count = (sigma_px**2).mean((0, 1)) / frames, sigma_px[..., 0].size
    return np.asarray(np.sqrt((noise2**2 / 2.0 + single_px**2 * noise2) / count) / np.maximum(single_px, 1e-12))


def position_rms_px(error_px: FloatArray, sigma_px: FloatArray | None = None, frames: int = 1) -> FloatArray:
    """RMS error (2,) of a position: mean centroid minus truth (m, W, 2), without common motion and temporal noise."""
    stars = error_px.shape[1]
    square = (without_common_motion(error_px) ** 2).mean((0, 1)) * stars / (stars - 1)
    if sigma_px is not None:
        square = square - (sigma_px**2).mean((0, 1)) / frames
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionError:
    """Error of the mean centroid at one position about its mean over the path, along x and y, without truth."""

    variance_px2: FloatArray  # (2,) Unbiased estimate; negative where temporal noise happens to exceed the scatter
    low_px: FloatArray  # (2,) Two-sided confidence interval of the standard deviation
    high_px: FloatArray  # (2,)
    upper_px: FloatArray  # (2,) One-sided upper limit of the same confidence
    degrees: FloatArray  # (2,) Degrees of freedom of the scatter over the positions
    level: float  # Confidence

    @property
    def value_px(self) -> FloatArray:
        """Standard deviation (2,); NaN where the estimate of the variance is not positive."""
        variance = self.variance_px2
        return np.where(variance > 0, np.sqrt(np.maximum(variance, 0.0)), np.nan)


def position_error(
    mean_px: FloatArray, sigma_px: FloatArray, frames: ArrayLike, *, level: float = 0.95
) -> PositionError:
    """Error of a position by an analysis of variance: scatter over the positions minus averaged temporal noise.

    With e the error of star j at position m, the mean centroid is ``base_j + motion_m(base_j) + e_mj + noise``. Star
    means and, at every position, the motion of the image (shift; with five stars or more also roll, scale and shear)
    are fitted. The residual has the mean square sigma_e^2 + sigma^2/N, from which the pooled variance of the frames
    over N is subtracted.

    The interval is that of Williams and Tukey for a component of variance (Searle, Casella and McCulloch 1992, sec.
    3.6d): conservative where the component is small. A negative estimate has the upper limit of an estimate of zero:
    a lucky draw of the noise does not make the test more sensitive than it is. Errors of neighbouring positions are
    correlated, so that m positions count as fewer: the degrees of freedom are ``tr(S)^2 / tr(S^2)`` times those of the
    stars, S the covariance of the positions, with the traces estimated without bias from the stars (Srivastava 2005, J.
    Japan Stat. Soc. 35, 251).

    Parameters
    ----------
    mean_px, sigma_px : (m, W, 2)
        Mean over the frames and standard deviation of a frame of W stars at m positions [px].
    frames : (m,)
        Frames per position.
    level : float
        Confidence.

    Raises
    ------
    DomainError
        Fewer than two positions or stars.
    """
    positions, stars, _ = _checked(mean_px).shape
    base_px = mean_px.mean(0)
    terms = np.column_stack([np.ones(stars), base_px - base_px.mean(0)])
    basis, singular_values, _ = np.linalg.svd(terms if stars > MOTION_TERMS + 1 else terms[:, :1], full_matrices=False)
    basis = basis[:, singular_values > 1e-9 * singular_values[0]]
    residual_px = mean_px - base_px
    residual_px = residual_px - np.einsum("jk,lk,mla->mja", basis, basis, residual_px)
    free = stars - basis.shape[1]
    nominal = (positions - 1.0) * free
    mean_square = (residual_px**2).sum((0, 1)) / nominal
    counts = np.asarray(frames, float)[:, None, None]
    noise2 = (sigma_px**2 / counts).mean((0, 1))
    weight = (sigma_px**2 / counts) ** 2 / (counts - 1.0)
    noise_degrees = noise2**2 * (positions * stars) ** 2 / np.maximum(weight.sum((0, 1)), 1e-300)
    degrees = np.array([_degrees(residual_px[..., a], free) for a in range(2)])
    tail = 0.5 * (1.0 - level)

    def bound(probability: float, least: FloatArray | float = 0.0) -> FloatArray:
        ratio = fisher_f.isf(probability, degrees, noise_degrees)
        square = (np.maximum(mean_square, least) - noise2 * ratio) * degrees / chi2.isf(probability, degrees)
        return np.asarray(np.sqrt(np.maximum(square, 0.0)))

    return PositionError(
        variance_px2=mean_square - noise2,
        low_px=bound(tail),
        high_px=bound(1.0 - tail),
        upper_px=bound(level, noise2),
        degrees=degrees,
        level=level,
    )


def _degrees(residual_px: FloatArray, free: int) -> float:
    """Degrees of freedom of the sum of squares of residuals (m, W) of ``free`` independent stars."""
    covariance = residual_px @ residual_px.T / free
    trace, squared = float(np.trace(covariance)), float((covariance**2).sum())
    nominal = (len(residual_px) - 1.0) * free
    if free < 2 or trace <= 0.0:
        return nominal if free > 1 else float(free)
    unbiased = (squared - trace**2 / free) * free**2 / ((free - 1.0) * (free + 2.0))
    return float(np.clip(free * trace**2 / max(unbiased, 1e-300), free, nominal))


def exchanged_positions(measured_px: FloatArray, commanded_px: FloatArray) -> tuple[int, int] | None:
    """Two of m positions (m, 2) that stand at each other's command, or None; scale and axes of the commands are fitted.

    None also for fewer than five positions and for commands that are not all known (NaN).
    """
    count = len(measured_px)
    if count < FEWEST_ORDERED or not np.isfinite(commanded_px).all():
        return None

    def misfit(order: NDArray[np.int64]) -> float:
        design_matrix = np.column_stack([np.ones(count), commanded_px[order]])
        fit = design_matrix @ np.linalg.lstsq(design_matrix, measured_px, rcond=None)[0]
        return float(((measured_px - fit) ** 2).sum())

    misfits = {}
    for pair in combinations(range(count), 2):
        order = np.arange(count)
        order[list(pair)] = pair[::-1]
        misfits[pair] = misfit(order)
    best = min(misfits, key=misfits.__getitem__)
    return best if misfits[best] <= EXCHANGE_GAIN * misfit(np.arange(count)) else None
