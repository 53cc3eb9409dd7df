"""Places of Moon and planets against astropy's own apparent places, and as a part of a star field."""

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import GCRS, get_body
from astropy.time import Time

from optics.light.band import TopHat
from optics.light.magnitudes import photon_rate
from render.bodies.planet_magnitudes import planet_spectrum
from render.bodies.solar_system import BODIES, joined, planet_field, solar_system
from render.catalogue.motion import earth_observer

EPOCH = 2024.35
BANDS = (TopHat(centre_nm=550.0, width_nm=80.0), TopHat(centre_nm=700.0, width_nm=100.0))


def test_directions_against_astropy():
    """get_body: light time and, in GCRS, aberration by astropy's own code (with deflection by the Sun)."""
    time = Time(EPOCH, format="jyear", scale="tdb")
    system = solar_system(EPOCH)
    for name, direction, distance in zip(system.name, system.direction, system.distance_au, strict=True):
        body = get_body(name, time, ephemeris="builtin").transform_to(GCRS(obstime=time))
        expected = body.cartesian.xyz.to_value(units.au)
        assert distance == pytest.approx(np.linalg.norm(expected), rel=1e-6)
        off = np.linalg.norm(direction - expected / np.linalg.norm(expected))
        # astropy bends the light by the Sun, by at most 4.07 mas / tan(half the angle to it)
        angle = np.arccos(
            -direction @ earth_observer(EPOCH).from_sun_au / np.linalg.norm(earth_observer(EPOCH).from_sun_au)
        )
        assert np.degrees(off) * 3600 < 0.01 + 0.0041 / np.tan(angle / 2), name


def test_known_evening():
    """4 October 2021, 0 h UTC: magnitudes that Skyfield gives with JPL's DE421, to their one decimal."""
    system = solar_system(Time("2021-10-04").tdb.jyear)
    seen = dict(zip(system.name, system.magnitude_v, strict=True))
    for name, v in {"mercury": 2.4, "venus": -4.3, "mars": 1.6, "jupiter": -2.7, "uranus": 5.7, "neptune": 7.7}.items():
        assert seen[name] == pytest.approx(v, abs=0.06 if name != "mars" else 0.15)
    # new Moon on the 6th
    assert np.degrees(system.phase_rad[system.name.index("moon")]) > 140.0
    arcsec = np.degrees(system.angular_diameter_rad) * 3600
    assert arcsec[system.name.index("jupiter")] == pytest.approx(46.2 * 69911 / 71492, rel=0.01)  # 46.2" at the equator


def test_as_points_of_light():
    system = solar_system(EPOCH).select([0, 3, 4])
    assert system.name == ("mercury", "mars", "jupiter")
    field = planet_field(system, BANDS)
    fine = np.linspace(650.0, 750.0, 2001)
    density = photon_rate(planet_spectrum("jupiter"), system.magnitude_v[2], wavelength_nm=fine)
    assert field.photon_rate[2, 1].sum() == pytest.approx(np.trapezoid(density, fine), rel=1e-3)
    both = joined(field, planet_field(solar_system(EPOCH, bodies=["venus"]), BANDS))
    assert len(both) == 4
    assert both.photon_rate[3].sum() > both.photon_rate[0].sum()


def test_from_elsewhere():
    """From the Moon's distance above the Earth the Earth is there, and the parallax of the Moon is large."""
    centre = earth_observer(EPOCH)
    above = centre.moved(position_km=(0.0, 0.0, 4e5), velocity_km_per_s=(0.0, 0.0, 0.0))
    system = solar_system(EPOCH, observer=above, bodies=(*BODIES, "earth"))
    assert system.direction[-1] @ [0.0, 0.0, -1.0] > 0.999999
    moon = system.name.index("moon")
    assert np.degrees(np.arccos(system.direction[moon] @ solar_system(EPOCH).direction[moon])) > 20.0
