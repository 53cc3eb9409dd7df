"""Moment centroids against photutils and sep on the same stamps."""

import numpy as np
import pytest
from star_images import gaussian_epsf, gaussian_stars, noisy, stamps_of

from calib.measure.centroiding.registry import get_centroider

pytestmark = pytest.mark.reference


@pytest.fixture
def stars():
    rng = np.random.default_rng(21)
    x, y = 5.0 + rng.uniform(-0.5, 0.5, (2, 100))
    electrons = noisy(2e4 * gaussian_stars(x, y, 0.9) + 10.0, 5.0, rng)
    return stamps_of(electrons, x, y, background_e=10.0)


@pytest.mark.slow
def test_centre_of_gravity_is_photutils_centroid_com(stars, noise):
    centroids = pytest.importorskip("photutils.centroids")
    table = get_centroider("cog", half_width_px=None).measure(stars, noise)
    theirs = np.array([centroids.centroid_com(e - 10.0) for e in stars.electrons])
    assert np.abs(table.x_px - theirs[:, 0]).max() < 1e-10
    assert np.abs(table.y_px - theirs[:, 1]).max() < 1e-10


@pytest.mark.parametrize("sigma", [0.9, 1.1])
def test_windowed_is_sep_winpos(stars, noise, sigma):
    """sep cuts the window at 4 sigma (weight 3e-4) and stops at steps of 2e-4 px: agreement to a few 1e-4 px."""
    sep = pytest.importorskip("sep")
    table = get_centroider("windowed", sigma_px=sigma).measure(stars, noise)
    theirs = []
    for electrons, start in zip(stars.electrons, stars.start_px, strict=True):
        padded = np.pad(electrons - 10.0, 10)
        x, y, _ = sep.winpos(padded, [start[0] + 10.0], [start[1] + 10.0], sigma)
        theirs.append((x[0] - 10.0, y[0] - 10.0))
    theirs = np.array(theirs)
    assert np.abs(table.x_px - theirs[:, 0]).max() < 1e-3
    assert np.abs(table.y_px - theirs[:, 1]).max() < 1e-3
    assert np.median(np.abs(table.x_px - theirs[:, 0])) < 2e-4


def test_likelihood_agrees_with_photutils_on_a_bright_star(stars, noise):
    """Same model, other optimiser and weights: positions differ by much less than their error."""
    psf = pytest.importorskip("photutils.psf")
    fitting = pytest.importorskip("astropy.modeling.fitting")
    epsf = gaussian_epsf(0.9)
    table = get_centroider("epsf", epsf=epsf).measure(stars, noise)
    rows, columns = np.mgrid[:11, :11]
    for i in range(10):
        model = psf.ImagePSF(np.array(epsf.values), oversampling=epsf.oversampling)
        model.flux, model.x_0, model.y_0 = 2e4, *stars.start_px[i]
        expected = np.maximum(
            stars.electrons[i] * 0 + 2e4 * gaussian_stars(*stars.start_px[i][:, None], 0.9)[0] + 10.0, 0
        )
        weights = 1.0 / np.sqrt(expected + 25.0)
        fitted = fitting.TRFLSQFitter()(model, columns, rows, stars.electrons[i] - 10.0, weights=weights)
        assert fitted.x_0.value == pytest.approx(table.x_px[i], abs=0.1 * table.sigma_x_px[i])
        assert fitted.flux.value == pytest.approx(table.flux_e[i], abs=0.1 * table.sigma_flux_e[i])
