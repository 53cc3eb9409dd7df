"""Cramer-Rao bound: the smallest variance an unbiased estimator can have, from any pixel model and its noise.

Signal-to-noise ratio everywhere means that of the *matched filter*: flux over the standard deviation that an optimal
estimator of the flux alone would have, position and background known,

    SNR = F sqrt( sum over pixels of P^2 / variance ),

P being the fraction of the light in each pixel. In the limit of photon noise alone this is sqrt(F).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import poisson

from calib.records import NoiseModel
from optics.arrays import FloatArray
from optics.errors import DomainError


def fisher_information(
    jacobian: FloatArray,
    expected_e: FloatArray,
    noise: NoiseModel,
    *,
    valid: NDArray[np.bool_] | None = None,
    exact: bool = False,
) -> FloatArray:
    """Fisher information of the parameters of a pixel model.

    Parameters
    ----------
    jacobian : (..., k, p)
        Derivatives of the expected electrons of p pixels by k parameters.
    expected_e : (..., p)
        Expected electrons, background included.
    noise : NoiseModel
        Noise of a pixel.
    valid : (..., p) bool, optional
        Pixels to use.
    exact : bool
        Information of the exact Poisson-normal law (`poisson_normal_gain`) instead of 1 / variance.

    Returns
    -------
    (..., k, k) ndarray
    """
    weight = 1.0 / noise.variance_e2(expected_e)
    if exact:
        weight = weight * poisson_normal_gain(expected_e, np.sqrt(noise.floor_e2))
    if valid is not None:
        weight = np.where(valid, weight, 0.0)
    return (jacobian * weight[..., None, :]) @ np.swapaxes(jacobian, -1, -2)


def position_bound_px(jacobian: FloatArray, expected_e: FloatArray, noise: NoiseModel) -> FloatArray:
    """Bound (..., 2) on the standard deviation of x and y, the first two of the parameters of `fisher_information`."""
    covariance = np.linalg.inv(fisher_information(jacobian, expected_e, noise))
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1)[..., :2])


def cramer_rao(
    model: Callable[[FloatArray], ArrayLike],
    parameters: ArrayLike,
    noise: NoiseModel,
    *,
    steps: ArrayLike | None = None,
    valid: NDArray[np.bool_] | None = None,
    exact: bool = False,
) -> FloatArray:
    """Bound on the covariance of the parameters of any pixel model, derivatives by central differences.

    Parameters
    ----------
    model : callable
        ``model(parameters)`` gives the expected electrons of all pixels (any shape), background included.
    parameters : (k,)
        Where to evaluate.
    steps : (k,), optional
        Steps of the differences; 1e-4 of each parameter, or of 1 where it is smaller, without it.
    noise, valid, exact
        As of `fisher_information`.

    Returns
    -------
    (k, k) ndarray
        Inverse of the Fisher information.

    Raises
    ------
    DomainError
        If the pixels do not determine the parameters.
    """
    theta = np.asarray(parameters, dtype=np.float64)
    width = 1e-4 * np.maximum(1.0, np.abs(theta)) if steps is None else np.asarray(steps, dtype=np.float64)
    jacobian = []
    for i, step in enumerate(width):
        shift = np.zeros_like(theta)
        shift[i] = step
        jacobian.append((np.ravel(model(theta + shift)) - np.ravel(model(theta - shift))) / (2.0 * step))
    expected = np.ravel(np.asarray(model(theta), dtype=np.float64))
    mask = None if valid is None else np.ravel(valid)
    information = fisher_information(np.array(jacobian), expected, noise, valid=mask, exact=exact)
    scale = np.sqrt(np.outer(np.diagonal(information), np.diagonal(information)))
    if not np.all(scale > 0) or np.linalg.cond(information / scale) > 1e12:
        raise DomainError("the pixels do not determine the parameters (singular Fisher information); use fewer")
    return np.asarray(np.linalg.inv(information / scale) / scale)


def matched_snr(unit_psf: FloatArray, flux_e: ArrayLike, background_e: ArrayLike, noise: NoiseModel) -> FloatArray:
    """Matched-filter SNR of stars with pixel fractions ``unit_psf`` (..., h, w), flux and background (...)."""
    flux = np.asarray(flux_e, dtype=np.float64)[..., None, None]
    variance = noise.variance_e2(flux * unit_psf + np.asarray(background_e, dtype=np.float64)[..., None, None])
    return np.asarray(flux[..., 0, 0] * np.sqrt(np.sum(unit_psf**2 / variance, axis=(-2, -1))))


def flux_for_snr(unit_psf: FloatArray, snr: float, background_e: float, noise: NoiseModel) -> float:
    """Flux [e-] that gives ``snr`` for one star with pixel fractions ``unit_psf`` (h, w), by bisection."""
    if not snr > 0:
        raise DomainError(f"snr = {snr}; it must be positive")
    low, high = 1e-6, 1e6 * (snr + 1.0) ** 2 * (1.0 + background_e + noise.floor_e2)
    for _ in range(200):
        middle = np.sqrt(low * high)
        if matched_snr(unit_psf, middle, background_e, noise) < snr:
            low = middle
        else:
            high = middle
    return float(np.sqrt(low * high))


def flux_snr(electrons: FloatArray, area_px2: FloatArray, *, noise_e2: float) -> FloatArray:
    """Signal-to-noise ratio of the flux measured with optimal weights; 0 without light.

    Its square is the sum over pixels of (N p)^2 / (N p + n), with fractions p of N electrons and noise n of a pixel.
    For a Gaussian image of noise-equivalent area A that is N (1 - u ln(1 + 1 / u)), u = A n / 2 N; for faint stars
    N^2 / A n for any image (I. R. King, PASP 95, 163 (1983)).
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        u = area_px2 * noise_e2 / (2.0 * electrons)
        # beyond u = 1e6 the difference cancels: its limit
        fraction = np.where(u < 1e6, 1.0 - u * np.log1p(1.0 / u), 0.5 / u)
    return np.asarray(np.sqrt(np.where(electrons > 0.0, electrons * np.nan_to_num(fraction, nan=1.0), 0.0)))


