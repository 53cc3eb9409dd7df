"""ACC18 eq. 1-2 on drawn centroids; small samples and intervals against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import gamma
from scipy.stats import chi2

from calib.accuracy.temporal import (
    expected_temporal_error,
    relative_scatter,
    scatter_interval,
    small_sample_factor,
    temporal_error,
)


def test_the_small_sample_factor_is_that_of_normal_samples():
    rng, runs = np.random.default_rng(0), 200_000
    assert small_sample_factor(5) == pytest.approx(rng.normal(size=(runs, 5)).std(axis=1, ddof=1).mean(), rel=3e-3)
    assert small_sample_factor(1000) == pytest.approx(1.0, abs=3e-4)


def test_three_times_the_mean_over_the_stars_and_how_well_it_is_known():
    """Drawn standard deviations of 5 stars in 20 frames: scatter over runs as stated; frames times stars behind it."""
    rng, true = np.random.default_rng(2), np.array([0.02, 0.05])
    drawn = [temporal_error((true * rng.standard_normal((20, 5, 2))).std(0, ddof=1), 4.0, 20) for _ in range(1000)]
    for axis in range(2):
        values = np.array([one.arcsec[axis] for one in drawn])
        assert values.mean() == pytest.approx(12.0 * true[axis] * (1.0 - 1.0 / (4 * 19)), rel=0.01)
        stated = np.sqrt(np.mean([one.uncertainty_arcsec[axis] ** 2 for one in drawn]))
        assert stated == pytest.approx(values.std(), rel=4.0 / np.sqrt(2000))
        assert drawn[0].n == 100


def test_intervals_of_standard_deviations_are_those_of_chi_square():
    """Ten frames of one star: nine degrees of freedom (scipy); no interval where the error is not known."""
    c4 = np.sqrt(2.0 / 9.0) * gamma(5.0) / gamma(4.5)
    low, high = scatter_interval(np.array([2.0, 2.0, 2.0]), np.array([np.sqrt(1 / c4**2 - 1), np.inf, 0.0]))
    np.testing.assert_allclose([low[0], high[0]], 2.0 * c4 * np.sqrt(9.0 / chi2.isf([0.025, 0.975], 9)), rtol=1e-6)
    assert np.isnan([*low[1:], *high[1:]]).all()


@pytest.mark.parametrize(("frames", "stars"), [(2, 1), (3, 5), (30, 9)])
def test_intervals_of_a_scatter_cover_it(frames, stars):
    """Mean of the stars' standard deviations, as of ACC18 eq. 2; exact for a single star."""
    rng, runs = np.random.default_rng(frames), 500
    true = rng.uniform(0.5, 1.5, stars)
    s = (true * rng.standard_normal((runs, frames, stars))).std(1, ddof=1)
    c4 = small_sample_factor(frames)
    error = np.sqrt((s**2).sum(1)) / stars * relative_scatter(frames)
    low, high = scatter_interval(s.mean(1) / c4, error / s.mean(1))
    covered = np.mean((low <= true.mean()) & (true.mean() <= high))
    assert 0.95 - 4 * np.sqrt(0.05 * 0.95 / runs) < covered
    if stars == 1:
        assert covered < 0.95 + 4 * np.sqrt(0.05 * 0.95 / runs)


def test_uncertainty_of_a_predicted_temporal_error_by_hand():
    """Two stars of 0.3 and 0.4 px, 9 draws, 5 frames: parts of draws, chips and the common motion in quadrature."""
    sigma, chip, common = (np.tile(np.reshape(v, (2, 1)), 2) for v in ([0.3, 0.4], [0.03, 0.04], [0.06, 0.08]))
    found = expected_temporal_error(sigma, 2.0, 5, chip_px=chip, common_px=common, draws=9)
    chips, draws = 0.05 / 2.0, 0.5 / 4.0 / 2.0
    motion = (0.06**2 / 0.6 + 0.08**2 / 0.8) / 2.0 * np.sqrt(0.5)
    np.testing.assert_allclose(found.arcsec, 6.0 * 0.35, rtol=1e-12)
    np.testing.assert_allclose(found.uncertainty_arcsec, 6.0 * np.sqrt(chips**2 + draws**2 + motion**2), rtol=1e-12)


def test_a_line_of_sight_that_moves_is_in_the_uncertainty_of_the_prediction():
    """All stars share it: the variance of N frames is known to sqrt(2 / (N - 1)) of its own however many stars."""
    size, common, none, frames = np.full((9, 2), 0.05), np.full((9, 2), 0.04), np.zeros((9, 2)), 30
    found = expected_temporal_error(size, 1.0, frames, chip_px=none, common_px=common)
    rng, runs = np.random.default_rng(5), 2000
    shared = (0.04 * rng.standard_normal((runs, frames))).var(1, ddof=1)
    drawn = np.sqrt(shared + 0.05**2 - 0.04**2).std()
    np.testing.assert_allclose(found.uncertainty_arcsec, 3.0 * drawn, rtol=4.0 / np.sqrt(2 * runs) + 0.02)
