"""Scores of detections: numbers that are computed by hand, and drawn samples."""

import numpy as np
import pytest

from calib.measure import detection_score as score


def test_pairs_are_mutual_and_near():
    stars = np.array([[0.0, 0.0], [10.0, 0.0], [11.0, 0.0], [50.0, 50.0]])
    detected = np.array([[0.5, 0.0], [10.4, 0.0], [30.0, 30.0]])
    pairs = score.nearest_pairs(stars, detected, 2.0)
    assert pairs.detection.tolist() == [0, 1, -1, -1]
    assert pairs.star.tolist()[:2] == [0, 1]
    np.testing.assert_allclose(pairs.distance_px, [0.5, 0.4, np.hypot(20.0, 20.0)])
    assert score.nearest_pairs(stars, detected, np.array([0.1, 2.0, 2.0, 2.0])).detection.tolist() == [-1, 1, -1, -1]
    assert score.nearest_pairs(stars[:0], detected, 2.0).star.tolist() == [-1, -1, -1]


def test_robust_numbers_of_normal_values():
    drawn = np.random.default_rng(3).normal(0.3, 2.0, (5000, 2))
    sigma, error = score.robust_scatter(drawn)
    assert abs(sigma - 2.0) < 4.0 * error
    assert error == pytest.approx(2.0 * 1.166 / np.sqrt(drawn.size), rel=0.05)
    median, spread = score.robust_median(drawn[:, 0])
    assert abs(median - 0.3) < 4.0 * spread
    assert spread == pytest.approx(1.2533 * 2.0 / np.sqrt(5000.0), rel=0.05)
    rms, error = score.rms_pull(drawn - 0.3)
    assert abs(rms - 2.0) < 4.0 * 2.0 * error


def test_limits_of_a_sample():
    assert score.missed_limit(100, 0.01, 1e-3) == pytest.approx(0.05)  # P(more than 5 of 100) = 5e-4
    spread, limit = score.robust_ratio_limit(288, 1.05, 1e-3)
    assert (spread, limit) == pytest.approx((1.166 / 24.0, 1.05 + 3.0902 * 1.166 / 24.0), rel=1e-4)
    assert score.rate_excess_sigma(8, 1, 0, 3) == pytest.approx(8.0 / np.sqrt(9.0 + 1.0 / 9.0))
    magnitude, detected = np.array([5.0, 6.0, 7.0, 8.0]), np.array([1.0, 0.9, 0.4, 0.1])
    assert score.completeness_magnitude(magnitude, detected) == pytest.approx(6.8)
    assert np.isnan(score.completeness_magnitude(magnitude, np.ones(4)))


def test_optimal_snr_of_bright_and_faint_stars():
    """Photon noise alone for bright stars; background noise in the area for faint ones."""
    assert score.flux_snr(np.array([1e8]), np.array([5.0]), noise_e2=100.0)[0] == pytest.approx(1e4, rel=1e-3)
    faint = score.flux_snr(np.array([1e-3, 0.0]), np.array([5.0, 5.0]), noise_e2=100.0)
    np.testing.assert_allclose(faint, [1e-3 / np.sqrt(500.0), 0.0], rtol=1e-4)
