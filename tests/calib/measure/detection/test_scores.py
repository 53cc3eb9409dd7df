"""Scores of detections: numbers that are computed by hand, and drawn samples."""

import numpy as np
import pytest

from calib.measure.detection import scores as score


def test_pairs_are_mutual_and_near():
    stars = np.array([[0.0, 0.0], [10.0, 0.0], [11.0, 0.0], [50.0, 50.0]])
    detected = np.array([[0.5, 0.0], [10.4, 0.0], [30.0, 30.0]])
    pairs = score.nearest_pairs(stars, detected, 2.0)
    assert pairs.detection.tolist() == [0, 1, -1, -1]
    assert pairs.star.tolist()[:2] == [0, 1]
    np.testing.assert_allclose(pairs.distance_px, [0.5, 0.4, np.hypot(20.0, 20.0)])
    assert score.nearest_pairs(stars, detected, np.array([0.1, 2.0, 2.0, 2.0])).detection.tolist() == [-1, 1, -1, -1]
    assert score.nearest_pairs(stars[:0], detected, 2.0).star.tolist() == [-1, -1, -1]


def test_limits_of_a_sample():
    assert score.missed_limit(100, 0.01, 1e-3) == pytest.approx(0.05)  # P(more than 5 of 100) = 5e-4
    spread, limit = score.robust_ratio_limit(288, 1.05, 1e-3)
    assert (spread, limit) == pytest.approx((1.166 / 24.0, 1.05 + 3.0902 * 1.166 / 24.0), rel=1e-4)
    assert score.rate_excess_sigma(8, 1, 0, 3) == pytest.approx(8.0 / np.sqrt(9.0 + 1.0 / 9.0))
