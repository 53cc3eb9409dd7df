"""Statistics of `detect`: false alarms by noise alone, and the probability of detection.

The image is filtered with a Gaussian; a detection is a local maximum above the threshold. In white noise the filtered
pixels are normal with the autocorrelation of the kernel. A maximum of height z needs both its neighbours along each
axis below z; for a kernel that is a product of its axes the probability is about the product of theirs (K. J. Worsley,
J. E. Taylor, F. Gosselin, Biometrika 94, 1 (2007), "Maxima of discretely sampled random fields"). At low thresholds
several neighbours are high and diagonal ones matter too; above 3 sigma the number is correct within a few percent.

A star is detected if one of the nine filtered pixels around it exceeds the threshold. Their joint normal distribution
is sampled with common random numbers, so that the probability is a smooth function of all parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq
from scipy.special import ndtr, owens_t
from scipy.stats import norm

from calib.measure.centroiding.moments import FWHM_PER_SIGMA
from optics.arrays import FloatArray
from optics.errors import DomainError

HEIGHTS, SPREADS, DRAWS, CHUNK = 60, 15, 1024, 32
CLIP_SIGMA = 3.0
LOWEST, HIGHEST = 2.0, 40.0
"""Range of thresholds [sigma]."""


@lru_cache(maxsize=16)
def filter_kernel(fwhm_px: float) -> FloatArray:
    """Filter of `detect` on an odd window that contains all of it."""
    half = int(np.ceil(2.0 * fwhm_px)) + 2
    delta = np.zeros((2 * half + 1, 2 * half + 1))
    delta[half, half] = 1.0
    return gaussian_filter(delta, fwhm_px / FWHM_PER_SIGMA, mode="constant")


def _correlation(fwhm_px: float, dy: int, dx: int) -> float:
    """Correlation of two filtered pixels in white noise."""
    kernel = filter_kernel(fwhm_px)
    height, width = kernel.shape
    a = kernel[max(dy, 0) : height + min(dy, 0), max(dx, 0) : width + min(dx, 0)]
    b = kernel[max(-dy, 0) : height + min(-dy, 0), max(-dx, 0) : width + min(-dx, 0)]
    return float((a * b).sum() / (kernel**2).sum())


def kernel_correlation(fwhm_px: float) -> tuple[float, float]:
    """Correlation of pixels at distances of 1 and 2 px after the filter, in white noise."""
    return _correlation(fwhm_px, 0, 1), _correlation(fwhm_px, 0, 2)


@lru_cache(maxsize=64)
def _probability_of_maximum(rho_1: float, rho_2: float) -> tuple[FloatArray, FloatArray]:
    """Heights z [sigma], and the probability that a pixel of that height exceeds both neighbours along an axis, for
    the correlations at distances of 1 and 2 px."""
    variance, covariance = 1.0 - rho_1**2, rho_2 - rho_1**2
    covariance = float(np.clip(covariance, -0.999 * variance, 0.999 * variance))
    height = np.linspace(0.0, HIGHEST, HEIGHTS)
    limit = (1.0 - rho_1) * height / np.sqrt(variance)
    # two correlated normal variates below the same limit (Owen 1956, Ann. Math. Statist. 27, 1075, eq. 2.1)
    probability = ndtr(limit) - 2.0 * owens_t(limit, np.sqrt((variance - covariance) / (variance + covariance)))
    return height, np.asarray(probability)


def maxima_per_pixel(
    threshold: ArrayLike, correlation_x: tuple[float, float], correlation_y: tuple[float, float]
) -> FloatArray:
    """Local maxima above ``threshold`` [sigma] per pixel of a normal field, with correlations at 1 and 2 px."""
    z = np.asarray(threshold, np.float64)[..., None] + np.linspace(0.0, 6.0, 121)
    density = norm.pdf(z)
    for correlation in (correlation_x, correlation_y):
        density = density * np.interp(z, *_probability_of_maximum(*correlation))
    return np.asarray(np.trapezoid(density, z, axis=-1))


def false_alarms(
    threshold_sigma: ArrayLike, pixels: int, *, fwhm_px: float = 2.0, noise_spread: float = 0.0
) -> FloatArray:
    """Expected number of detections by noise alone in an image; ``noise_spread``: of the variance over the pixels."""
    threshold = np.asarray(threshold_sigma, np.float64)
    kernel = filter_kernel(fwhm_px)
    spread2 = noise_spread**2 * float((kernel**4).sum()) / float((kernel**2).sum()) ** 2
    width = np.sqrt(np.log1p(spread2))
    node, weight = np.polynomial.hermite_e.hermegauss(SPREADS)
    scale = np.exp(0.5 * width * node - 0.25 * width**2)  # local noise over its mean
    correlation = kernel_correlation(fwhm_px)
    maxima = maxima_per_pixel(threshold[..., None] / scale, correlation, correlation)
    return np.asarray(pixels * maxima @ (weight / weight.sum()))


def clipped_noise(noise_spread: float, added: ArrayLike = 0.0, fraction: ArrayLike = 1.0) -> float:
    """Noise after clipping at 3 sigma (`calib.measure.background.estimate_background`) over the root mean square.

    Unequal noise of the pixels makes tails, which clipping removes: the value, and the detection limit stated in units
    of it, are lower. The variance of the pixels is log-normal with this relative spread; fractions (q,) of the pixels
    have ``added`` (q,) variance, in units of its mean.
    """
    width = np.sqrt(np.log1p(noise_spread**2))
    node, weight = np.polynomial.hermite_e.hermegauss(SPREADS)
    variance = np.add.outer(np.atleast_1d(added), np.exp(width * node - 0.5 * width**2)).ravel()
    fraction = np.outer(np.asarray(fraction, float), weight / weight.sum()).ravel()
    sigma = np.sqrt(variance / (fraction @ variance))

    def inside(limit: float, deviation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Probability and second moment within +-limit of normal variates."""
        edge = limit / deviation
        probability = 2.0 * ndtr(edge) - 1.0
        return probability, deviation**2 * (probability - 2.0 * edge * norm.pdf(edge))

    (normal,), (normal2,) = inside(CLIP_SIGMA, np.ones(1))
    clipped = 1.0
    for _ in range(40):
        probability, square = inside(CLIP_SIGMA * clipped, sigma)
        clipped = float(np.sqrt((fraction @ square) / (fraction @ probability) / (normal2 / normal)))
    return clipped


