"""Predicted errors of centroiders, against noise drawn on windows and against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from calib.measure.centroid_error.prediction import (
    centroid_bound,
    fit_bias,
    phase_windows,
    predict_centroids,
    psf_mismatch,
)
from calib.measure.centroiding.registry import get_centroider
from calib.measure.stamps import noiseless_stamps
from calib.records import NoiseModel
from render.records import EffectivePsf

NOISE = NoiseModel(read_noise_e=12.0)


def gaussian_psf(sigma_px, oversampling=8, half_px=9):
    """A Gaussian integrated over pixels by the error function."""
    from scipy.special import ndtr

    offset = np.arange(-half_px * oversampling, half_px * oversampling + 1) / oversampling
    share = ndtr((offset + 0.5) / sigma_px) - ndtr((offset - 0.5) / sigma_px)
    return EffectivePsf(values=np.outer(share, share), oversampling=oversampling)


@pytest.mark.parametrize("name", ["epsf", "cog"])
def test_noise_and_patterns_of_drawn_windows(name):
    """600 draws on 16 windows of two stars: a variance is known to sqrt(2 / (2 16 600)) = 1 %; four of that, 3 % for
    what is not linear at a signal-to-noise ratio of 30."""
    psf, rng, draws, window = gaussian_psf(0.7), np.random.default_rng(8), 600, 9
    flux = np.array([3000.0, 30000.0])
    predicted = predict_centroids(name, (psf,), flux, noise=NOISE, prnu=0.02, offset_e=8.0, window_px=window)
    unit = phase_windows((psf,), window)
    options = {"epsf": (psf,)} if name == "epsf" else {}
    centroider = get_centroider(name, **options)
    for k, value in enumerate(flux):
        light = value * unit.light
        count = len(light)
        stamps = noiseless_stamps(light, start_px=unit.position_px, psf_index=np.zeros(count, np.int64))
        many = stamps.select(np.tile(np.arange(count), draws))
        noisy = {
            "noise_px": rng.poisson(many.electrons) + 12.0 * rng.standard_normal(many.electrons.shape),
            "pattern_px": many.electrons
            + np.hypot(0.02 * many.electrons, 8.0) * rng.standard_normal(many.electrons.shape),
        }
        for what, electrons in noisy.items():
            table = centroider.measure(replace(many, electrons=electrons), NOISE)
            place = np.stack([table.x_px, table.y_px], axis=-1).reshape(draws, count, 2)
            seen = float(np.sqrt(place.var(axis=0).mean()))
            assert getattr(predicted, what)[0, k] == pytest.approx(seen, rel=0.05), (what, value)


def test_bright_limit_is_the_spread_over_the_root_of_the_electrons():
    """Photon noise alone: sigma / sqrt(F) of the pixel-integrated Gaussian, whose variance grows by 1/12 (to 2 %)."""
    sigma, flux = 1.2, 1e7
    found = predict_centroids("epsf", (gaussian_psf(sigma),), [flux], noise=NoiseModel(read_noise_e=0.0), window_px=15)
    assert found.bound_px[0, 0] == pytest.approx(np.sqrt((sigma**2 + 1.0 / 12.0) / flux), rel=0.02)


def test_faint_limit_is_the_read_noise():
    """Read noise alone: Fisher information F^2 / r^2 sum (dP/dx)^2 of a Gaussian, sigma_x = sqrt(8 pi) s^2 r / F."""
    sigma, flux, read = 2.0, 100.0, 1000.0
    found = predict_centroids("epsf", (gaussian_psf(sigma),), [flux], noise=NoiseModel(read_noise_e=read), window_px=17)
    spread = sigma**2 + 1.0 / 12.0
    assert found.noise_px[0, 0] == pytest.approx(np.sqrt(8.0 * np.pi) * spread * read / flux, rel=0.02)


def test_bound_between_its_knots_is_that_of_the_star():
    """Photons alone, sigma 1.5 px: the same at every phase; nearest PSF by the distance from the middle."""
    noise, electrons = NoiseModel(read_noise_e=1e-3), (1e3, 1e5)
    psfs = [gaussian_psf(1.5), gaussian_psf(1.0)]
    bound = centroid_bound(psfs, [0.0, 500.0], noise=noise, background_e=0.0, window_px=15, electrons=electrons)
    place = np.random.default_rng(3).uniform(0, 100, (50, 2))
    for radius_px, sigma in ((7.0, 1.5), (400.0, 1.0)):
        found = bound.at(np.full(50, 4e4), place, np.full(50, radius_px))
        np.testing.assert_allclose(found, np.sqrt(sigma**2 + 1 / 12) / 200, rtol=0.02)


def test_no_method_beats_the_bound_and_thresholds_are_refused():
    psf = gaussian_psf(0.8)
    for name in ("windowed", "cog"):
        found = predict_centroids(name, (psf,), [300.0, 3e4], noise=NOISE, window_px=11)
        assert (found.noise_px > found.bound_px).all()
        assert (found.phase_px > 0.0).all()


def test_wrong_psf_is_what_the_fit_makes_of_it():
    """A fit told a symmetric PSF on stars with a tail to the right: its bias, noiseless, for each phase and axis."""
    told, wide = gaussian_psf(0.8), gaussian_psf(1.1)
    tail = np.roll(wide.values, 4, axis=1) * 0.15 + told.values * 0.85
    offset = (np.arange(len(tail)) - len(tail) // 2) / 8.0
    centre = float((tail.sum(0) @ offset) / tail.sum())
    shifted = np.stack([np.interp(offset + centre, offset, row) for row in tail])  # about its own mean again
    true = EffectivePsf(values=shifted, oversampling=8)
    window, flux = 11, 20000.0
    bias = fit_bias("epsf", (told,), (true,), flux, noise=NOISE, window_px=window)
    assert bias.shape == (1, 16, 2)
    predicted = psf_mismatch((told,), (true,), [flux], noise=NOISE, window_px=window)[0, 0]
    assert predicted == pytest.approx(np.sqrt((bias**2).mean()), rel=0.25)  # first order
    assert psf_mismatch((told,), (told,), [flux], noise=NOISE, window_px=window)[0, 0] == 0.0


def test_a_fit_is_off_by_as_much_as_its_psf():
    """PSFs of the stars 0.03 px right of where the fit has them."""
    told = gaussian_psf(0.8)
    offset = (np.arange(len(told.values)) - len(told.values) // 2) / 8.0
    moved = np.stack([np.interp(offset - 0.03, offset, row) for row in told.values])
    bias = fit_bias("epsf", (told, told), (EffectivePsf(values=moved, oversampling=8), told), 2e4, noise=NOISE)
    np.testing.assert_allclose(bias[0].mean(0), [0.03, 0.0], atol=1e-3)
    np.testing.assert_allclose(bias[1], 0.0, atol=1e-5)
