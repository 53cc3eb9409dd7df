"""Errors of known covariance: sampled moments, the chi-square law, the density of independent normals."""

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from calib.fitting.normal_errors import correlated_errors, log_likelihood, normalised_squares

SIGMA = np.array([1.0, 1e-6, 300.0])
CORRELATION = np.array([[1.0, 0.9, -0.3], [0.9, 1.0, 0.0], [-0.3, 0.0, 1.0]])
COVARIANCE = CORRELATION * np.outer(SIGMA, SIGMA)


def test_drawn_errors_have_the_covariance_and_the_likelihood_of_scipy():
    """N = 40000: correlations within 4 / sqrt(N)."""
    drawn = correlated_errors(COVARIANCE, np.random.default_rng(2).standard_normal((40000, 3)))
    np.testing.assert_allclose(np.cov(drawn.T) / np.outer(SIGMA, SIGMA), CORRELATION, atol=4 * 1.5 / 200)
    error = np.array([0.5, -2e-7, 100.0])
    chi_square, logarithm = log_likelihood(error, COVARIANCE)
    density = multivariate_normal(np.zeros(3), CORRELATION).logpdf(error / SIGMA) - np.log(SIGMA).sum()
    assert logarithm - 1.5 * np.log(2.0 * np.pi) == pytest.approx(density)
    assert chi_square == pytest.approx((error / SIGMA) @ np.linalg.inv(CORRELATION) @ (error / SIGMA))


@pytest.mark.parametrize(("grown", "bias", "expected"), [(1.0, 0.0, 1.0), (1.25, 0.0, 1.25**2), (1.0, 2.0, 7.0 / 3.0)])
def test_normalised_squares_notice_a_wrong_covariance_and_a_bias(grown, bias, expected):
    """A bias of two deviates of one source adds 4 / 3 to the mean square; N = 20000, variance 2 / (3 N) and more."""
    normal = np.random.default_rng(5).standard_normal((20000, 3))
    normal[:, 1] += bias
    square = normalised_squares(grown * correlated_errors(COVARIANCE, normal), COVARIANCE)
    assert square.mean() / 3.0 == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / 60000) * 1.5)
    if expected == 1.0:
        assert np.mean(square > chi2.isf(0.05, 3)) == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / 20000))
