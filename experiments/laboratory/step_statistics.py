"""Statistics of ACC18's step test (eq. 3-12) on mean centroids of m positions and W stars.

The document takes differences of *consecutive* positions, removes the mean over the stars, and takes the RMS. That
number contains two effects other than the error of a position: averaged temporal noise, and a factor that depends on
the correlation of the errors at neighbouring positions. For independent errors the factor is sqrt(2); at steps of 0.2
px it is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as fisher_f

from experiments.harness.summary import Measured
from optics.arrays import FloatArray
from optics.errors import DomainError

MOTION_TERMS = 3
"""Of the motion of the image at a position: shift, and its two derivatives over the field (roll, scale, shear)."""


def common_removed(values_px: FloatArray) -> FloatArray:
    """Values (m, W, 2) minus their mean over the stars, the motion of the platform."""
    return np.asarray(values_px - values_px.mean(axis=1, keepdims=True))


def step_residual_px(mean_px: FloatArray) -> FloatArray:
    """Differences of consecutive positions without their mean over the stars (ACC18 eq. 5-8)."""
    if mean_px.ndim != 3 or mean_px.shape[0] < 2 or mean_px.shape[1] < 2:
        raise DomainError(f"mean centroids of shape {mean_px.shape}; at least 2 positions of 2 stars are needed")
    return common_removed(np.diff(mean_px, axis=0))


def document_rms_px(mean_px: FloatArray) -> FloatArray:
    """RMS (2,) of the residuals over stars and steps (ACC18 eq. 9-10), as printed: divided by W (M - 1)."""
    return np.asarray(np.sqrt((step_residual_px(mean_px) ** 2).mean((0, 1))))


def halved_px(document_px: FloatArray, sigma_px: FloatArray, frames: int) -> FloatArray:
    """The document's number (2,) as the error of one position, if errors of neighbouring positions were independent.

    Temporal noise averaged over the frames is taken away, the star mean's share is given back, and the rest is divided
    by sqrt(2): ``sqrt((document^2 W / (W - 1) - 2 sigma^2 / N) / 2)``; 0 where nothing is left.
    """
    stars = sigma_px.shape[1]
    pure = document_px**2 * stars / (stars - 1) - 2.0 * (sigma_px**2).mean((0, 1)) / frames
    return np.asarray(np.sqrt(np.maximum(pure, 0.0) / 2.0))


def single_rms_px(error_px: FloatArray, sigma_px: FloatArray | None = None, frames: int = 1) -> FloatArray:
    """RMS error (2,) of a position: mean centroid minus truth, without the common part and the temporal noise."""
    stars = error_px.shape[1]
    square = (common_removed(error_px) ** 2).mean((0, 1)) * stars / (stars - 1)
    if sigma_px is not None:
        square = square - (sigma_px**2).mean((0, 1)) / frames
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def jackknife_px(mean_px: FloatArray) -> FloatArray:
    """Standard error (2,) of `document_rms_px` over the choice of stars, leaving out one after the other."""
    stars = mean_px.shape[1]
    if stars < 3:
        return np.full(2, np.nan)
    left = np.stack([document_rms_px(np.delete(mean_px, j, axis=1)) for j in range(stars)])
    return np.asarray(np.sqrt((stars - 1) / stars * ((left - left.mean(0)) ** 2).sum(0)))


def document_arcsec(mean_px: FloatArray, pixel_arcsec: float) -> tuple[Measured, Measured]:
    """HSFE as printed (eq. 11-12), 3 sigma, x and y; uncertainty by the jackknife over the stars, if three or more."""
    value, error = (3.0 * pixel_arcsec * of(mean_px) for of in (document_rms_px, jackknife_px))
    count = mean_px.shape[1] * (mean_px.shape[0] - 1)
    x, y = (
        Measured(value=float(v), unit="arcsec", uncertainty=float(e) if np.isfinite(e) else None, n=count)
        for v, e in zip(value, error, strict=True)
    )
    return x, y


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionError:
    """Error of the mean centroid at one position about its mean over the path, along x and y, without truth."""

    variance_px2: FloatArray  # (2,) Unbiased estimate; negative where temporal noise happens to explain more than all
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
    mean_px: FloatArray, sigma_px: FloatArray, frames: FloatArray, *, level: float = 0.95
) -> PositionError:
    """Error of a position by an analysis of variance: scatter over the positions minus the part of temporal noise.

    With e the error of star j at position m, the mean centroid is ``base_j + motion_m(place_j) + e_mj + noise``. Star
    means and, at every position, the motion of the image (shift; with five stars or more also roll, scale and shear)
    are fitted. The residual has the mean square sigma_e^2 + sigma^2/N, from which the pooled variance of the frames
    over N is taken.

    The interval is that of Williams and Tukey for a component of variance (Searle, Casella and McCulloch 1992, sec.
    3.6d): conservative where the component is small. A negative estimate has the upper limit of an estimate of zero:
    a lucky draw of the noise does not make the test more sensitive than it is. Errors of neighbouring positions are
    alike, so that m positions count as fewer: the degrees of freedom are ``tr(S)^2 / tr(S^2)`` times those of the
    stars, S the covariance of the positions, with the traces estimated without bias from the stars (Srivastava 2005, J.
    Japan Stat. Soc. 35, 251).
    """
    if mean_px.ndim != 3 or mean_px.shape[0] < 2 or mean_px.shape[1] < 2:
        raise DomainError(f"mean centroids of shape {mean_px.shape}; at least 2 positions of 2 stars are needed")
    positions, stars, _ = mean_px.shape
    place = mean_px.mean(0)
    terms = np.column_stack([np.ones(stars), place - place.mean(0)])
    across, size, _ = np.linalg.svd(terms if stars > MOTION_TERMS + 1 else terms[:, :1], full_matrices=False)
    base = across[:, size > 1e-9 * size[0]]
    left = mean_px - place
    left = left - np.einsum("jk,lk,mla->mja", base, base, left)
    free = stars - base.shape[1]
    nominal = (positions - 1.0) * free
    scatter = (left**2).sum((0, 1)) / nominal
    counts = np.asarray(frames, float)[:, None, None]
    of_noise = (sigma_px**2 / counts).mean((0, 1))
    weight = (sigma_px**2 / counts) ** 2 / (counts - 1.0)
    noise_degrees = of_noise**2 * (positions * stars) ** 2 / np.maximum(weight.sum((0, 1)), 1e-300)
    degrees = np.array([_degrees(left[..., a], free) for a in range(2)])
    tail = 0.5 * (1.0 - level)

    def bound(probability: float, least: FloatArray | float = 0.0) -> FloatArray:
        ratio = fisher_f.isf(probability, degrees, noise_degrees)
        pure = (np.maximum(scatter, least) - of_noise * ratio) * degrees / chi2.isf(probability, degrees)
        return np.asarray(np.sqrt(np.maximum(pure, 0.0)))

    return PositionError(
        variance_px2=scatter - of_noise,
        low_px=bound(tail),
        high_px=bound(1.0 - tail),
        upper_px=bound(level, of_noise),
        degrees=degrees,
        level=level,
    )


def _degrees(left_px: FloatArray, free: int) -> float:
    """Degrees of freedom of the sum of squares of residuals (m, W) of ``free`` independent stars."""
    covariance = left_px @ left_px.T / free
    first, second = float(np.trace(covariance)), float((covariance**2).sum())
    nominal = (len(left_px) - 1.0) * free
    if free < 2 or first <= 0.0:
        return nominal if free > 1 else float(free)
    squared = (second - first**2 / free) * free**2 / ((free - 1.0) * (free + 2.0))
    return float(np.clip(free * first**2 / max(squared, 1e-300), free, nominal))
