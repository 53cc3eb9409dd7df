"""One call from an image to its stars, against drawn stars of known place and flux."""

from dataclasses import replace

import numpy as np
import pytest
from star_images import frame_of, noisy, star_field

from calib import detect, sensor_image
from calib.flags import StarFlag, has_flag
from calib.measure.find import find_stamps, find_stars
from calib.records import NoiseModel

SHAPE = (160, 220)
READ_NOISE_E, SKY_E = 5.0, 40.0
GAIN_DN_PER_E, OFFSET_DN = 0.25, 64.0


@pytest.fixture(scope="module")
def place():
    """Twenty-four stars 30 px apart at sub-pixel places of their own."""
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(20.0, 210.0, 30.0), np.arange(20.0, 140.0, 30.0))
    return (x + rng.uniform(-0.5, 0.5, x.shape)).ravel(), (y + rng.uniform(-0.5, 0.5, y.shape)).ravel()


@pytest.fixture(scope="module")
def electrons(place):
    """20000 e- each, sigma 1 px, on an even sky, with shot and read noise."""
    return noisy(SKY_E + star_field(*place, 2e4, 1.0, SHAPE), READ_NOISE_E, np.random.default_rng(6))


def rms_error_px(stars, place):
    """RMS over both axes, after checking that every star was found once."""
    distance = np.hypot(stars.x_px[:, None] - place[0], stars.y_px[:, None] - place[1])
    nearest = distance.argmin(axis=1)
    assert sorted(nearest) == list(range(len(place[0])))
    error = np.concatenate([stars.x_px - place[0][nearest], stars.y_px - place[1][nearest]])
    return float(np.sqrt(np.mean(error**2)))


@pytest.mark.parametrize("name", ["cog", "tcog", "windowed", "gaussian"])
def test_every_star_of_a_plain_array_is_found_and_centroided(electrons, place, name):
    """Nothing but the array: noise and offset come from its background. sqrt(20000) electrons on sigma 1 px: 0.007 px
    at best; nothing here needs more than three times that."""
    stars = find_stars(electrons, name)
    assert np.all(stars.flags == 0)
    assert rms_error_px(stars, place) < 0.021
    assert np.median(stars.flux_e) == pytest.approx(2e4, rel=0.02)


def test_the_likelihood_fit_of_a_plain_array_reaches_the_photon_bound(electrons, place):
    """var(x) = sigma^2 / N for N photons on a Gaussian, a little more for sky and read noise; 48 coordinates."""
    error = rms_error_px(find_stars(electrons, "gaussian", sigma_px=1.0), place)
    bound = 1.0 / np.sqrt(2e4)
    assert (1.0 - 4.0 / np.sqrt(2 * 48)) * bound < error < (1.2 + 4.0 / np.sqrt(2 * 48)) * bound


def test_digital_numbers_a_frame_and_an_image_give_the_same_stars(electrons, place):
    dn = np.clip(np.rint(electrons * GAIN_DN_PER_E + OFFSET_DN), 0, 65535).astype(np.uint16)
    frame = frame_of(dn, gain_dn_per_e=GAIN_DN_PER_E, offset_dn=OFFSET_DN, read_noise_e=READ_NOISE_E)
    image = sensor_image(dn, gain_dn_per_e=GAIN_DN_PER_E, offset_dn=OFFSET_DN, read_noise_e=READ_NOISE_E)
    one, two, plain = (find_stars(each, "gaussian") for each in (frame, image, dn))
    assert np.array_equal(one.x_px, two.x_px)
    assert np.array_equal(one.covariance, two.covariance)
    assert plain.flux_e == pytest.approx(GAIN_DN_PER_E * one.flux_e, rel=0.01), "unknown gain counts as 1 DN/e-"
    assert rms_error_px(one, place) < 0.021
    assert rms_error_px(plain, place) < 0.021


def test_windows_start_at_the_detections_and_hand_their_flags_on(electrons):
    electrons = np.array(electrons)
    electrons[80, 100] += 5000.0  # a hot pixel
    image = replace(sensor_image(electrons), noise=NoiseModel(read_noise_e=READ_NOISE_E))
    found, stamps = detect(image), find_stamps(image, size_px=9)
    assert stamps.electrons.shape == (len(found), 9, 9)
    assert np.array_equal(stamps.start_px, np.column_stack([found.x_px, found.y_px]))
    spike = has_flag(stamps.flags, StarFlag.SPIKE)
    assert np.round(stamps.start_px[spike]).tolist() == [[100.0, 80.0]]


def test_the_brightest_come_first_and_few_on_demand():
    light = star_field([30.0, 80.0, 130.0], [70.0] * 3, [2e3, 2e4, 6e3], 1.0, SHAPE)
    image = noisy(SKY_E + light, READ_NOISE_E, np.random.default_rng(1))
    assert np.round(find_stars(image).x_px).tolist() == [80.0, 130.0, 30.0]
    assert np.round(find_stars(image, max_stars=2).x_px).tolist() == [80.0, 130.0]


def test_pixels_that_a_masked_array_hides_are_not_measured(electrons, place):
    """A saturated column, hidden by the mask, must give no detection and be no part of any star."""
    spoiled = np.array(electrons)
    spoiled[:, 100] = 6e4
    hidden = np.zeros(spoiled.shape, bool)
    hidden[:, 100] = True
    stars = find_stars(np.ma.array(spoiled, mask=hidden))
    assert len(stars) == len(place[0])
    assert not np.any(stars.flux_e > 3e4)
