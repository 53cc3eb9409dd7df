"""Predicted errors of centroiders, against noise drawn on windows and against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from star_images import gaussian_epsf, noisy

from calib.measure.centroid_error import prediction
from calib.measure.centroiding.registry import get_centroider
from calib.measure.stamps import noiseless_stamps
from calib.records import NoiseModel
from render.records import EffectivePsf

NOISE = NoiseModel(read_noise_e=12.0)


def gaussian_psf(sigma_px):
    return gaussian_epsf(sigma_px, 8, 9)


@pytest.mark.parametrize("name", ["epsf", "cog"])
def test_noise_and_patterns_of_drawn_windows(name):
    """600 draws on 16 windows of two stars: a variance is known to sqrt(2 / (2 16 600)) = 1 %; four of that, 3 % for
    what is not linear at a signal-to-noise ratio of 30."""
    psf, rng, draws, window = gaussian_psf(0.7), np.random.default_rng(8), 600, 9
    flux = np.array([3000.0, 30000.0])
    predicted = prediction.predict_centroids(name, (psf,), flux, noise=NOISE, prnu=0.02, offset_e=8.0, window_px=window)
    unit = prediction.phase_windows((psf,), window)
    options = {"epsf": (psf,)} if name == "epsf" else {}
    centroider = get_centroider(name, **options)
    for k, value in enumerate(flux):
        light = value * unit.light
        count = len(light)
        stamps = noiseless_stamps(light, start_px=unit.position_px, psf_index=np.zeros(count, np.int64))
        copies = stamps.select(np.tile(np.arange(count), draws))
        light = copies.electrons
        drawn = {
            "noise_px": noisy(light, 12.0, rng),
            "pattern_px": light + np.hypot(0.02 * light, 8.0) * rng.standard_normal(light.shape),
        }
        for term, electrons in drawn.items():
            position = centroider.measure(replace(copies, electrons=electrons), NOISE).pixel_px
            scatter = float(np.sqrt(position.reshape(draws, count, 2).var(axis=0).mean()))
            assert getattr(predicted, term)[0, k] == pytest.approx(scatter, rel=0.05), (term, value)


def photon_limit(s2):
    return np.sqrt(s2 / 1e7)


def read_noise_limit(s2):
    return np.sqrt(8.0 * np.pi) * s2 * 1e3 / 1e2


@pytest.mark.parametrize(
    ("limit", "sigma", "flux", "read", "window"),
    [(photon_limit, 1.2, 1e7, 0.0, 15), (read_noise_limit, 2.0, 1e2, 1e3, 17)],
)
def test_noise_limits(limit, sigma, flux, read, window):
    """Variance s^2 of the pixel-integrated Gaussian: sigma^2 + 1/12. Photon noise alone: s / sqrt(F).
    Read noise alone: Fisher information F^2 / r^2 sum (dP/dx)^2 of a Gaussian, sigma_x = sqrt(8 pi) s^2 r / F."""
    noise = NoiseModel(read_noise_e=read)
    errors = prediction.predict_centroids("epsf", (gaussian_psf(sigma),), [flux], noise=noise, window_px=window)
    assert errors.noise_px[0, 0] == pytest.approx(limit(sigma**2 + 1.0 / 12.0), rel=0.02)
    assert errors.bound_px[0, 0] == pytest.approx(errors.noise_px[0, 0], rel=1e-6)


def test_bound_between_its_knots_is_that_of_the_star():
    """Photons alone, sigma 1.5 px: the same at every phase; nearest PSF by the distance from the middle."""
    noise, electrons = NoiseModel(read_noise_e=1e-3), (1e3, 1e5)
    psfs = [gaussian_psf(1.5), gaussian_psf(1.0)]
    bound = prediction.centroid_bound(
        psfs, [0.0, 500.0], noise=noise, background_e=0.0, window_px=15, electrons=electrons
    )
    place = np.random.default_rng(3).uniform(0, 100, (50, 2))
    for radius_px, sigma in ((7.0, 1.5), (400.0, 1.0)):
        found = bound.at(np.full(50, 4e4), place, np.full(50, radius_px))
        np.testing.assert_allclose(found, np.sqrt(sigma**2 + 1 / 12) / 200, rtol=0.02)


def test_wrong_psf_is_what_the_fit_makes_of_it():
    """A fit psf a symmetric PSF on stars with a tail to the right: its bias, noiseless, for each phase and axis."""
    psf, wide = gaussian_psf(0.8), gaussian_psf(1.1)
    tail = np.roll(wide.values, 4, axis=1) * 0.15 + psf.values * 0.85
    offset = (np.arange(len(tail)) - len(tail) // 2) / 8.0
    centre = float((tail.sum(0) @ offset) / tail.sum())
    shifted = np.stack([np.interp(offset + centre, offset, row) for row in tail])  # about its own mean again
    true = EffectivePsf(values=shifted, oversampling=8)
    window, flux = 11, 20000.0
    bias = prediction.fit_bias("epsf", (psf,), (true,), flux, noise=NOISE, window_px=window)
    assert bias.shape == (1, 16, 2)
    predicted = prediction.psf_mismatch((psf,), (true,), [flux], noise=NOISE, window_px=window)[0, 0]
    assert predicted == pytest.approx(np.sqrt((bias**2).mean()), rel=0.25)  # first order
    assert prediction.psf_mismatch((psf,), (psf,), [flux], noise=NOISE, window_px=window)[0, 0] == 0.0


def test_a_fit_is_off_by_as_much_as_its_psf():
    """PSFs of the stars 0.03 px right of where the fit has them."""
    psf = gaussian_psf(0.8)
    offset = (np.arange(len(psf.values)) - len(psf.values) // 2) / 8.0
    moved = np.stack([np.interp(offset - 0.03, offset, row) for row in psf.values])
    bias = prediction.fit_bias("epsf", (psf, psf), (EffectivePsf(values=moved, oversampling=8), psf), 2e4, noise=NOISE)
    np.testing.assert_allclose(bias[0].mean(0), [0.03, 0.0], atol=1e-3)
    np.testing.assert_allclose(bias[1], 0.0, atol=1e-5)