def threshold_for_false_alarms(count: float, pixels: int, *, fwhm_px: float = 2.0, noise_spread: float = 0.0) -> float:
    """Detection limit [sigma] with an expected number of false alarms per image; parameters as `false_alarms`."""

    def alarms(threshold: float) -> float:
        return float(false_alarms(threshold, pixels, fwhm_px=fwhm_px, noise_spread=noise_spread))

    return solve_threshold(alarms, count, pixels)


def solve_threshold(alarms: Callable[[float], float], count: float, pixels: int) -> float:
    """Threshold [sigma] at which a falling number of false alarms per image has the value ``count``."""

    def excess(threshold: float) -> float:
        return float(np.log(max(alarms(threshold), 1e-300) / count))

    if not count > 0.0 or excess(LOWEST) < 0.0 or excess(HIGHEST) > 0.0:
        most = alarms(LOWEST)
        raise DomainError(f"{count:g} false alarms per image of {pixels} px; it must lie between 0 and {most:.3g}")
    return float(brentq(excess, LOWEST, HIGHEST, xtol=1e-6))


def detection_probability(
    unit_light: FloatArray,
    flux_e: ArrayLike,
    *,
    empty_e2: float,
    threshold_sigma: float,
    fwhm_px: float = 2.0,
) -> FloatArray:
    """Probability (k, p) that stars of k fluxes and p images of unit light (p, h, w) are detected."""
    kernel = filter_kernel(fwhm_px)
    power = float((kernel**2).sum())
    flux = np.atleast_1d(np.asarray(flux_e, np.float64))
    width = fwhm_px / FWHM_PER_SIGMA
    middle = tuple(slice(n // 2 - 1, n // 2 + 2) for n in unit_light.shape[1:])
    peak = gaussian_filter(unit_light, (0.0, width, width), mode="constant")[(slice(None), *middle)].reshape(-1, 9)
    # the square of the kernel is a Gaussian of width / sqrt(2): photon noise of the nine
    squared = gaussian_filter(unit_light, (0.0, width / np.sqrt(2.0), width / np.sqrt(2.0)), mode="constant")
    photon = power * squared[(slice(None), *middle)].reshape(-1, 9)
    limit = threshold_sigma * np.sqrt(empty_e2 * power)
    mean = flux[:, None, None] * peak
    sigma = np.sqrt(empty_e2 * power + flux[:, None, None] * np.maximum(photon, 0.0))
    needed = (limit - mean) / sigma  # (k, p, 9)
    draws = np.ascontiguousarray(_draws(fwhm_px).T, np.float32)
    least = needed.min(axis=2)
    probability = (least < 0.0).astype(np.float64)
    uncertain = np.abs(least) <= 6.0
    needed = needed[uncertain]  # (n, 9): the highest pixel in closed form, the contribution of the others by draws
    highest, star = needed.argmin(axis=1), np.arange(len(needed))
    probability[uncertain] = ndtr(-needed[star, highest])
    added = np.empty(len(needed))
    for rows in np.array_split(star, len(needed) // CHUNK + 1):
        above = draws > needed[rows, :, None].astype(np.float32)  # (rows, 9, draws)
        others = above.any(axis=1) & ~above[star[: len(rows)], highest[rows]]
        added[rows] = np.count_nonzero(others, axis=1) / DRAWS
    probability[uncertain] += added
    return np.minimum(probability, 1.0)


@lru_cache(maxsize=16)
def _draws(fwhm_px: float) -> FloatArray:
    """Nine filtered pixels in white noise (n, 9), unit variance."""
    pixel = [(y, x) for y in range(3) for x in range(3)]
    covariance = np.array([[_correlation(fwhm_px, a - c, b - d) for c, d in pixel] for a, b in pixel])
    root = np.linalg.cholesky(covariance + 1e-12 * np.eye(9))
    return np.asarray(np.random.default_rng(9).standard_normal((DRAWS, 9)) @ root.T)
