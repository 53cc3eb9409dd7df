"""Magnitudes to photons, against published fluxes and passbands and another definition of the same zero point."""

from pathlib import Path

import numpy as np
import pytest

from optics.light.band import TopHat
from optics.light.magnitudes import band_integral, band_photon_rate, magnitude_system, photon_rate, synthetic_magnitude
from optics.light.spectrum import PHOTON_J_NM, Blackbody, TabulatedSed

VEGA_LIKE = Blackbody(temperature_k=9600.0)
EVERY_NM = np.arange(300.0, 1101.0)


def sed(wavelength_nm, value, quantity="photon") -> TabulatedSed:
    wave, value = np.asarray(wavelength_nm, dtype=float), np.asarray(value, dtype=float)
    return TabulatedSed(name="made", source="test", wavelength_nm=wave, value=value, quantity=quantity)


def flat(quantity: str, value: float) -> TabulatedSed:
    return sed([300.0, 1100.0], [value, value], quantity)


def test_zero_magnitude_fluxes_are_the_published_ones() -> None:
    """Their table A2: f_lambda = 363.1e-11 erg s^-1 cm^-2 A^-1 at V = 0, that is 3.631e-17 W mm^-2 nm^-1."""
    assert synthetic_magnitude(flat("power", 3.631e-17)) == pytest.approx(0.0, abs=2e-4)
    # montegriffo et al. 2023 (GaiaXPy, system GaiaDr3Vega): G = -2.5 log <f_lambda> - 26.4899, W m^-2 nm^-1
    watt_per_m2_nm = 10.0 ** (-0.4 * 26.4899)
    assert synthetic_magnitude(flat("power", watt_per_m2_nm * 1e-6), system="G") == pytest.approx(0.0, abs=3e-4)


def test_v_passband_agrees_with_the_photonic_one_of_bessell_and_murphy() -> None:
    """PASP 124, 140 (2012), table 1: response per photon = response to energy x wavelength, and revised in the red."""
    wave = np.arange(480.0, 601.0, 10.0)
    photonic = (0.033, 0.176, 0.485, 0.811, 0.986, 1.0, 0.955, 0.865, 0.750, 0.656, 0.545, 0.434, 0.334)
    ours = magnitude_system("V").band.transmission(wave) / wave * 530.0
    assert ours == pytest.approx(photonic, abs=0.021)
    assert ours[:9] == pytest.approx(photonic[:9], abs=0.002)


def test_gaia_counts_one_electron_at_its_zero_point() -> None:
    """G = 25.6874 is one photo-electron per second in 0.7278 m^2 behind the published transmission."""
    nodes, weight = np.polynomial.legendre.leggauss(2)
    wave = (np.arange(320.0, 1050.0)[:, None] + 0.5 + 0.5 * nodes).ravel()
    rate = photon_rate(VEGA_LIKE, 25.6873668671, wavelength_nm=wave, system="G")
    transmission = magnitude_system("G").band.transmission(wave)
    assert rate * transmission @ np.tile(0.5 * weight, 730) * 0.7278e6 == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(("kelvin", "gmv"), [(5772.0, -0.17), (9600.0, -0.03)])
def test_g_minus_v_of_known_colours(kelvin: float, gmv: float) -> None:
    """Sun: G - V = -0.14 to -0.19 (Casagrande and VandenBerg 2018; Gaia DR3 transformations); A0 V: about -0.02."""
    star = Blackbody(temperature_k=kelvin)
    difference = synthetic_magnitude(star, system="G") - synthetic_magnitude(star)
    assert difference == pytest.approx(gmv, abs=0.03)


@pytest.mark.parametrize("system", ["V", "G"])
def test_magnitude_and_flux_are_inverse(system: str) -> None:
    star = Blackbody(temperature_k=4500.0)
    sampled = sed(EVERY_NM, photon_rate(star, 6.5, wavelength_nm=EVERY_NM, system=system))
    assert synthetic_magnitude(sampled, system=system) == pytest.approx(6.5, abs=2e-6)  # 1 nm steps of the table


def test_band_rate_is_the_integral_of_the_rate() -> None:
    bands = [TopHat(centre_nm=500.0, width_nm=100.0), TopHat(centre_nm=800.0, width_nm=100.0, edge_nm=10.0)]
    rates = band_photon_rate(VEGA_LIKE, [0.0, 2.5], bands)
    assert rates.shape == (2, 2)
    assert rates[0] / rates[1] == pytest.approx([10.0, 10.0], rel=1e-12)
    wave = np.linspace(450.0, 550.0, 20001)
    trapezoid = np.trapezoid(photon_rate(VEGA_LIKE, 0.0, wavelength_nm=wave), wave)
    assert rates[0, 0] == pytest.approx(trapezoid, rel=1e-8)


def test_a_step_in_the_spectrum_is_met_exactly() -> None:
    """A table with a steep flank inside a band: breakpoints of the spectrum are breakpoints of the quadrature."""
    edge = sed([400.0, 612.3, 612.4, 800.0], [0.0, 0.0, 1.0, 1.0])
    total = band_integral(
        TopHat(centre_nm=600.0, width_nm=100.0), edge.photon_density, breakpoints_nm=edge.breakpoints_nm
    )
    assert total == pytest.approx(650.0 - 612.35, rel=1e-13)


@pytest.mark.reference
def test_calspec_vega() -> None:
    """CALSPEC alpha_lyr_mod_001 (as shipped by GalSim): V = 0.03 (Bessell et al. 1998), G = 0.023 (Riello et al. 2021).
    Absolute fluxes are known to about 1 %, and the Gaia figure belongs to the later model mod_002."""
    galsim = pytest.importorskip("galsim")
    table = np.loadtxt(Path(galsim.meta_data.share_dir) / "SEDs" / "vega.txt")
    vega = sed(table[:, 0], table[:, 1] * 1e-9, "power")  # erg s^-1 cm^-2 nm^-1 -> W mm^-2 nm^-1
    assert synthetic_magnitude(vega) == pytest.approx(0.03, abs=0.015)
    assert synthetic_magnitude(vega, system="G") == pytest.approx(0.023, abs=0.01)
    assert float(vega.photon_density(555.6)) * PHOTON_J_NM / 555.6 == pytest.approx(3.44e-17, rel=0.01)
