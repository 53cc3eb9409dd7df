"""Scatter beyond the stated one, of drawn residuals."""

import numpy as np
import pytest

from calib.fitting.excess_error import excess_sigma


def test_excess_is_the_scatter_that_was_not_stated():
    """2 n numbers of variance v: known to v / sqrt(n); one outlier in a hundred, 40 sigma off, changes nothing."""
    rng, count = np.random.default_rng(1), 4000
    variance = rng.uniform(0.5, 2.0, count) * 0.05**2
    residual = np.sqrt(variance + 0.08**2)[:, None] * rng.standard_normal((count, 2))
    residual[::100] += 4.0
    total = variance.mean() + 0.08**2
    assert excess_sigma(residual, variance) ** 2 == pytest.approx(0.08**2, abs=4.0 * total / np.sqrt(count))
    assert excess_sigma(0.5 * np.sqrt(variance)[:, None] * np.ones((count, 2)), variance) == 0.0
    # all of 400 values beyond five stated sigma, and stated errors of nearly 0: within 4 / sqrt(800)
    residual = 0.05 * np.sign(np.random.default_rng(1).standard_normal((400, 1)))
    assert excess_sigma(residual, np.full(400, 1e-8)) == pytest.approx(0.05, rel=1e-5)
    assert excess_sigma(residual * np.random.default_rng(2).standard_normal((400, 1)), np.full(400, 1e-12)) == (
        pytest.approx(0.05, rel=4.0 / np.sqrt(800.0))
    )