def poisson_normal_gain(expected_e: ArrayLike, read_noise_e: float) -> FloatArray:
    """Fisher information of the exact Poisson-normal law on the expectation m of a pixel, times (m + r^2), r the read
    noise; shaped as ``expected_e``.

    1 for many electrons; ``r^2 (exp(1 / r^2) - 1)`` for m -> 0 (0 against 1 electron).
    """
    mean = np.maximum(np.asarray(expected_e, dtype=np.float64), 1e-4)
    if read_noise_e < 0.2:  # single electrons are resolved: pure Poisson, information 1 / m
        return 1.0 + read_noise_e**2 / mean
    nodes, gain = _gain_table(float(read_noise_e))
    return np.asarray(np.interp(np.log(mean), nodes, gain))


@lru_cache(maxsize=32)
def _gain_table(read_noise_e: float) -> tuple[FloatArray, FloatArray]:
    """Gain at the logarithms of expectations from 1e-4 to 200 electrons, then falling to 1 at 1000."""
    means = np.geomspace(1e-4, 200.0, 60)
    step = min(read_noise_e, 1.0) / 3.0  # the trapezoid rule on normals converges beyond all orders below sigma / 2
    gain = []
    for m in means:
        k = np.arange(int(m + 10.0 * np.sqrt(m)) + 25)
        probability = poisson.pmf(k, m)
        slope = np.concatenate([[0.0], probability[:-1]]) - probability
        d = np.arange(-9.0 * read_noise_e, k[-1] + 9.0 * read_noise_e, step)
        normal = np.exp(-0.5 * ((d[:, None] - k) / read_noise_e) ** 2) / (read_noise_e * np.sqrt(2.0 * np.pi))
        density, change = normal @ probability, normal @ slope
        used = density > 1e-200
        gain.append((m + read_noise_e**2) * step * np.sum(change[used] ** 2 / density[used]))
    return np.append(np.log(means), np.log(1000.0)), np.append(np.maximum(gain, 1.0), 1.0)
