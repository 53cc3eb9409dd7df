"""Completeness, limiting magnitude, clouds and robust statistics of drawn stars."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import expit

from calib.measure.detection.limiting_magnitude import (
    clouded_fraction,
    completeness,
    detected_stars,
    empty_fraction,
    limiting_magnitude,
)


def test_a_detection_is_the_brightest_star_within_reach():
    star = np.array([[10.0, 10.0], [11.0, 10.0], [50.0, 50.0]])  # the brightest first
    detection = np.array([[10.8, 10.0], [30.0, 30.0], [10.0, 10.2]])
    height, unknown = detected_stars(star, detection, np.array([8.0, 6.0, 9.0]), 1.5)
    np.testing.assert_array_equal(height, [9.0, 0.0, 0.0])
    np.testing.assert_array_equal(unknown, [False, True, False])
    assert detected_stars(star[:0], detection, np.ones(3), 1.5)[1].all()


def test_limit_of_a_logistic_curve_and_fractions_per_bin():
    """2000 stars of a curve of width 0.2 mag about 8.0: 4 standard errors, 4 * 2 * sqrt(0.2 * 4 / 2000) * 0.5."""
    rng = np.random.default_rng(1)
    magnitude = rng.uniform(6.0, 10.0, 2000)
    detected = rng.uniform(size=2000) < expit((8.0 - magnitude) / 0.2)
    assert limiting_magnitude(magnitude, detected) == pytest.approx(8.0, abs=0.08)
    assert np.isnan(limiting_magnitude(magnitude, np.ones(2000, bool)))
    count, fraction = completeness(
        np.array([5.1, 5.2, 5.6, 5.7]), np.array([True, False, True, True]), np.array([5.0, 5.5, 6.0, 6.5])
    )
    np.testing.assert_array_equal(count, [2, 2, 0])
    np.testing.assert_array_equal(fraction, [0.5, 1.0, np.nan])


def test_clouds_over_a_part_of_the_frame():
    position = np.random.default_rng(0).uniform(0, 512, (300, 2))
    assert clouded_fraction((512, 512), position, position[:, 0] < 512 / 3) == pytest.approx(2 / 3)
    assert clouded_fraction((512, 512), position, np.ones(300, bool)) == 0.0
    assert clouded_fraction((512, 512), position[:4], np.zeros(4, bool)) == 0.0  # too few to judge
    assert empty_fraction((512, 512), position[position[:, 1] < 512 * 0.4]) == pytest.approx(0.6)
    assert empty_fraction((512, 512), position[:5]) == 0.0
