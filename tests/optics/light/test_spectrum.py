"""Spectra: photon counts of black bodies against radiation laws and astropy, tables in and out of other libraries."""

import numpy as np
import pytest
from astropy import units
from astropy.modeling.models import BlackBody

from optics.light.spectrum import PHOTON_J_NM, Blackbody, Sed, TabulatedSed


@pytest.mark.parametrize("temperature_k", [300.0, 3000.0, 9600.0, 30000.0])
def test_blackbody_agrees_with_astropy(temperature_k: float) -> None:
    wave = np.linspace(300.0, 1100.0, 41)
    model = BlackBody(
        temperature=temperature_k * units.K, scale=1.0 * units.erg / (units.s * units.cm**2 * units.AA * units.sr)
    )
    flux = (model(wave * units.nm) * np.pi * units.sr).to_value(
        units.photon / (units.s * units.mm**2 * units.nm), units.spectral_density(wave * units.nm)
    )
    assert Blackbody(temperature_k=temperature_k).photon_density(wave) == pytest.approx(flux, rel=1e-10)


def test_cold_body_in_the_blue_neither_overflows_nor_warns() -> None:
    assert 0.0 <= float(Blackbody(temperature_k=10.0).photon_density(300.0)) < 1e-300


def test_power_and_photon_tables_of_one_source_agree() -> None:
    wave = np.linspace(400.0, 900.0, 11)
    photons = Blackbody(temperature_k=4000.0).photon_density(wave)
    as_photons = TabulatedSed(name="p", source="test", wavelength_nm=wave, value=photons, quantity="photon")
    as_power = TabulatedSed(
        name="w", source="test", wavelength_nm=wave, value=photons * PHOTON_J_NM / wave, quantity="power"
    )
    assert as_power.photon_density(wave) == pytest.approx(as_photons.photon_density(wave), rel=1e-14)
    assert as_photons.photon_density(425.0) == pytest.approx(0.5 * (photons[0] + photons[1]), rel=1e-14)
    assert isinstance(as_power, Sed)
    assert isinstance(Blackbody(temperature_k=4000.0), Sed)
