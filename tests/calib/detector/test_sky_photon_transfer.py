"""Photon transfer on the sky: gain, noise and pattern that were put in come back within their errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from transfer_pulls import assert_unit_pulls

from calib.detector.sky_photon_transfer import (
    lognormal_dark,
    pattern_third_moment,
    sky_blocks,
    sky_photon_transfer,
    tail_fraction,
)

GAIN_E_PER_DN, READ_E, DSNU_DN, PRNU = 2.5, 4.0, 1.2, 0.01


def sky_frames(levels_dn, *, shape=(256, 320), black_dn=0.0, seed=3):
    """Flat skies with a slope, read out by a detector of known noise, rounded to whole DN."""
    rng = np.random.default_rng(seed)
    offset, response = DSNU_DN * rng.standard_normal(shape), 1.0 + PRNU * rng.standard_normal(shape)
    slope = np.linspace(0.9, 1.1, shape[1])
    frames = []
    for level in levels_dn:
        electrons = rng.poisson(level * GAIN_E_PER_DN * slope * response) + READ_E * rng.standard_normal(shape)
        frames.append(np.rint(electrons / GAIN_E_PER_DN + offset + black_dn))
    return frames


def measured(frames, **options):
    nothing = np.zeros(frames[0].shape, bool)
    return sky_photon_transfer([sky_blocks(dn, nothing) for dn in frames], lowest_dn=100.0, **options)


def test_noise_of_the_sky_gives_the_gain_and_the_pattern_within_their_errors():
    found = measured(sky_frames(np.geomspace(120.0, 900.0, 6)))
    for value, error, true in (
        (found.gain_e_per_dn, found.gain_error_e_per_dn, GAIN_E_PER_DN),
        (found.prnu, found.prnu_error, PRNU),
        (found.dsnu_dn, found.dsnu_error_dn, DSNU_DN),
    ):
        assert abs(value - true) < 4.0 * error
        assert error < 0.15 * true
    low, high = found.read_noise_e
    assert low < high  # the black level is not told by such frames
    assert abs(low**2 - READ_E**2) < 4.0 * found.intercept_error_dn2 * GAIN_E_PER_DN**2
    np.testing.assert_allclose(found.correlation, 0.0, atol=0.01)
    assert found.averaging[0] == pytest.approx(1.0, abs=0.03)


def test_a_pattern_left_in_and_a_stated_black_level():
    levels = np.geomspace(120.0, 900.0, 6)
    with_pattern = measured(sky_frames(levels)).gain_e_per_dn
    alone = [measured([one]).gain_e_per_dn for one in sky_frames(levels)[-2:]]  # one frame tells no pattern
    assert min(alone) < 0.97 * with_pattern or max(alone) < 0.97 * with_pattern
    found = measured(sky_frames(np.geomspace(120.0, 900.0, 5), black_dn=60.0), black_level_dn=60.0)
    assert found.read_noise_e[0] == found.read_noise_e[1]
    assert abs(found.gain_e_per_dn - GAIN_E_PER_DN) < 4.0 * found.gain_error_e_per_dn


def test_warm_pixels_show_in_the_third_moment_of_the_pattern():
    """A gamma distribution of shape 4 [sigma 3 DN, third moment 27 DN^3 times skewness 1] in noise of 7 DN."""
    rng = np.random.default_rng(8)
    warm = 1.5 * (rng.gamma(4.0, size=(512, 512)) - 4.0)
    frames = [200.0 + warm + 7.0 * rng.standard_normal((512, 512)) for _ in range(6)]
    nothing = np.zeros((512, 512), bool)
    for images, true in ((frames, 27.0), ([one - warm for one in frames], 0.0)):
        moment, error = pattern_third_moment([sky_blocks(dn, nothing) for dn in images])
        assert abs(moment - true) < 4.0 * error + 0.15 * true  # clipping takes a part of the tail
        assert error < 2.0


@pytest.mark.parametrize("nights", [25, pytest.param(250, marks=pytest.mark.slow)])
def test_gain_and_pattern_have_the_errors_that_they_state(nights):
    """Small frames, 20 blocks each: what clipping and the subtracted surface take from the pattern is given back."""
    pulls = []
    for seed in range(nights):
        found = measured(sky_frames(np.geomspace(120.0, 900.0, 4), shape=(128, 160), seed=100 + seed))
        pulls.append(
            (
                (found.gain_e_per_dn - GAIN_E_PER_DN) / found.gain_error_e_per_dn,
                (found.prnu - PRNU) / found.prnu_error,
                (found.dsnu_dn - DSNU_DN) / found.dsnu_error_dn,
                (found.intercept_dn2 - (READ_E / GAIN_E_PER_DN) ** 2 - 1 / 12) / found.intercept_error_dn2,
            )
        )
    assert_unit_pulls(pulls)


def test_warm_pixels_are_a_lognormal_current_and_tails_are_counted():
    """Lognormal of mean 4 and spread 3 DN: skewness c^3 + 3 c of c = 3/4; normal noise has 0.27 % beyond 3 sigma."""
    skewness = 0.75**3 + 3.0 * 0.75
    noise = measured(sky_frames(np.geomspace(120.0, 900.0, 4), shape=(128, 160)))
    warm = replace(noise, dsnu_dn=3.0 / 0.95, third_moment_dn3=27.0 * skewness)
    dsnu, mean, spread = lognormal_dark(warm)
    assert (mean, spread) == pytest.approx((4.0, 3.0))
    assert dsnu**2 + spread**2 == pytest.approx(warm.dsnu_dn**2)
    assert lognormal_dark(replace(warm, third_moment_dn3=0.0)) == (warm.dsnu_dn, 0.0, 0.0)
    white = sky_blocks(100.0 + 5.0 * np.random.default_rng(1).standard_normal((256, 256)), np.zeros((256, 256), bool))
    # of a normal distribution truncated at 3.5 sigma, whose deviation is 0.99: 0.0026; 170 pixels, 4 / sqrt(170)
    assert tail_fraction([white]) == pytest.approx(0.0026, rel=0.3)
