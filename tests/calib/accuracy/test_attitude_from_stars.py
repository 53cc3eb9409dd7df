"""Attitudes solved from drawn stars against the rule total / sqrt(N), closed forms and what the estimator states."""

import numpy as np
import pytest

from calib.accuracy import attitude_from_stars
from calib.accuracy.error_budget import TERMS, ErrorTerm, combine

HALF_FIELD = np.array([0.055, 0.027])


def errors(random, chromatic=0.0, distortion=0.0):
    return attitude_from_stars.DirectionErrors(
        random_arcsec=np.broadcast_to(random, 2),
        chromatic_arcsec=np.full(2, chromatic),
        distortion_arcsec=np.full(2, distortion),
    )


def simulate(of_star, stars, seed, trials=600, half_field=HALF_FIELD, **options):
    rng = np.random.default_rng(seed)
    found = attitude_from_stars.simulate_attitudes(of_star, half_field, stars, trials=trials, rng=rng, **options)
    assert found.failed == 0
    return found


def test_attitude_of_independent_errors_is_what_the_estimator_states():
    of_star = errors(1.5)
    for stars in (10, 40):
        found = simulate(of_star, stars, 3)
        np.testing.assert_allclose(found.arcsec, found.stated_arcsec, rtol=5 * found.relative_error)
    # many stars all over the field: the rule holds for every axis, roll included
    np.testing.assert_allclose(
        found.arcsec, attitude_from_stars.attitude_rule_arcsec(of_star, HALF_FIELD, 40), rtol=0.18
    )


def test_unequal_errors_on_an_oblong_detector_by_hand():
    """Half width 1/20, half height 1/50 of the focal length; 3 and 1 arcsec; 60 stars, whose second moments are known.
    Stars apart along y turn the field by their errors along x, and the other way round."""
    of_star, half_field = errors(np.array([3.0, 1.0])), np.array([0.05, 0.02])
    xx, yy = half_field**2 / 3.0
    expected = np.array([3.0, 1.0, np.sqrt(9.0 * yy + 1.0 * xx) / (xx + yy)]) / np.sqrt(60.0)
    found = simulate(of_star, 60, 8, trials=300, half_field=half_field)
    np.testing.assert_allclose(attitude_from_stars.attitude_rule_arcsec(of_star, half_field, 60), expected, rtol=1e-9)
    np.testing.assert_allclose(found.arcsec, expected, rtol=0.03 + 4.0 * found.relative_error)
    np.testing.assert_allclose(found.over_expected, 1.0, atol=4.0 * found.relative_error)


def test_common_error_does_not_average():
    of_star = errors(0.0, 0.9)
    for stars in (10, 40):
        found = simulate(of_star, stars, 4, trials=300, correlation="common")
        np.testing.assert_allclose(found.arcsec[:2], 0.9, rtol=6 * found.relative_error)
        # a common shift turns, but does not roll
        assert found.arcsec[2] < 0.1 * attitude_from_stars.attitude_rule_arcsec(of_star, HALF_FIELD, stars)[2]


def test_attitude_of_a_measured_budget_is_solved():
    """Ten stars evenly all over the field: the rule, but for the roll that stars beside the middle bring in."""
    budget = combine({name: ErrorTerm(arcsec=np.ones(2)) for name in TERMS}, stars=10)
    np.testing.assert_allclose(attitude_from_stars.DirectionErrors.of(budget).total_arcsec, budget.total.arcsec)
    solved = attitude_from_stars.attitude_term(budget, HALF_FIELD, stars=10, trials=1000, rng=np.random.default_rng(7))
    ratio = solved.arcsec / (budget.total.arcsec / np.sqrt(10.0))
    np.testing.assert_allclose(ratio, 1.03, atol=0.04 + 4.0 / np.sqrt(2000.0))
    np.testing.assert_allclose(solved.uncertainty_arcsec, solved.arcsec / np.sqrt(2000.0))


def test_drawn_cubic_maps_have_unit_variance_over_the_field():
    """Mean square one over a field of 40 x 40 points; a map is a cubic without a constant."""
    side = (np.arange(40) + 0.5) / 20 - 1.0
    place = np.stack(np.meshgrid(side, side), axis=-1).reshape(1, -1, 2)
    maps = attitude_from_stars.smooth_maps(np.repeat(place, 400, axis=0), np.random.default_rng(4))
    assert maps.shape == (400, 1600, 2)
    # nine terms of equal weight: the mean square of a map is chi^2 of nine over nine
    assert (maps**2).mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 9 / 800) + 0.01)
    assert (maps**2).mean((1, 2)).std() == pytest.approx(np.sqrt(2.0 / 18), rel=0.15)
    assert np.abs(maps.mean(1)).max() < 0.05
    x, y = place[0].T
    cubic = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)
    left = maps[0] - cubic @ np.linalg.lstsq(cubic, maps[0], rcond=None)[0]
    assert np.abs(left).max() < 1e-9
