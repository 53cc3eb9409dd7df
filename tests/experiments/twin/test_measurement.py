"""What the sky tells of a camera, against numbers that were put in: PSF, light, zenith, refraction."""

from __future__ import annotations

from datetime import UTC, datetime

import erfa
import numpy as np
import pytest
from scipy.special import ndtr

from experiments.twin.camera import fit_refraction, fit_zenith, refracted, zenith_of
from experiments.twin.photometry import COLOUR_KNOTS, fit_photometry
from experiments.twin.psf import PsfModel, StarSample, fit_psf
from experiments.twin.twin import CLASS_K, PSF_WAVES_NM, WAVELENGTHS_NM, mixture
from optics.light.photometry import photon_rate
from optics.light.spectrum import Blackbody


@pytest.mark.slow
def test_psf_comes_back_from_stars_at_known_places():
    rng, count, size = np.random.default_rng(5), 320, 11
    truth = np.zeros(18)
    truth[:6] = [-1.8, -1.66, np.log(0.15), np.log(0.62), np.log(0.72), np.log(2.0)]
    truth[6:8], truth[12:15] = 0.2, [-0.05, 0.03, 0.08]
    model = PsfModel(size_px=(1024, 768), value=truth, covariance=np.zeros((18, 18)), chi2=1.0, stars=count)
    place = rng.uniform(20, [1003, 747], (count, 2))
    colour = rng.integers(0, 4, count)
    offset = rng.uniform(-0.5, 0.5, (count, 2))
    flux = 10.0 ** rng.uniform(3.2, 4.2, count)
    expected = 150.0 + flux[:, None, None] * model.draw(offset, place, colour, size)
    sample = StarSample(
        dn=rng.poisson(expected) - 150.0,
        level_dn=np.full(count, 150.0),
        offset_px=offset,
        place_px=place,
        colour=colour,
        frame=np.zeros(count, np.int64),
        star=np.arange(count),
        valid=np.ones((count, size, size), bool),
    )
    found = fit_psf(sample, (1024, 768), noise_dn2=(0.1, 1.0), width_px=0.65)
    assert found.chi2 == pytest.approx(1.0, abs=0.05)
    pull = (found.value - truth)[[3, 4, 6, 7, 12, 13, 14]] / np.sqrt(np.diag(found.covariance))[
        [3, 4, 6, 7, 12, 13, 14]
    ]
    assert np.abs(pull).max() < 4.0
    middle = np.array([[511.5, 383.5]])
    true_light = model.draw(np.zeros((1, 2)), middle, np.array([1]), 3).sum()
    assert found.draw(np.zeros((1, 2)), middle, np.array([1]), 3).sum() == pytest.approx(true_light, rel=0.01)


def test_light_gives_zero_points_colour_vignetting_and_extinction():
    rng, count, frames = np.random.default_rng(7), 900, 6
    magnitude, colour = rng.uniform(4.0, 7.5, count), rng.uniform(0.45, 1.85, count)
    u2, frame = rng.uniform(0.0, 1.0, count), rng.integers(0, frames, count)
    mass = np.array([1.1, 1.15, 1.2, 1.5, 1.55, 1.6])
    term = np.interp(colour, COLOUR_KNOTS, [0.1, 0.08, 0.05, 0.0, -0.07, -0.15, -0.4])
    brightness = 15.2 - 0.3 * mass[frame] + term - 0.4 * u2 - 0.08 * u2**2
    flux = 10.0 ** (-0.4 * (magnitude - brightness + 0.06 * rng.standard_normal(count)))
    error = 0.01 * flux
    found = fit_photometry(
        magnitude=magnitude,
        colour=colour,
        u2=u2,
        frame=frame,
        frames=frames,
        flux_e=flux,
        flux_error_e=error,
        airmass=mass,
    )
    assert found.extinction_mag is not None
    assert abs(found.extinction_mag.value - 0.3) < 4.0 * found.extinction_mag.uncertainty
    assert abs(found.zero_point_above_mag.value - 15.2) < 4.0 * found.zero_point_above_mag.uncertainty
    np.testing.assert_allclose(found.scatter_mag, 0.06, rtol=0.25)
    assert abs(found.loss_at(np.ones(1))[0] - 0.48) < 4.0 * found.loss_error_at(1.0)
    np.testing.assert_allclose(found.colour_mag, [0.1, 0.08, 0.05, 0.0, -0.07, -0.15, -0.4], atol=0.05)


