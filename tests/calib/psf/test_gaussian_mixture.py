"""Mixture PSF: shape, fluxes and table over wavelength of drawn stars, against what they were drawn with."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from calib.photometry.spectral_response import WAVELENGTHS_NM
from calib.psf.chromatic_psf import CLASS_K, PSF_WAVES_NM, mixture_table
from calib.psf.gaussian_mixture import MixturePsf, StarWindows, colour_class, fit_psf, psf_fluxes
from optics import Blackbody, photon_rate

SIZE_PX, MIDDLE, ONE = (1024, 768), np.array([[511.5, 383.5]]), np.array([1])


def psf(core=-1.8, halo=-1.66, **changes):
    value = np.zeros(18)
    value[:6] = [core, halo, np.log(0.15), np.log(0.62), np.log(0.72), np.log(2.0)]
    for at, change in changes.items():
        value[int(at[1:])] = change
    return MixturePsf(size_px=SIZE_PX, value=value, covariance=np.diag([0.05] * 18) ** 2, chi2=1.0)


TRUE = psf(v6=0.2, v7=0.2, v12=-0.05, v13=0.03, v14=0.08)


def drawn(model, count, size, seed=5, gain=1.0, faintest=3.2):
    """Windows about stars of known positions and fluxes [DN] on a sky of 150 DN."""
    rng = np.random.default_rng(seed)
    position, colour = rng.uniform(20, [1003, 747], (count, 2)), rng.integers(0, 4, count)
    offset, flux = rng.uniform(-0.5, 0.5, (count, 2)), 10.0 ** rng.uniform(faintest, 4.2, count)
    expected = 150.0 + flux[:, None, None] * model.draw(offset, position, colour, size)
    windows = StarWindows(
        dn=rng.poisson(expected * gain) / gain - 150.0,
        level_dn=np.full(count, 150.0),
        offset_px=offset,
        position_px=position,
        colour=colour,
        frame=np.zeros(count, np.int64),
        star=np.arange(count),
        valid=np.ones((count, size, size), bool),
    )
    return windows, flux


def test_light_of_a_star_falls_into_its_pixels():
    """All of it in a wide window; by symmetry the same left and right of the middle; a shift moves the centroid."""
    stamp = TRUE.draw(np.zeros((1, 2)), MIDDLE, ONE, 41)[0]
    assert stamp.sum() == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(stamp, stamp[::-1, ::-1], atol=1e-15)
    moved = psf(core=-40.0).draw(np.array([[0.3, -0.2]]), MIDDLE, ONE, 41)[0]  # without its undersampled core
    row, column = np.indices(moved.shape) - 20
    assert [(moved * column).sum(), (moved * row).sum()] == pytest.approx([0.3, -0.2], abs=2e-4)
    fine = TRUE.effective(MIDDLE[0], 1)
    np.testing.assert_allclose(fine.values[24 - 8 : 24 + 9 : 4, 24 - 8 : 24 + 9 : 4], stamp[18:23, 18:23], rtol=1e-12)
    assert TRUE.central_width_px[0] == pytest.approx(0.67, rel=1e-9)
    np.testing.assert_array_equal(colour_class(np.array([3000.0, 5000.0, 6000.0, 9000.0])), np.arange(4))


def test_shape_of_stars_at_known_positions():
    windows, _ = drawn(TRUE, 160, 9)
    fit = fit_psf(windows, SIZE_PX, noise_dn2=(0.1, 1.0), width_px=0.65, start=TRUE.value)
    assert fit.chi2 == pytest.approx(1.0, abs=0.05)
    well = [3, 4, 6, 7, 12, 13, 14]
    pull = (fit.value - TRUE.value)[well] / np.sqrt(np.diag(fit.covariance))[well]
    assert np.abs(pull).max() < 4.0
    true = TRUE.draw(np.zeros((1, 2)), MIDDLE, ONE, 3).sum()
    assert fit.draw(np.zeros((1, 2)), MIDDLE, ONE, 3).sum() == pytest.approx(true, rel=0.01)
    assert 0.0 < fit.flux_error < 0.05


@pytest.mark.slow
def test_search_from_a_width_alone():
    windows, _ = drawn(TRUE, 320, 11)
    fit = fit_psf(windows, SIZE_PX, noise_dn2=(0.1, 1.0), width_px=0.65)
    true = TRUE.draw(np.zeros((1, 2)), MIDDLE, ONE, 3).sum()
    assert fit.draw(np.zeros((1, 2)), MIDDLE, ONE, 3).sum() == pytest.approx(true, rel=0.01)


def test_pulls_of_fluxes():
    """400 stars, gain 2.5 e-/DN: mean of the pulls within 4 / sqrt(400), RMS within 4 / sqrt(800) of 1."""
    windows, flux = drawn(TRUE, 400, 15, gain=2.5, faintest=2.0)
    measured = psf_fluxes(TRUE, windows, np.full(400, 150.0 / 2.5), 2.5)
    pull = (measured.flux_dn - flux) / measured.error_dn
    assert abs(pull.mean()) < 0.2
    assert np.sqrt((pull**2).mean()) == pytest.approx(1.0, abs=4.0 / np.sqrt(800.0))


def test_stars_of_each_colour_have_the_psf_of_their_class():
    """The table over wavelength, summed over a spectrum, against the class: two nodes hold four classes to 3 %."""
    model = psf(-2.2, -1.65, v12=-0.01, v13=0.015, v14=0.03, v15=0.35, v16=-0.15, v17=-0.3)
    response = np.exp(-0.5 * ((WAVELENGTHS_NM - 600.0) / 130.0) ** 2)
    table = mixture_table(model, 5e-3, response)
    row, column = len(table.y_mm) // 2, len(table.x_mm) // 2
    edge = np.arange(8) - 3.5
    hats = np.array([np.interp(WAVELENGTHS_NM, PSF_WAVES_NM, node) for node in np.eye(len(PSF_WAVES_NM))])
    for number, temperature in enumerate(CLASS_K):
        star = Blackbody(temperature_k=temperature)
        rate = photon_rate(star, 0.0, wavelength_nm=WAVELENGTHS_NM, system="G") * response
        image = np.zeros((7, 7))
        for weight, node in zip(rate / rate.sum(), hats.T, strict=True):
            fractions = node @ table.share[:, row, column]
            variance = node @ table.covariance_mm2[:, row, column, :, :2].reshape(len(node), -1)
            for part, (sx, sy) in zip(fractions, np.sqrt(variance).reshape(3, 2) / 5e-3, strict=True):
                image += weight * part * np.outer(np.diff(ndtr(edge / sy)), np.diff(ndtr(edge / sx)))
        expected = model.draw(np.zeros((1, 2)), MIDDLE, np.array([number]), 7)[0]
        np.testing.assert_allclose(image[3, 3], expected[3, 3], rtol=0.03)
        np.testing.assert_allclose(image[2:5, 2:5].sum(), expected[2:5, 2:5].sum(), rtol=0.015)
