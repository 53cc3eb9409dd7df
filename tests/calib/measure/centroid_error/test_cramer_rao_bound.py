import numpy as np
import pytest
from star_images import gaussian_epsf, gaussian_stars

from calib.measure.centroid_error import cramer_rao_bound
from calib.measure.centroiding.gaussian import GaussianModel
from calib.measure.epsf.bspline import EpsfBank, EpsfModel
from calib.records import NoiseModel


@pytest.mark.parametrize(("sigma", "published"), [(0.5, 0.60), (0.7, 0.80), (1.0, 1.1)])
def test_published_bound_for_gaussians(noise, sigma, published):
    """SCIENCE: sigma_x is about 0.60 / 0.80 / 1.1 px over SNR; two digits are given, so 2 % is what they can mean."""
    unit = gaussian_stars([5.0], [5.0], sigma)[0]
    flux = cramer_rao_bound.flux_for_snr(unit, 100.0, 2.0, noise)

    def model(p):
        return p[2] * gaussian_stars(p[:1], p[1:2], sigma)[0] + 2.0

    bounds = []
    for phase in np.linspace(0, 0.5, 6):
        covariance = cramer_rao_bound.cramer_rao(model, [5.0 + phase, 5.0, flux], noise)
        bounds.append(np.sqrt(covariance[0, 0]) * 100.0)
    assert np.mean(bounds) == pytest.approx(published, rel=0.02)


def test_limits_of_signal_to_noise():
    """Of a matched filter: the root of the electrons by photons alone, the norm of the light over loud read noise."""
    unit = gaussian_stars([5.0], [5.0], 0.7)[0]
    dark, loud = NoiseModel(read_noise_e=0.0), NoiseModel(read_noise_e=1e4)
    assert cramer_rao_bound.matched_snr(unit, 1e6, 0.0, dark) == pytest.approx(1000.0, rel=1e-4)
    assert cramer_rao_bound.flux_for_snr(unit, 100.0, 0.0, dark) == pytest.approx(1e4, rel=1e-3)
    by_reading = cramer_rao_bound.matched_snr(unit, 100.0, 0.0, loud)
    assert by_reading == pytest.approx(100.0 * np.linalg.norm(unit) / 1e4, rel=1e-6)


@pytest.mark.parametrize("kind", ["gaussian", "gaussian fixed", "epsf"])
def test_analytic_information_equals_finite_differences(noise, kind):
    x, y, flux, sigma = 5.23, 4.81, 3000.0, 0.8
    if kind == "epsf":
        model, theta = EpsfModel(EpsfBank([gaussian_epsf(sigma)], (11, 11)), np.zeros(1, int)), [x, y, flux]
    elif kind == "gaussian":
        model, theta = GaussianModel((11, 11)), [x, y, flux, np.log(sigma), np.log(0.9)]
    else:
        model, theta = GaussianModel((11, 11), sigma), [x, y, flux]
    signal, jacobian = model.evaluate(np.array([theta]), np.arange(1))
    analytic = np.linalg.inv(cramer_rao_bound.fisher_information(jacobian[0], signal[0] + 2.0, noise))

    def image(p):
        return model.evaluate(p[None], np.arange(1))[0] + 2.0

    numeric = cramer_rao_bound.cramer_rao(image, theta, noise)
    scale = np.sqrt(np.diagonal(analytic))
    assert np.abs((numeric - analytic) / np.outer(scale, scale)).max() < 1e-6


@pytest.mark.parametrize("read_noise", [1.0, 2.0, 3.0])
def test_exact_law_at_vanishing_light(read_noise):
    """Telling 0 from 1 electron: information exp(1/r^2) - 1 (chi-square divergence of two shifted normals)."""
    expected = read_noise**2 * (np.exp(1.0 / read_noise**2) - 1.0)
    assert cramer_rao_bound.poisson_normal_gain(np.array([1e-4]), read_noise)[0] == pytest.approx(expected, rel=1e-3)


def test_exact_law_is_never_poorer_and_hardly_richer_for_a_star_of_snr_20():
    """The shifted Poisson law that the estimators use loses less than 0.2 % (read noise 1.5 to 5 e-)."""
    for read_noise in (1.5, 3.0, 5.0):
        noise = NoiseModel(read_noise_e=read_noise)
        unit = gaussian_stars([5.2], [5.0], 0.7)[0]
        flux = cramer_rao_bound.flux_for_snr(unit, 20.0, 0.5, noise)

        def model(p):
            return p[2] * gaussian_stars(p[:1], p[1:2], 0.7)[0] + 0.5

        plain = cramer_rao_bound.cramer_rao(model, [5.2, 5.0, flux], noise)
        exact = cramer_rao_bound.cramer_rao(model, [5.2, 5.0, flux], noise, exact=True)
        ratio = np.sqrt(plain[0, 0] / exact[0, 0])
        assert 1.0 <= ratio < 1.002


def test_optimal_snr_of_bright_and_faint_stars():
    """Photon noise alone for bright stars; background noise in the area for faint ones."""
    assert cramer_rao_bound.flux_snr(np.array([1e8]), np.array([5.0]), noise_e2=100.0)[0] == pytest.approx(
        1e4, rel=1e-3
    )
    faint = cramer_rao_bound.flux_snr(np.array([1e-3, 0.0]), np.array([5.0, 5.0]), noise_e2=100.0)
    np.testing.assert_allclose(faint, [1e-3 / np.sqrt(500.0), 0.0], rtol=1e-4)
