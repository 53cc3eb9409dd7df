"""Temperatures from colours against other relations, other passbands and stars with measured ones."""

import numpy as np
import pytest
from fields import star_catalog

from optics.light.magnitudes import synthetic_magnitude
from optics.light.spectrum import Blackbody
from render.catalogue.temperature import colour_temperature, effective_temperature, star_temperature

# A. Mucciarelli, M. Bellazzini, D. Massari, A&A 653, A90 (2021), at solar metallicity: 5040/T = b0 + b1 C + b2 C^2, and
# where it holds. Dispersions 61 and 83 K; giants of a colour are a little cooler than dwarfs, whose sequence ours is.
DWARFS, GIANTS = ((0.4929, 0.5092, -0.0353), (0.39, 1.50)), ((0.5323, 0.4775, -0.0344), (0.33, 1.81))


@pytest.mark.parametrize(("relation", "limit"), [(DWARFS, 0.03), (GIANTS, 0.05)])
def test_effective_temperature_as_the_infrared_flux_method(relation, limit):
    (b0, b1, b2), (low, high) = relation
    colour = np.linspace(low, high, 50)
    expected = 5040 / (b0 + b1 * colour + b2 * colour**2)
    assert np.abs(effective_temperature(colour) / expected - 1).max() < limit


# U. Heiter et al., A&A 582, A49 (2015), table 10, fundamental Teff; B-V from SIMBAD
MEASURED = {
    "Procyon": (0.42, 6554),
    "18 Sco": (0.652, 5810),
    "tau Cet": (0.72, 5414),
    "eps Eri": (0.88, 5076),
    "61 Cyg A": (1.18, 4374),
    "Arcturus": (1.23, 4286),
}


@pytest.mark.parametrize("star", MEASURED)
def test_measured_stars(star):
    b_v, kelvin = MEASURED[star]
    assert float(effective_temperature(None, b_v)) == pytest.approx(kelvin, rel=0.04)


def test_both_colours_of_the_sequence_agree():
    # the same dwarf, by either colour: G2 V has B-V 0.65, BP-RP 0.823; the Sun, 5772 K
    assert float(effective_temperature(0.823)) == pytest.approx(5772, rel=0.005)
    assert float(effective_temperature(None, 0.65)) == pytest.approx(5772, rel=0.005)
    assert float(effective_temperature(0.823, 1.5)) == float(effective_temperature(0.823))
    assert float(effective_temperature(np.nan, 0.65)) == float(effective_temperature(None, 0.65))


def test_no_extrapolation():
    assert np.isnan(effective_temperature([-0.2, 4.7, np.nan])).all()
    assert np.isnan(effective_temperature(None, [-0.4, 2.2])).all()
    assert np.isnan(effective_temperature())


@pytest.mark.parametrize("colour", [0.0, 0.3, 0.6, 0.8, 1.0, 1.3, 1.6, 2.0])
def test_blackbody_of_the_colour_has_the_stars_other_colour_too(colour):
    # The relation knows nothing of V. G - V of stars against BP-RP: M. Riello et al., A&A 649, A3 (2021), table C.2,
    # sigma 0.03 mag; of black bodies: the passbands of optics.light.magnitudes.
    body = Blackbody(temperature_k=float(colour_temperature(colour)))
    found = synthetic_magnitude(body, system="G") - synthetic_magnitude(body, system="V")
    stars = -0.02704 + 0.01424 * colour - 0.2156 * colour**2 + 0.01426 * colour**3
    assert found == pytest.approx(stars, abs=0.02)


def test_ballesteros_for_the_sun():
    # F. J. Ballesteros, EPL 97, 34008 (2012): the formula gives 5772 to 5800 K for the Sun
    assert float(colour_temperature(None, 0.65)) == pytest.approx(5778, abs=30)


def test_a_star_without_the_one_temperature_gets_the_other_or_the_typical_one():
    stars = star_catalog(
        4,
        bp_rp_mag=[0.5, np.nan, np.nan, 1.2],
        b_v_mag=[np.nan, 0.6, np.nan, np.nan],
        effective_temperature_k=[4000, np.nan, np.nan, 5000],
    )
    by_colour = [float(colour_temperature(0.5)), float(colour_temperature(None, 0.6)), 4900.0]
    np.testing.assert_allclose(star_temperature(stars), [*by_colour, float(colour_temperature(1.2))])
    effective = star_temperature(stars, "effective", typical_k=6000.0)
    np.testing.assert_allclose(effective, [4000.0, by_colour[1], 6000.0, 5000.0])
