"""Gain, read noise, PRNU and DSNU of drawn flats and darks: right, and as well known as they say."""

from __future__ import annotations

import numpy as np
import pytest
from transfer_pulls import assert_unit_pulls, transfer_pulls

from calib.detector.fixed_pattern import fixed_pattern, flat_response, reduced_variance
from calib.detector.mean_frame import mean_frame
from calib.detector.photon_transfer import block_gain, flat_photon_transfer
from calib.records import NoiseModel

GAIN = 0.25


def camera(rng, shape, *, read_e=12.0, spread=0.0, dsnu_e=0.0, prnu=0.0, tilt=0.0):
    """A function that draws n frames of a level [e-]: rounded, read noise lognormal, patterns normal."""
    read = read_e * np.exp(spread * rng.standard_normal(shape) - spread**2)  # RMS read_e
    offset, response = dsnu_e * rng.standard_normal(shape), 1.0 + prnu * rng.standard_normal(shape)
    response = response * np.linspace(1.0 - tilt, 1.0 + tilt, shape[1])

    def frames(level_e, count, flicker=0.0):
        lamp = 1.0 + flicker * rng.standard_normal((count, 1, 1))
        electrons = rng.poisson(level_e * lamp * response) + offset + read * rng.standard_normal((count, *shape))
        return mean_frame(np.rint(200.3 + GAIN * electrons))

    return frames


def test_mean_and_variance_of_frames_are_those_of_numpy():
    dn = np.random.default_rng(1).integers(0, 4000, (7, 20, 30)).astype(np.uint16)
    found = mean_frame(iter(dn))
    np.testing.assert_allclose(found.mean_dn, dn.mean(0), rtol=1e-14)
    np.testing.assert_allclose(found.variance_dn2, dn.var(0, ddof=1), rtol=1e-12)
    np.testing.assert_allclose(found.error_dn, dn.std(0, ddof=1) / np.sqrt(7), rtol=1e-12)
    np.testing.assert_allclose(found.level_dn, dn.mean((1, 2)))
    assert np.isnan(mean_frame(dn[:1]).variance_dn2).all()


@pytest.mark.parametrize(
    ("level_e", "flats", "darks", "options"),
    [
        ((200.0,), 20, 2, {}),  # the darks have most of the error: 2.08 of the flats' alone
        ((200.0,), 4, 4, {"spread": 0.3}),
        ((500.0, 4000.0, 20000.0), 4, 10, {"prnu": 0.01, "dsnu_e": 20.0}),
    ],
)
def test_gain_and_read_noise_of_flats_have_the_errors_that_they_state(level_e, flats, darks, options):
    rng, pulls = np.random.default_rng(5), []
    for _ in range(400):
        frames = camera(rng, (24, 24), **options)
        found = flat_photon_transfer([frames(level, flats, 0.01) for level in level_e], frames(0.0, darks))
        pulls.append(transfer_pulls(found, GAIN, 12.0))
    assert_unit_pulls(pulls)


def test_gain_in_blocks_has_the_error_that_it_states():
    rng = np.random.default_rng(6)
    frames = camera(rng, (200, 250), prnu=0.01)
    gain, error = block_gain(frames(5000.0, 5), frames(0.0, 3), block_px=16)
    pulls = ((gain - GAIN) / error)[::16, ::16]
    assert np.unique(gain).size == pulls.size == 13 * 16
    assert_unit_pulls(pulls.ravel())
    single = block_gain(frames(5000.0, 2), frames(0.0, 2), block_px=1)[1]
    assert np.isnan(single).all()


@pytest.mark.parametrize(("tilt", "smooth_px"), [(0.0, None), (0.1, 7)])
def test_prnu_and_dsnu_have_the_errors_that_they_state(tilt, smooth_px):
    """Of light that is uneven by 10 % too, if a running mean is subtracted."""
    rng, pulls = np.random.default_rng(7), []
    for _ in range(150):
        frames = camera(rng, (40, 40), prnu=0.01, dsnu_e=6.0, tilt=tilt)
        flat, dark = frames(10000.0, 8), frames(0.0, 8)
        found = fixed_pattern(flat, dark, flat_photon_transfer([flat], dark), smooth_px=smooth_px)
        pulls.append(((found.prnu - 0.01) / found.prnu_error, (found.dsnu_e - 6.0) / found.dsnu_error_e))
    assert_unit_pulls(pulls)


def test_response_of_a_flat_scatters_as_its_error_says_and_dead_pixels_are_left_out():
    """45 e-, read noise 3 e- and 10 e- per DN: rounding counts as much as reading; no pattern."""
    rng, gain = np.random.default_rng(4), 0.1

    def mean(light_e, count):
        electrons = rng.poisson(light_e, (count, 200, 200)) + rng.normal(0.0, 3.0, (count, 200, 200))
        return mean_frame(np.rint(20.3 + gain * electrons)).mean_dn / gain

    electrons = mean(45.0, 4) - mean(0.0, 2)
    electrons[3, 4] = 5.0
    usable = np.ones(electrons.shape, bool)
    usable[7, 8] = False
    found = flat_response(electrons, usable, floor_e2=9.0 + 1.0 / (12.0 * gain**2), flats=4, darks=2)
    assert np.argwhere(found.unusable).tolist() == [[3, 4], [7, 8]]
    assert found.response[3, 4] == 1.0
    assert found.response[~found.unusable].mean() == pytest.approx(1.0)
    assert found.response.std() == pytest.approx(found.noise, rel=0.03)
    assert found.pixel_to_pixel == pytest.approx(found.noise, rel=0.1)  # by a median of few numbers
    assert found.level_e == pytest.approx(45.0, abs=2.0)


def test_a_stated_variance_stands_for_a_second_dark():
    frames = camera(np.random.default_rng(1), (8, 8))
    flat, single = frames(1000.0, 4), frames(0.0, 1)
    stated = flat_photon_transfer([flat], single, dark_variance_dn2=(12.0 * GAIN) ** 2 + 1 / 12)
    assert stated.read_noise_e * stated.gain_dn_per_e == pytest.approx(12.0 * GAIN)


def test_variance_of_reduced_frames_is_that_of_drawn_ones():
    """Dark charge of 300 e-, response 0.8, ten darks; of the fixed part, means of 400 frames with a hundred means."""
    rng, noise = np.random.default_rng(3), NoiseModel(read_noise_e=5.0)
    response, error = np.full(3, 0.8), np.full(3, 0.01)
    light = np.array([0.0, 500.0, 4000.0])
    frames = (rng.poisson(light * response + 300.0, (4000, 3)) + rng.normal(0.0, 5.0, (4000, 3)) - 300.0) / response
    known = {"dark_e": np.full(3, 300.0), "dark_frames": 10, "response": response, "response_error": error}
    temporal, fixed = reduced_variance(light, light, noise, **known, prnu=0.005)
    np.testing.assert_allclose(frames.var(0), temporal, rtol=4.0 * np.sqrt(2 / 4000))
    darks = rng.poisson(300.0, (4000, 10)).mean(1) + rng.normal(0.0, 5.0, (4000, 10)).mean(1)
    pattern = light[:, None] * (0.005 * rng.standard_normal(4000) + 0.01 / 0.8 * rng.standard_normal(4000))
    np.testing.assert_allclose((pattern + darks / 0.8).var(1), fixed, rtol=4.0 * np.sqrt(2 / 4000))
    plain, nothing = reduced_variance(light, light, noise)
    np.testing.assert_allclose(plain, light + 25.0)
    np.testing.assert_array_equal(nothing, 0.0)
