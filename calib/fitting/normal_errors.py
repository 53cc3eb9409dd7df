"""Errors with a normal distribution of known covariance: draws, normalised squares, likelihood.

Covariances of unknowns of very different size are scaled to correlations before they are factorised or inverted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray


def _correlation(covariance: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (p,) and correlations (p, p)."""
    spread = np.asarray(covariance, float)
    sigma = np.sqrt(np.diag(spread))
    return sigma, spread / np.outer(sigma, sigma)


def correlated_errors(covariance: ArrayLike, normal: ArrayLike) -> FloatArray:
    """Errors (d, p) of that covariance (p, p) from independent standard normal deviates (d, p)."""
    sigma, correlation = _correlation(covariance)
    return np.asarray(np.asarray(normal) @ (np.linalg.cholesky(correlation) * sigma[:, None]).T)


def normalised_squares(error: ArrayLike, covariance: ArrayLike) -> FloatArray:
    """Normalised squares e^T C^-1 e (d,) of errors (d, p), NEES: chi-square of p degrees of freedom if C is right."""
    sigma, correlation = _correlation(covariance)
    pull = np.asarray(error, float) / sigma
    return np.asarray((pull * np.linalg.solve(correlation, pull.T).T).sum(axis=1))


def log_likelihood(error: ArrayLike, covariance: ArrayLike) -> tuple[float, float]:
    """Chi-square of errors (p,) and the logarithm of their likelihood, without the constant -p/2 log(2 pi)."""
    sigma, correlation = _correlation(covariance)
    chi2 = float(normalised_squares(np.atleast_2d(error), covariance)[0])
    determinant = float(np.linalg.slogdet(correlation)[1] + 2.0 * np.log(sigma).sum())
    return chi2, -0.5 * (chi2 + determinant)


def conditioned(
    value: FloatArray, covariance: FloatArray, at: list[int], given: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Values (p,) and covariance (p, p) given that some unknowns have known values: conditional normal distribution."""
    gain = covariance[:, at] @ np.linalg.inv(covariance[np.ix_(at, at)])
    spread = covariance - gain @ covariance[at]
    spread[at], spread[:, at] = 0.0, 0.0
    return value - gain @ (value[at] - np.asarray(given, float)), spread
