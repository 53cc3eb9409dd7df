"""Noise carried through centroiders, against closed forms and numerical bounds."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.measure.centroid import get_centroider
from calib.measure.epsf import draw_epsf
from calib.measure.gaussian import draw_gaussian
from experiments.laboratory.bench.point_noise import (
    ExpectedWindows,
    _bent,
    bound_px,
    drawn_positions,
    influence,
    sampled_px,
)
from experiments.laboratory.bench.readout.windows import window_corners
from experiments.laboratory.temporal_error import _followed_px
from render.records import EffectivePsf

SIZE, FLUX = 11, 5000.0


def gaussian_psf(sigma_px):
    """A Gaussian as the pixels see it, on eight samples per pixel."""
    half = 7 * 8
    offset = np.arange(-half, half + 1) / 8.0
    grid = np.stack(np.meshgrid(-offset, -offset), axis=-1).reshape(-1, 2)
    values = draw_gaussian(grid[:, 0], grid[:, 1], sigma_px, (1, 1)).reshape(len(offset), len(offset))
    return EffectivePsf(values=values, oversampling=8)


@pytest.fixture(scope="module")
def psf():
    return gaussian_psf(0.6)


def windows_of(psf):
    """Three stars at different phases."""
    place = np.array([[5.0, 5.0], [5.3, 4.8], [4.6, 5.45]])
    light = FLUX * np.maximum(draw_epsf(psf, place[:, 0], place[:, 1], (SIZE, SIZE)), 0.0)
    return ExpectedWindows(
        place_px=place + 100.0,
        corner_px=np.full((3, 2), 100),
        light_e=light,
        valid=np.ones(light.shape, bool),
        psf=(psf,),
        psf_index=np.zeros(3, np.int64),
    )


@pytest.fixture(scope="module")
def windows(psf):
    return windows_of(psf)


@pytest.fixture(scope="module")
def noise(star_camera):
    return star_camera.pixel_noise()


def test_the_data_sheet_in_numbers(noise):
    assert noise.read_e2 == pytest.approx(13.0**2, rel=0.03)
    assert noise.dark_e == pytest.approx(125.0 * 2 ** (-25.0 / 6.5) * 0.1)
    assert noise.rounding_e2 == pytest.approx((1.0 / 0.3) ** 2 / 12.0)
    assert noise.offset_e == pytest.approx(12.0, rel=1e-3)


@pytest.mark.parametrize("size", [11, 12, 13])
def test_windows_lie_around_their_places(size):
    place = np.array([[100.3, 60.6], [41.5, 80.49]])
    corner = window_corners(place, size, (200, 100), where="here", advice="none")
    assert np.abs(corner + (size - 1) / 2 - place).max() <= (0.5 if size % 2 else 1.0)


def test_a_fit_follows_a_step_of_the_image_whole(star_camera, windows, psf):
    followed = _followed_px(get_centroider("epsf", epsf=[psf]), star_camera, windows, 0.1)
    np.testing.assert_allclose(followed, 0.1, rtol=2e-3)


def test_the_influence_of_a_centre_of_gravity_is_its_lever(star_camera, windows):
    gain = influence(get_centroider("cog", half_width_px=None), star_camera, windows)
    for star in range(3):
        total = windows.light_e[star].sum()
        lever = (np.arange(SIZE) + 100.0 - gain.position_px[star, 0]) / total
        found = gain.gain_px_per_e[star, 0]
        np.testing.assert_allclose(found, np.tile(lever, (SIZE, 1)), rtol=3e-3, atol=1e-9)


@pytest.mark.parametrize("sigma_px", [0.6, 2.5])  # the windows hold all of the light, 93 % of it
def test_an_epsf_fit_told_the_true_noise_reaches_the_bound(star_camera, noise, sigma_px):
    psf = gaussian_psf(sigma_px)
    windows, told = windows_of(psf), replace(noise, read_e2=13.0**2, dark_e=0.0)
    gain = influence(get_centroider("epsf", epsf=psf), star_camera, windows)
    np.testing.assert_allclose(gain.sigma_px(told.temporal_e2(windows.light_e)), bound_px(windows, told), rtol=5e-3)


@pytest.mark.parametrize(("method", "dark_e"), [("cog", None), ("gaussian", None), ("cog", 400.0)])
def test_drawn_noise_scatters_as_the_influence_says(star_camera, windows, noise, method, dark_e):
    """As the data sheet has it, where read noise rules, and warm: most of the noise is that of the dark charge."""
    draws = 3000
    noise = noise if dark_e is None else replace(noise, dark_e=dark_e)
    centroider = get_centroider(method)
    drawn = sampled_px(centroider, star_camera, windows, noise, draws=draws, rng=np.random.default_rng(4))
    linear = influence(centroider, star_camera, windows).sigma_px(noise.temporal_e2(windows.light_e))
    np.testing.assert_allclose(drawn, linear, rtol=4.0 / np.sqrt(2.0 * draws) + 0.01)


def test_chips_differ_less_when_their_pixels_do(star_camera, windows, noise):
    gain = influence(get_centroider("cog"), star_camera, windows)
    even = replace(noise, read_e4=0.0, dark_pattern_e=0.0)
    assert gain.device_sigma_px(windows.light_e, even).max() == 0.0
    # 49 pixels with levers of equal weight: a fifth of the variance each, over some 20 pixels that count
    ratio = gain.device_sigma_px(windows.light_e, noise) / gain.sigma_px(noise.temporal_e2(windows.light_e))
    assert np.all((ratio > 0.005) & (ratio < 0.05))


def test_mirrored_draws_have_no_noise_in_their_mean(star_camera, windows, noise):
    """A centre of gravity is nearly linear: noise of opposite signs cancels to the square of its relative size."""
    centroider, rng = get_centroider("cog", half_width_px=None), np.random.default_rng(4)
    given = (centroider, star_camera, windows, noise)
    both = drawn_positions(*given, draws=200, rng=rng, mirrored=True)
    assert both.shape == (200, 3, 2)
    middle = influence(centroider, star_camera, windows).position_px
    single = both.std(0, ddof=1)
    pairs = both.reshape(100, 2, 3, 2).mean(1) - middle
    assert np.sqrt((pairs**2).mean(0)).max() < 0.2 * single.min()
    np.testing.assert_allclose(both[::2].std(0, ddof=1), single, rtol=4.0 / np.sqrt(200))
    free = drawn_positions(*given, draws=200, rng=rng)
    np.testing.assert_allclose(free.std(0, ddof=1), single, rtol=6.0 / np.sqrt(400))


def test_a_converter_that_bends_takes_its_share_of_the_light():
    """A quadratic of -2 % and a cubic of 1 % at full well."""
    detector = SimpleNamespace(full_well_e=10000.0, nonlinearity=(-0.02, 0.01))
    light = np.array([0.0, 2500.0, 10000.0])
    np.testing.assert_allclose(_bent(light, detector), [0.0, 2500.0 * (1 - 0.005 + 0.000625), 9900.0])
