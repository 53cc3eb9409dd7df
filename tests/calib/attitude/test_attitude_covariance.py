"""Predicted covariance of attitudes, against the estimator's scatter and closed forms."""

import numpy as np
import pytest
from star_directions import field_directions

from calib.attitude.attitude_covariance import (
    attitude_covariance,
    attitude_of_shifts,
    attitude_of_velocity,
    covariance_of_noise,
)
from calib.attitude.attitude_solution import solve_wahba
from optics.stellar_aberration import aberrated

HALF_RAD = 0.05
PAIR = np.array([[np.sin(a), 0.0, np.cos(HALF_RAD)] for a in (HALF_RAD, -HALF_RAD)])


def test_two_stars_across_and_roll():
    """At +-a along x: sigma / (sqrt 2 cos a) about x, sigma / sqrt 2 about y, sigma / (sqrt 2 sin a) about z."""
    sigma = 1e-5
    found = np.sqrt(np.diag(attitude_covariance(PAIR, np.full(2, sigma**2), np.zeros(2, int), 1)[0]))
    expected = sigma / np.sqrt(2.0) * np.array([1.0 / np.cos(HALF_RAD), 1.0, 1.0 / np.sin(HALF_RAD)])
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_one_star_leaves_the_roll_open_and_half_a_star_counts_half():
    rng = np.random.default_rng(2)
    v = field_directions(rng, 6, 5.7)
    frame = np.array([0, 0, 0, 0, 0, 2])
    found = attitude_covariance(v, np.full(6, 1e-10), frame, 3)
    assert np.isfinite(found[0]).all()
    assert np.isinf(found[1:]).all()
    half = attitude_covariance(v, np.full(6, 1e-10), frame, 3, probability=np.full(6, 0.5))
    np.testing.assert_allclose(half[0], 2.0 * found[0], rtol=1e-12)


def test_attitude_of_stars_follows_their_errors_to_first_order():
    """Against the estimator itself: Wahba's problem with weights, stars displaced and stars with noise."""
    rng = np.random.default_rng(4)
    v = field_directions(rng, 9, 5.7)
    sigma, shift = rng.uniform(1.0, 3.0, 9) * 1e-6, 1e-5 * rng.normal(size=(9, 3))
    shift -= (shift * v).sum(1)[:, None] * v
    seen = v + shift
    solved = solve_wahba(seen / np.linalg.norm(seen, axis=1)[:, None], v, sigma_rad=sigma)
    told = attitude_of_shifts(v, 1.0 / sigma**2, shift)
    np.testing.assert_allclose(told, solved.rotation.as_rotvec(), atol=2e-4 * np.abs(told).max())
    # with the right weights the covariance is the estimator's own
    covariance = covariance_of_noise(v, 1.0 / sigma**2, sigma**2)
    np.testing.assert_allclose(covariance, solved.covariance_rad2, rtol=1e-3, atol=1e-15)
    bound = attitude_covariance(v, sigma**2, np.zeros(9, int), 1)[0]
    np.testing.assert_allclose(bound, solved.covariance_rad2, rtol=1e-3, atol=1e-15)


def test_wrong_weights_cost_what_unequal_errors_make_of_them():
    """Two stars at +-a along x, equal weights, variances 1 and 9: a quarter of the sum, over sin(a)^2 in roll."""
    covariance = covariance_of_noise(PAIR, np.ones(2), np.array([1.0, 9.0]))
    assert covariance[1, 1] == pytest.approx(10.0 / 4.0, rel=1e-12)
    assert covariance[2, 2] == pytest.approx(10.0 / 4.0 / np.sin(HALF_RAD) ** 2, rel=1e-12)
    half = covariance_of_noise(PAIR, np.ones(2), np.array([1.0, 9.0]), probability=0.5)
    np.testing.assert_allclose(half, 2.0 * covariance, rtol=1e-12)


def test_an_unknown_velocity_turns_the_attitude_as_it_turns_the_stars():
    rng, velocity = np.random.default_rng(5), np.array([0.4, -0.7, 0.2])
    v = field_directions(rng, 30, 1.1)
    solved = solve_wahba(aberrated(v, velocity), v)
    np.testing.assert_allclose(attitude_of_velocity(velocity), solved.rotation.as_rotvec(), atol=5e-8)
    assert np.abs(attitude_of_velocity(velocity)).max() > 2e-6
