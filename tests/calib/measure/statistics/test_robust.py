"""Robust statistics against normal samples with outliers."""

import numpy as np
import pytest

from calib.measure.statistics import robust


def test_robust_statistics_of_normal_samples_without_and_with_outliers():
    drawn = np.random.default_rng(3).normal(0.3, 2.0, (5000, 2))
    sigma, error = robust.robust_scatter(drawn)
    assert abs(sigma - 2.0) < 4.0 * error
    assert error == pytest.approx(2.0 * 1.166 / np.sqrt(drawn.size), rel=0.05)
    median, spread = robust.robust_median(drawn[:, 0])
    assert abs(median - 0.3) < 4.0 * spread
    assert spread == pytest.approx(1.2533 * 2.0 / np.sqrt(5000.0), rel=0.05)
    rms, error = robust.rms_pull(drawn - 0.3)
    assert abs(rms - 2.0) < 4.0 * 2.0 * error
    # 5000 values: mean within 4 / sqrt(5000), deviation by quantiles within 4 * 1.3 / sqrt(5000)
    values = np.random.default_rng(2).standard_normal(5000)
    values[:20], values[20] = 50.0, np.nan
    assert robust.clipped_mean(values) == pytest.approx(0.0, abs=0.057)
    assert robust.quantile_sigma(values) == pytest.approx(0.9945, abs=0.075)  # where the quantiles 0.16, 0.84 lie
    assert np.isnan([robust.clipped_mean(values[:2]), robust.quantile_sigma(values[:5])]).all()
    vectors = np.column_stack([np.tile([3.0, -3.0], 5), np.tile([4.0, 4.0], 5)])
    assert robust.rms_within(np.vstack([vectors, [[60.0, 80.0]]]), 6.0) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(robust.rms_within(vectors, 1.0))
