"""The estimators against the Cramer-Rao bound: variance, bias, and honesty of the covariance."""

from dataclasses import replace

import numpy as np
import pytest
from star_images import gaussian_epsf, gaussian_stars, noisy, sampled_stars, stamps_of

from calib.measure.centroid_error.cramer_rao_bound import cramer_rao, flux_for_snr
from calib.measure.centroiding.registry import get_centroider
from calib.records import NoiseModel

N = 8000
BACKGROUND_E = 2.0
SIGMA_PX = 0.7


def sample(snr, read_noise_e=5.0, seed=0):
    """N noisy stars of one flux at random phases, and the root mean bound on x and y at those phases."""
    noise = NoiseModel(read_noise_e=read_noise_e)
    rng = np.random.default_rng([seed, int(snr)])
    flux = flux_for_snr(gaussian_stars([5.0], [5.0], SIGMA_PX)[0], snr, BACKGROUND_E, noise)
    x, y, stamps = sampled_stars(lambda x, y: flux * gaussian_stars(x, y, SIGMA_PX), rng, N, BACKGROUND_E, read_noise_e)

    def model(p):
        return p[2] * gaussian_stars(p[:1], p[1:2], SIGMA_PX)[0] + BACKGROUND_E

    bounds = np.array([np.diagonal(cramer_rao(model, [x[i], y[i], flux], noise)) for i in range(100)]).mean(axis=0)
    return stamps, noise, x, y, flux, np.sqrt(bounds)


@pytest.mark.parametrize("snr", [20.0, 500.0])
@pytest.mark.parametrize("name", ["epsf", "gaussian"])
def test_likelihood_reaches_the_bound_without_bias(name, snr):
    """RMS/bound at least 1 and at most 1.03 within 4 statistical errors 1/sqrt(4 N), x and y pooled.
    Bias below 3.3 standard errors; pulls 1 within 4/sqrt(2 N)."""
    stamps, noise, x, y, flux, bound = sample(snr)
    options = {"epsf": gaussian_epsf(SIGMA_PX)} if name == "epsf" else {}
    table = get_centroider(name, **options).measure(stamps, noise)
    assert np.all(table.flags == 0)
    error_x, error_y = table.x_px - x, table.y_px - y
    ratio = np.sqrt(np.mean(error_x**2 + error_y**2) / (bound[0] ** 2 + bound[1] ** 2))
    reach = 4.0 / np.sqrt(4.0 * N)
    assert 1.0 - reach < ratio < 1.03 + reach
    for error, sigma in ((error_x, table.sigma_x_px), (error_y, table.sigma_y_px)):
        assert abs(error.mean()) < 3.3 * bound[0] / np.sqrt(N)
        assert (error / sigma).std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * N))
    if name == "epsf":
        flux_error = table.flux_e - flux
        # second order: the fitted place follows the noise upwards, a flux bias of about sigma_F / SNR
        assert abs(flux_error.mean()) < 3.3 * bound[2] / np.sqrt(N) + 2.0 * bound[2] / snr
        assert flux_error.std() == pytest.approx(bound[2], rel=4.0 / np.sqrt(2.0 * N) + 0.01)
        assert table.chi2.mean() == pytest.approx(1.0, abs=0.02)


def test_photon_noise_alone():
    """Without read noise the wings expect much less than one electron; the fit must stay finite and unbiased."""
    stamps, noise, x, _, flux, bound = sample(50.0, read_noise_e=0.0, seed=4)
    table = get_centroider("epsf", epsf=gaussian_epsf(SIGMA_PX)).measure(stamps, noise)
    error = table.x_px - x
    assert np.all(table.flags == 0)
    assert error.std() == pytest.approx(bound[0], rel=0.03 + 4.0 / np.sqrt(2.0 * N))
    assert abs(error.mean()) < 3.3 * bound[0] / np.sqrt(N)
    assert table.flux_e.mean() == pytest.approx(flux, rel=1e-3 + 3.3 / 50.0 / np.sqrt(N))


def test_wrong_background_is_repaired_by_fitting_it():
    stamps, noise, x, _, flux, _ = sample(100.0, seed=5)
    wrong = replace(stamps, background_e=np.full(N, BACKGROUND_E + 8.0))
    options = {"epsf": gaussian_epsf(SIGMA_PX)}
    trusting = get_centroider("epsf", **options).measure(wrong, noise)
    fitting = get_centroider("epsf", fit_background=True, **options).measure(wrong, noise)
    standard_error = fitting.sigma_flux_e.mean() / np.sqrt(N)
    assert abs(fitting.flux_e.mean() - flux) < 4 * standard_error
    assert abs(trusting.flux_e.mean() - flux) > 20 * standard_error
    assert fitting.background_e.mean() == pytest.approx(BACKGROUND_E, abs=0.1)
    assert (fitting.x_px - x).std() == pytest.approx(fitting.sigma_x_px.mean(), rel=4.0 / np.sqrt(2.0 * N))


@pytest.mark.parametrize(("name", "options"), [("cog", {}), ("tcog", {}), ("windowed", {"sigma_px": 1.2})])
def test_moments_know_their_noise_and_are_above_the_bound(name, options):
    """SNR 30: noise dominates the S-curve; the covariance is first order, hence 10 % (selection by threshold counts
    as fixed)."""
    stamps, noise, x, _, _, bound = sample(30.0, seed=6)
    table = get_centroider(name, **options).measure(stamps, noise)
    error = table.x_px - x
    assert error.std() > bound[0] * (1.0 - 4.0 / np.sqrt(2.0 * N))
    assert (error / table.sigma_x_px).std() == pytest.approx(1.0, abs=0.1)
    assert abs(error.mean()) < 3.3 * error.std() / np.sqrt(N)


@pytest.mark.parametrize(("name", "options"), [("cog", {"half_width_px": None}), ("windowed", {"sigma_px": 1.5})])
def test_covariance_of_moments_is_the_scatter_of_an_oblique_star(name, options):
    """Light of 2.0 by 0.8 px, its axes turned by 0.5 rad against the pixels: x scatters otherwise than y, and with it.
    N = 4000 frames of 20 000 e-, photon and read noise; each element of the covariance matrix within 5 standard errors.
    """
    frames, size = 4000, 21
    y, x = np.mgrid[:size, :size] - 10.2
    along, across = np.cos(0.5) * x + np.sin(0.5) * y, -np.sin(0.5) * x + np.cos(0.5) * y
    light = np.exp(-0.5 * ((along / 2.0) ** 2 + (across / 0.8) ** 2))
    light *= 20_000 / light.sum()
    electrons = noisy(np.broadcast_to(light, (frames, size, size)), 1.0, np.random.default_rng(8))
    place = np.full(frames, 10.2)
    table = get_centroider(name, **options).measure(stamps_of(electrons, place, place), NoiseModel(read_noise_e=1.0))
    found = np.cov(np.stack([table.x_px, table.y_px]))
    stated = table.covariance[:, :2, :2].mean(axis=0)
    error = np.sqrt((np.outer(np.diag(stated), np.diag(stated)) + stated**2) / frames)
    assert np.all(np.abs(found - stated) < 5 * error)
    # axes exchanged or taken as independent would lie outside
    assert abs(found[0, 0] - found[1, 1]) > 10 * error[0, 0]
    assert abs(found[0, 1]) > 10 * error[0, 1]
