"""Zodiacal light against other tables of the same review, symmetries, and the Sun's own magnitude."""

import math

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import ICRS, BarycentricMeanEcliptic, SkyCoord

from optics.light.magnitudes import synthetic_magnitude
from optics.light.spectrum import PHOTON_J_NM, TabulatedSed
from render.sky.zodiacal import ecliptic_from_icrs, zodiacal_radiance

ARCSEC2_SR = math.radians(1 / 3600) ** 2
# Leinert et al. 1998, table 16: the same sky in S10 (stars of V = 10 and the Sun's colour per square degree)
S10 = {
    (0, 15): 2450, (15, 0): 9000, (15, 30): 410, (30, 0): 1940, (30, 30): 285, (45, 15): 345, (60, 0): 395,
    (60, 60): 81, (90, 0): 202, (90, 45): 81, (120, 10): 138, (135, 0): 140, (150, 75): 56, (165, 25): 110,
    (180, 0): 180, (180, 60): 65,
}  # fmt: skip


def looking(longitude_deg, latitude_deg):
    """Unit vectors (n, 3) along icrs, longitude from the Sun of `OBSERVER`."""
    a, b = np.radians(longitude_deg), np.radians(latitude_deg)
    v = np.stack(np.broadcast_arrays(np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)), axis=-1)
    return np.atleast_2d(v) @ ecliptic_from_icrs()


OBSERVER = -looking(0, 0)[0]


def test_the_ecliptic_is_that_of_astropy():
    """Its mean ecliptic of J2000, turned by the frame bias of 0.02 arcsec that is left out here."""
    there = SkyCoord([17, 100, 245] * units.deg, [-60, 5, 40] * units.deg, frame=BarycentricMeanEcliptic)
    icrs = there.transform_to(ICRS()).cartesian.xyz.value
    assert ecliptic_from_icrs() @ icrs == pytest.approx(there.cartesian.xyz.value, abs=1.5e-7)


def test_two_tables_of_the_review_agree():
    longitude, latitude = np.array(list(S10), float).T
    got = zodiacal_radiance(looking(longitude, latitude), from_sun_au=OBSERVER, wavelength_nm=[500.0])[:, 0]
    watt = got * PHOTON_J_NM / 500.0 * 1e9  # W m^-2 sr^-1 um^-1
    # 1 S10 is 1.28e-8 at 500 nm (table 2); both tables are rounded, to 1 % at worst
    np.testing.assert_allclose(watt / 1.28e-8, list(S10.values()), rtol=0.011)


def test_spectrum_at_the_reference_point():
    """Table 19, two digits, smoothed: where the Sun has no deep lines it is met within 5 %."""
    wave = np.array([500.0, 700.0, 1000.0, 1200.0])
    got = zodiacal_radiance(looking(90, 0), from_sun_au=OBSERVER, wavelength_nm=wave)[0] * PHOTON_J_NM / wave * 1e9
    np.testing.assert_allclose(got, [2.6e-6, 2.0e-6, 1.2e-6, 8.1e-7], rtol=0.05)


def test_surface_brightness_of_the_pole():
    wave = np.arange(290.0, 1300.0, 5.0)
    radiance = zodiacal_radiance(looking(0, 90), from_sun_au=OBSERVER, wavelength_nm=wave)[0]
    sky = TabulatedSed(name="sky", source="test", wavelength_nm=wave, value=radiance * ARCSEC2_SR, quantity="photon")
    # 60 S10 is 10 - 2.5 log 60 + 2.5 log 3600^2 = 23.33 mag/arcsec^2; the light is redder than the Sun by some 3 %
    assert synthetic_magnitude(sky) == pytest.approx(23.33, abs=0.06)


def test_symmetry_smoothness_and_distance():
    rng = np.random.default_rng(1)
    longitude, latitude = rng.uniform(20, 180, 200), rng.uniform(-90, 90, 200)

    def at(a, b, place=OBSERVER):
        return zodiacal_radiance(looking(a, b), from_sun_au=place, wavelength_nm=[600.0])[:, 0]

    np.testing.assert_allclose(at(longitude, latitude), at(-longitude, latitude), rtol=1e-10)
    np.testing.assert_allclose(at(longitude, latitude), at(longitude, -latitude), rtol=1e-10)
    # 0.1 deg on: no jump anywhere, not at the pole either (the steepest slope of the table is 16 % per deg)
    np.testing.assert_allclose(at(longitude, latitude), at(longitude + 0.1, latitude * 0.999), rtol=0.025)
    assert at(70, 10, 0.5 * OBSERVER)[0] / at(70, 10)[0] == pytest.approx(4.92, abs=0.01)
