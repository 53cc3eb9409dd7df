"""Spectral response from colour terms that a known response gives."""

from __future__ import annotations

import numpy as np
import pytest

from calib.photometry.spectral_response import (
    HIGHEST_TRANSMISSION,
    REFERENCE_K,
    WAVELENGTHS_NM,
    aperture_and_transmission,
    blackbody_photons,
    electrons_per_mm2,
    fit_response,
)
from calib.photometry.zero_point import COLOUR_KNOTS

EFFICIENCY = np.exp(-0.5 * ((WAVELENGTHS_NM - 600.0) / 150.0) ** 2)


def test_colour_terms_of_a_redder_camera_and_of_the_stated_one_come_back():
    """Terms by direct integration of photons over the true response; unknown ones are left out."""
    true = EFFICIENCY * np.exp(0.4 * (WAVELENGTHS_NM - 600.0) / 200.0)
    photons = np.stack([blackbody_photons(REFERENCE_K / colour) for colour in COLOUR_KNOTS])
    light = np.trapezoid(photons * true, WAVELENGTHS_NM, axis=1)
    terms = 2.5 * np.log10(light / light[3])
    terms[0] = np.nan
    fit = fit_response(terms, np.full(len(terms), 0.01), EFFICIENCY)
    np.testing.assert_allclose(fit.colour_mag[1:], terms[1:], atol=0.01)
    assert fit.relative[-8] / fit.relative[4] > EFFICIENCY[-8] / EFFICIENCY[4]
    light = electrons_per_mm2(EFFICIENCY, COLOUR_KNOTS)
    fit = fit_response(2.5 * np.log10(light / light[3]), np.full(7, 0.01), EFFICIENCY)
    np.testing.assert_allclose(fit.relative, EFFICIENCY, rtol=1e-4)


@pytest.mark.parametrize("aperture_mm", [None, 30.0, 1.0])
def test_aperture_and_transmission_give_the_zero_point(aperture_mm):
    fit = fit_response(np.zeros(7), np.full(7, 0.05), EFFICIENCY)
    aperture, transmission = aperture_and_transmission(15.0, fit, EFFICIENCY, exposure_s=0.5, aperture_mm=aperture_mm)
    electrons = electrons_per_mm2(transmission * EFFICIENCY, np.ones(1))[0] * 0.25 * np.pi * aperture**2 * 0.5
    assert 2.5 * np.log10(electrons) == pytest.approx(15.0)
    if aperture_mm == 30.0:
        assert aperture == 30.0
    else:  # the smallest aperture: a stated one that is too small is not believed
        assert transmission.max() == pytest.approx(HIGHEST_TRANSMISSION)
