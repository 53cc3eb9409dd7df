"""Light of stars from the table: against one spectrum at a time."""

import numpy as np
import pytest

from optics.light.band import TopHat, band_nodes
from optics.light.magnitudes import band_photon_rate, photon_rate
from optics.light.spectrum import Blackbody, TabulatedSed
from render.sky.star_light import star_light

BANDS = [TopHat(centre_nm=500, width_nm=100, edge_nm=10), TopHat(centre_nm=675, width_nm=450, edge_nm=20, name="full")]


@pytest.mark.parametrize("system", ["G", "V"])
def test_interpolation_is_below_1e_5(system):
    light = star_light(BANDS, nodes=4, magnitude_system=system)
    rng = np.random.default_rng(1)
    kelvin, magnitude = np.exp(rng.uniform(np.log(1200), np.log(50000), 60)), rng.uniform(-1, 10, 60)
    found = light.photon_rate(magnitude, kelvin)
    rule = band_nodes(BANDS, 4)
    for t, m, rate in zip(kelvin, magnitude, found, strict=True):
        body = Blackbody(temperature_k=t)
        exact = (
            photon_rate(body, m, wavelength_nm=rule.wavelength_nm, system=system) * rule.weight_nm * rule.transmission
        )
        np.testing.assert_allclose(rate, exact, rtol=1e-5)


@pytest.mark.parametrize("kelvin", [2500.0, 5800.0, 20000.0])
def test_nodes_add_up_to_the_light_of_the_band(kelvin):
    light = star_light(BANDS, nodes=5)
    exact = band_photon_rate(Blackbody(temperature_k=kelvin), 4.0, BANDS, system="G")
    # 5 nodes of the band's own Gauss rule: the full band of a cold star is the worst
    np.testing.assert_allclose(light.photon_rate([4.0], [kelvin])[0].sum(1), exact, rtol=2e-4)


def test_ones_own_spectra():
    # flat spectra whatever the temperature: 5 mag is the same at every T
    wave = np.array([300.0, 1200.0])
    flat = TabulatedSed(name="flat", source="made up", wavelength_nm=wave, value=np.ones(2), quantity="photon")
    light = star_light(BANDS, spectrum=lambda _: flat)
    rate = light.photon_rate([5.0, 5.0], [2000.0, 20000.0])
    np.testing.assert_allclose(rate[0], rate[1], rtol=1e-12)
