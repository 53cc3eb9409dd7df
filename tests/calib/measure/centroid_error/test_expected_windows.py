"""Noise carried through centroiders on expected windows, against closed forms and numerical bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from star_images import gaussian_epsf

from calib.measure.centroid_error.expected_windows import (
    bound_px,
    drawn_positions,
    expected_windows,
    followed_px,
    pattern_shifts_px,
    window_response,
)
from calib.measure.centroiding.registry import get_centroider
from calib.measure.stamps import noiseless_stamps
from calib.records import NoiseModel
from render.detector.noise import PixelNoise
from render.detector.spec import load_detector

SIZE, FLUX = 11, 5000.0
CHIP = load_detector("cmv4000")
STATED = NoiseModel.of(CHIP)
NOISE = PixelNoise.of(CHIP, temperature_c=0.0, exposure_s=0.1)


def windows_of(psf, **settings):
    """Three stars at different phases."""
    position = np.array([[105.0, 105.0], [105.3, 104.8], [104.6, 105.45]])
    return expected_windows([psf], position, FLUX, window_px=SIZE, corner_px=np.full((3, 2), 100), **settings)


@pytest.fixture(scope="module")
def psf():
    return gaussian_epsf(0.6, 8, 7)


@pytest.fixture(scope="module")
def windows(psf):
    return windows_of(psf)


def test_windows_lie_around_the_stars_and_leave_out_defects(psf):
    position, defect = np.array([[100.3, 60.6], [41.5, 80.49]]), np.zeros((100, 200), bool)
    defect[62, 97] = True
    windows = expected_windows([psf, psf], position, FLUX, window_px=SIZE, defect=defect)
    assert np.abs(windows.corner_px + (SIZE - 1) / 2 - position).max() <= 0.5
    assert np.argwhere(~windows.valid).tolist() == [[0, 62 - windows.corner_px[0, 1], 97 - windows.corner_px[0, 0]]]
    np.testing.assert_allclose(windows.light_e.sum((1, 2)), FLUX, rtol=1e-4)
    assert windows.psf_index.tolist() == [0, 1]


def test_a_converter_that_bends_takes_its_part_of_the_light(psf, windows):
    """A quadratic of -2 % and a cubic of 1 % at full well."""
    light = windows_of(psf, full_well_e=10000.0, nonlinearity=(-0.02, 0.01)).light_e
    part = windows.light_e / 10000.0
    np.testing.assert_allclose(light, windows.light_e - 200.0 * part**2 + 100.0 * part**3, rtol=1e-12)


def test_a_fit_follows_a_step_of_the_image_whole(windows, psf):
    centroider = get_centroider("epsf", epsf=[psf])
    np.testing.assert_allclose(followed_px(centroider, windows, STATED, 0.1), 0.1, rtol=2e-3)
    assert not followed_px(centroider, windows, STATED, 0.0).any()


def test_the_response_of_a_centre_of_gravity_is_its_lever(windows):
    response = window_response(get_centroider("cog", half_width_px=None), windows, STATED)
    for star in range(3):
        lever = (np.arange(SIZE) + 100.0 - response.position_px[star, 0]) / windows.light_e[star].sum()
        np.testing.assert_allclose(response.gain_px_per_e[star, 0], np.tile(lever, (SIZE, 1)), rtol=3e-3, atol=1e-9)


@pytest.mark.parametrize("sigma_px", [0.6, 2.5])  # the windows hold all of the light, 93 % of it
def test_an_epsf_fit_told_the_true_noise_reaches_the_bound(sigma_px):
    psf = gaussian_epsf(sigma_px, 8, 7)
    windows, true = windows_of(psf), replace(NOISE, read_e2=13.0**2, dark_e=0.0)
    response = window_response(get_centroider("epsf", epsf=psf), windows, STATED)
    sigma = response.sigma_px(true.temporal_e2(windows.light_e))
    np.testing.assert_allclose(sigma, bound_px(windows, true.floor_e2), rtol=5e-3)
    covariance = response.covariance_px2(true.temporal_e2(windows.light_e))
    np.testing.assert_allclose(np.diagonal(covariance, axis1=1, axis2=2), sigma**2, rtol=1e-12)


@pytest.mark.parametrize(("method", "dark_e"), [("cog", None), ("gaussian", None), ("cog", 400.0)])
def test_drawn_noise_scatters_as_the_response_says(windows, method, dark_e):
    """As the data sheet has it, where read noise rules, and warm: most of the noise is that of the dark charge."""
    draws = 3000
    noise = NOISE if dark_e is None else replace(NOISE, dark_e=dark_e)
    centroider = get_centroider(method)
    drawn = drawn_positions(centroider, windows, STATED, noise, draws=draws, rng=np.random.default_rng(4))
    linear = window_response(centroider, windows, STATED).sigma_px(noise.temporal_e2(windows.light_e))
    np.testing.assert_allclose(drawn.std(0, ddof=1), linear, rtol=4.0 / np.sqrt(2.0 * draws) + 0.01)


def test_chips_differ_less_when_their_pixels_do(windows):
    response = window_response(get_centroider("cog"), windows, STATED)
    even = replace(NOISE, read_e4=0.0, dark_pattern_e=0.0)
    assert response.device_sigma_px(windows.light_e, even).max() == 0.0
    # 49 pixels with levers of equal weight: a fifth of the variance each, over some 20 pixels that count
    ratio = response.device_sigma_px(windows.light_e, NOISE) / response.sigma_px(NOISE.temporal_e2(windows.light_e))
    assert np.all((ratio > 0.005) & (ratio < 0.05))


def test_mirrored_draws_have_no_noise_in_their_mean(windows):
    """A centre of gravity is nearly linear: noise of opposite signs cancels to the square of its relative size."""
    centroider, rng = get_centroider("cog", half_width_px=None), np.random.default_rng(4)
    given = (centroider, windows, STATED, NOISE)
    both = drawn_positions(*given, draws=200, rng=rng, mirrored=True)
    assert both.shape == (200, 3, 2)
    single = both.std(0, ddof=1)
    pairs = both.reshape(100, 2, 3, 2).mean(1) - window_response(centroider, windows, STATED).position_px
    assert np.sqrt((pairs**2).mean(0)).max() < 0.2 * single.min()
    np.testing.assert_allclose(both[::2].std(0, ddof=1), single, rtol=4.0 / np.sqrt(200))
    free = drawn_positions(*given, draws=200, rng=rng)
    np.testing.assert_allclose(free.std(0, ddof=1), single, rtol=6.0 / np.sqrt(400))


def test_patterns_shift_a_centre_of_gravity_as_its_closed_form_says():
    """Independent pixel errors: variance prnu^2 sum (x - c)^2 e^2 / (sum e)^2; none of both, and nothing moves."""
    light = np.random.default_rng(2).uniform(10.0, 20.0, (2, 13, 13))
    given = (get_centroider("cog", half_width_px=None), noiseless_stamps(light), STATED, light)
    still = pattern_shifts_px(*given, prnu=0.0, offset_e=0.0, draws=3, rng=np.random.default_rng(3))
    assert np.all(still == 0.0)
    moved = pattern_shifts_px(*given, prnu=0.01, offset_e=0.0, draws=48, rng=np.random.default_rng(3))
    index, total = np.arange(13), light.sum((1, 2))
    centre = (light.sum(1) * index).sum(1) / total
    variance = 1e-4 * ((index - centre[:, None]) ** 2 * (light**2).sum(1)).sum(1) / total**2
    # 48 patterns x 2 points: the variance is known to sqrt(2 / 96) = 14 %; four of them
    assert (moved[..., 0] ** 2).mean() == pytest.approx(variance.mean(), rel=0.58)
