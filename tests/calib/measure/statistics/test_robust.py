"""Robust statistics against normal samples with outliers."""

import numpy as np
import pytest

from calib.measure.statistics.robust import (
    clipped_mean,
    quantile_sigma,
    rms_pull,
    rms_within,
    robust_median,
    robust_scatter,
)


def test_robust_numbers_of_normal_values():
    drawn = np.random.default_rng(3).normal(0.3, 2.0, (5000, 2))
    sigma, error = robust_scatter(drawn)
    assert abs(sigma - 2.0) < 4.0 * error
    assert error == pytest.approx(2.0 * 1.166 / np.sqrt(drawn.size), rel=0.05)
    median, spread = robust_median(drawn[:, 0])
    assert abs(median - 0.3) < 4.0 * spread
    assert spread == pytest.approx(1.2533 * 2.0 / np.sqrt(5000.0), rel=0.05)
    rms, error = rms_pull(drawn - 0.3)
    assert abs(rms - 2.0) < 4.0 * 2.0 * error


def test_robust_statistics_of_a_normal_sample_with_outliers():
    """5000 values: mean within 4 / sqrt(5000), deviation by quantiles within 4 * 1.3 / sqrt(5000)."""
    values = np.random.default_rng(2).standard_normal(5000)
    values[:20], values[20] = 50.0, np.nan
    assert clipped_mean(values) == pytest.approx(0.0, abs=0.057)
    assert quantile_sigma(values) == pytest.approx(0.9945, abs=0.075)  # the quantiles 0.16, 0.84 lie at 0.9945 sigma
    assert np.isnan([clipped_mean(values[:2]), quantile_sigma(values[:5])]).all()
    vectors = np.column_stack([np.tile([3.0, -3.0], 5), np.tile([4.0, 4.0], 5)])
    assert rms_within(np.vstack([vectors, [[60.0, 80.0]]]), 6.0) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(rms_within(vectors, 1.0))
