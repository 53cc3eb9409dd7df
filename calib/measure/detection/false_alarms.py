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

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq
from scipy.special import ndtr, owens_t

from calib.measure.centroiding.moments import FWHM_PER_SIGMA
from optics.arrays import FloatArray
from optics.errors import DomainError

HEIGHTS, SPREADS, DRAWS, AT_ONCE = 60, 15, 1024, 32
LOWEST, HIGHEST = 2.0, 40.0
"""Thresholds in which one for a number of false alarms is sought [sigma]."""


@lru_cache(maxsize=16)
def _kernel(fwhm_px: float) -> FloatArray:
    """Filter of `detect` on an odd window that holds all of it."""
    half = int(np.ceil(2.0 * fwhm_px)) + 2
    delta = np.zeros((2 * half + 1, 2 * half + 1))
    delta[half, half] = 1.0
    return gaussian_filter(delta, fwhm_px / FWHM_PER_SIGMA, mode="constant")


def _correlation(fwhm_px: float, dy: int, dx: int) -> float:
    """Correlation of two filtered pixels in white noise."""
    kernel = _kernel(fwhm_px)
    height, width = kernel.shape
    a = kernel[max(dy, 0) : height + min(dy, 0), max(dx, 0) : width + min(dx, 0)]
    b = kernel[max(-dy, 0) : height + min(-dy, 0), max(-dx, 0) : width + min(-dx, 0)]
    return float((a * b).sum() / (kernel**2).sum())


def _density(z: FloatArray) -> FloatArray:
    """Normal density."""
    return np.asarray(np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi))


def kernel_correlation(fwhm_px: float) -> tuple[float, float]:
    """Correlation of pixels one and two apart after the filter, in white noise."""
    return _correlation(fwhm_px, 0, 1), _correlation(fwhm_px, 0, 2)


@lru_cache(maxsize=64)
def _chance_of_maximum(one: float, two: float) -> tuple[FloatArray, FloatArray]:
    """Heights z [sigma], and how likely a pixel of that height exceeds its two neighbours along one axis; ``one``,
    ``two``: correlations of pixels one and two apart."""
    variance, shared = 1.0 - one**2, two - one**2
    shared = float(np.clip(shared, -0.999 * variance, 0.999 * variance))
    height = np.linspace(0.0, HIGHEST, HEIGHTS)
    below = (1.0 - one) * height / np.sqrt(variance)
    # both of two correlated normal variates below the same limit (Owen 1956, Ann. Math. Statist. 27, 1075, eq. 2.1)
    both = ndtr(below) - 2.0 * owens_t(below, np.sqrt((variance - shared) / (variance + shared)))
    return height, np.asarray(both)


def maxima_per_pixel(
    threshold: ArrayLike, correlation_x: tuple[float, float], correlation_y: tuple[float, float]
) -> FloatArray:
    """Local maxima above ``threshold`` [sigma] per pixel of a normal field.

    ``correlation_x`` and ``correlation_y`` are for pixels one and two apart along the axes.
    """
    z = np.asarray(threshold, np.float64)[..., None] + np.linspace(0.0, 6.0, 121)
    density = _density(z)
    for correlation in (correlation_x, correlation_y):
        density = density * np.interp(z, *_chance_of_maximum(*correlation))
    return np.asarray(np.trapezoid(density, z, axis=-1))


def false_alarms(
    threshold_sigma: ArrayLike, pixels: int, *, fwhm_px: float = 2.0, noise_spread: float = 0.0
) -> FloatArray:
    """Expected number of detections that noise alone makes in one image."""
    threshold = np.asarray(threshold_sigma, np.float64)
    kernel = _kernel(fwhm_px)
    share = noise_spread**2 * float((kernel**4).sum()) / float((kernel**2).sum()) ** 2
    width = np.sqrt(np.log1p(share))
    node, weight = np.polynomial.hermite_e.hermegauss(SPREADS)
    scale = np.exp(0.5 * width * node - 0.25 * width**2)  # noise of a place over its mean
    own = kernel_correlation(fwhm_px)
    return np.asarray(pixels * maxima_per_pixel(threshold[..., None] / scale, own, own) @ (weight / weight.sum()))