def test_site_by_the_altitudes_of_the_boresights():
    taken = [datetime(2019, 7, 29, 20, 47, 26 + k, tzinfo=UTC) for k in range(6)]
    zenith = zenith_of(52.1, 4.4, taken)
    rng = np.random.default_rng(2)
    around = rng.standard_normal((6, 3))
    side = np.cross(zenith, around)
    side /= np.linalg.norm(side, axis=1)[:, None]
    altitude = np.radians([40, 40, 60, 60, 50, 45.0])
    boresight = np.sin(altitude)[:, None] * zenith + np.cos(altitude)[:, None] * side
    found = fit_zenith(boresight, np.degrees(altitude) - 1.2, taken)
    assert found is not None
    np.testing.assert_allclose([found.latitude_deg, found.longitude_deg, found.offset_deg], [52.1, 4.4, 1.2], atol=1e-6)
    assert fit_zenith(boresight[:3], np.degrees(altitude[:3]), taken[:3]) is None


def test_refraction_is_that_of_erfa():
    a, b = erfa.refco(1010.0, 10.0, 0.0, 0.6)
    for altitude in (35.0, 50.0, 70.0):
        z = np.radians(90.0 - altitude)
        direction = np.array([[np.sin(z), 0.0, np.cos(z)]])
        lifted = refracted(direction, np.array([0.0, 0.0, 1.0]), 58.3)
        angle = np.degrees(np.arccos(lifted[0] @ direction[0])) * 3600.0
        assert angle == pytest.approx(np.degrees(a * np.tan(z) + b * np.tan(z) ** 3) * 3600.0, rel=0.01)
        assert lifted[0, 2] > direction[0, 2]


def test_the_least_chi_square_tells_the_amplitude():
    value, error = fit_refraction([20.0, 58.0, 90.0], [1000 + 0.1 * (x - 45.0) ** 2 for x in (20.0, 58.0, 90.0)], 1000)
    assert value == pytest.approx(45.0)
    assert error == pytest.approx(np.sqrt(1.0 / 0.1))


def test_stars_of_each_colour_have_the_psf_of_their_class():
    """The table over wavelength, summed over a spectrum, against the class: two nodes hold four classes to 3 %."""
    value = np.zeros(18)
    value[:6] = [-2.2, -1.65, np.log(0.12), np.log(0.60), np.log(0.68), np.log(2.2)]
    value[12:15], value[15:18] = [-0.01, 0.015, 0.03], [0.35, -0.15, -0.3]
    covariance = np.diag([0.05] * 18) ** 2
    model = PsfModel(size_px=(801, 601), value=value, covariance=covariance, chi2=1.0, stars=400)
    response = np.exp(-0.5 * ((WAVELENGTHS_NM - 600.0) / 130.0) ** 2)
    table = mixture(model, 5e-3, response)
    middle = np.array([[400.0, 300.0]])
    row, column = len(table.y_mm) // 2, len(table.x_mm) // 2
    for one, temperature in enumerate(CLASS_K):
        star = Blackbody(temperature_k=temperature)
        rate = photon_rate(star, 0.0, wavelength_nm=WAVELENGTHS_NM, system="G") * response
        light = np.array([np.interp(WAVELENGTHS_NM, PSF_WAVES_NM, node) for node in np.eye(len(PSF_WAVES_NM))])
        seen = np.zeros((7, 7))
        for weight, at in zip(rate / rate.sum(), light.T, strict=True):
            share = at @ table.share[:, row, column]
            sigma = np.sqrt(at @ table.covariance_mm2[:, row, column, :, :2].reshape(len(at), -1)).reshape(3, 2) / 5e-3
            edge = np.arange(8) - 3.5
            for part, (sx, sy) in zip(share, sigma, strict=True):
                seen += weight * part * np.outer(np.diff(ndtr(edge / sy)), np.diff(ndtr(edge / sx)))
        expected = model.draw(np.zeros((1, 2)), middle, np.array([one]), 7)[0]
        np.testing.assert_allclose(seen[3, 3], expected[3, 3], rtol=0.03)
        np.testing.assert_allclose(seen[2:5, 2:5].sum(), expected[2:5, 2:5].sum(), rtol=0.015)