def clipped_noise(noise_spread: float, more: ArrayLike = 0.0, share: ArrayLike = 1.0, clip_sigma: float = 3.0) -> float:
    """Noise that clipping finds (`calib.measure.background.estimate_background`) over the root mean square.

    Pixels of unlike noise make tails; clipping takes them for outliers, corrects as for a normal distribution, and
    gives a smaller value. The detection limit, stated in that noise, is lower by as much. The variance of the pixels is
    log-normal with this relative spread; a ``share`` (q,) of them has ``more`` (q,), in units of its mean.
    """
    width = np.sqrt(np.log1p(noise_spread**2))
    node, weight = np.polynomial.hermite_e.hermegauss(SPREADS)
    variance = np.add.outer(np.atleast_1d(more), np.exp(width * node - 0.5 * width**2)).ravel()
    share = np.outer(np.asarray(share, float), weight / weight.sum()).ravel()
    sigma = np.sqrt(variance / (share @ variance))

    def inside(limit: float, each: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Probability and second moment within +-limit of normal variates."""
        edge = limit / each
        chance = 2.0 * ndtr(edge) - 1.0
        return chance, each**2 * (chance - 2.0 * edge * _density(edge))

    one = inside(clip_sigma, np.ones(1))
    shrink, found = float(one[1][0] / one[0][0]), 1.0
    for _ in range(40):
        chance, square = inside(clip_sigma * found, sigma)
        found = float(np.sqrt((share @ square) / (share @ chance) / shrink))
    return found


def threshold_for_false_alarms(count: float, pixels: int, *, fwhm_px: float = 2.0, noise_spread: float = 0.0) -> float:
    """Detection limit [sigma] with an expected number of false alarms per image; parameters as `false_alarms`."""

    def excess(threshold: float) -> float:
        expected = float(false_alarms(threshold, pixels, fwhm_px=fwhm_px, noise_spread=noise_spread))
        return float(np.log(max(expected, 1e-300)) - np.log(count))

    if not count > 0.0 or excess(LOWEST) < 0.0 or excess(HIGHEST) > 0.0:
        most = float(false_alarms(LOWEST, pixels, fwhm_px=fwhm_px, noise_spread=noise_spread))
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
    """Chance that stars are found.

    Shapes: ``unit_light`` (p, h, w), ``flux_e`` (k,).
    """
    kernel = _kernel(fwhm_px)
    power = float((kernel**2).sum())
    flux = np.atleast_1d(np.asarray(flux_e, np.float64))
    width = fwhm_px / FWHM_PER_SIGMA
    middle = tuple(slice(n // 2 - 1, n // 2 + 2) for n in unit_light.shape[1:])
    peak = gaussian_filter(unit_light, (0.0, width, width), mode="constant")[(slice(None), *middle)].reshape(-1, 9)
    # the square of the kernel is a Gaussian of width / sqrt(2): what photon noise adds to the nine
    squared = gaussian_filter(unit_light, (0.0, width / np.sqrt(2.0), width / np.sqrt(2.0)), mode="constant")
    photon = power * squared[(slice(None), *middle)].reshape(-1, 9)
    limit = threshold_sigma * np.sqrt(empty_e2 * power)
    mean = flux[:, None, None] * peak
    sigma = np.sqrt(empty_e2 * power + flux[:, None, None] * np.maximum(photon, 0.0))
    needed = (limit - mean) / sigma  # (k, p, 9)
    draws = np.ascontiguousarray(_draws(fwhm_px).T, np.float32)
    best = needed.min(axis=2)
    out = (best < 0.0).astype(np.float64)
    unsure = np.abs(best) <= 6.0
    here = needed[unsure]  # (n, 9): the highest pixel exactly, what the others add by draws
    top, every = here.argmin(axis=1), np.arange(len(here))
    out[unsure] = ndtr(-here[every, top])
    added = np.empty(len(here))
    for rows in np.array_split(every, len(here) // AT_ONCE + 1):
        hit = draws > here[rows, :, None].astype(np.float32)  # (rows, 9, draws)
        alone = hit.any(axis=1) & ~hit[every[: len(rows)], top[rows]]
        added[rows] = np.count_nonzero(alone, axis=1) / DRAWS
    out[unsure] += added
    return np.minimum(out, 1.0)


@lru_cache(maxsize=16)
def _draws(fwhm_px: float) -> FloatArray:
    """Nine filtered pixels in white noise (n, 9), unit variance."""
    place = [(y, x) for y in range(3) for x in range(3)]
    covariance = np.array([[_correlation(fwhm_px, a - c, b - d) for c, d in place] for a, b in place])
    root = np.linalg.cholesky(covariance + 1e-12 * np.eye(9))
    return np.asarray(np.random.default_rng(9).standard_normal((DRAWS, 9)) @ root.T)
