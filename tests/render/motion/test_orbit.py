"""Orbits against Newton's law, SGP4 and astropy."""

import numpy as np
import pytest

from render.motion.orbit import EARTH_RADIUS_KM, GM_KM3_PER_S2, kepler_orbit, sgp4_orbit

ELEMENTS = {
    "perigee_km": 700.0,
    "eccentricity": 0.3,
    "inclination_deg": 97.8,
    "node_deg": 250.0,
    "perigee_deg": 50.0,
    "anomaly_deg": 10.0,
    "epoch_year": 2024.3,
}


def test_an_elliptic_orbit_moves_by_newtons_law():
    """Second differences of the position are the attraction; energy and angular momentum are the ellipse's."""
    orbit, step = kepler_orbit(**ELEMENTS), 0.5
    time = np.linspace(0.0, orbit.period_s, 40)
    before, position, after = (orbit.state(time + shift)[0] for shift in (-step, 0.0, step))
    velocity, distance = orbit.state(time)[1], np.linalg.norm(position, axis=1)
    attraction = -GM_KM3_PER_S2 * position / distance[:, None] ** 3
    np.testing.assert_allclose((after - 2.0 * position + before) / step**2, attraction, atol=2e-6)
    np.testing.assert_allclose((after - before) / (2.0 * step), velocity, atol=1e-5)
    axis_km = (EARTH_RADIUS_KM + 700.0) / 0.7
    np.testing.assert_allclose(0.5 * (velocity**2).sum(1) - GM_KM3_PER_S2 / distance, -0.5 * GM_KM3_PER_S2 / axis_km)
    momentum = np.sqrt(GM_KM3_PER_S2 * axis_km * (1.0 - 0.3**2)) * orbit.pole
    np.testing.assert_allclose(np.cross(position, velocity), np.tile(momentum, (40, 1)), atol=1e-6)
    assert np.degrees(np.arccos(orbit.pole[2])) == pytest.approx(97.8, abs=1e-9)
    assert orbit.period_s == pytest.approx(2.0 * np.pi * np.sqrt(axis_km**3 / GM_KM3_PER_S2))


def test_two_line_elements_fly_as_sgp4_and_astropy_have_them():
    """Of the space station; SGP4's axes turned to icrs by astropy with its own Earth orientation."""
    pytest.importorskip("sgp4")
    from astropy import units as u
    from astropy.coordinates import GCRS, TEME, CartesianDifferential, CartesianRepresentation
    from astropy.time import Time
    from sgp4.api import Satrec

    lines = (
        "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991",
        "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482",
    )
    orbit, satellite = sgp4_orbit(*lines), Satrec.twoline2rv(*lines)
    time = Time(satellite.jdsatepoch, satellite.jdsatepochF, format="jd") + 3000.0 * u.s
    _, position, velocity = satellite.sgp4(time.jd1, time.jd2)
    teme = CartesianRepresentation(position * u.km, differentials=CartesianDifferential(velocity * u.km / u.s))
    true = TEME(teme, obstime=time).transform_to(GCRS(obstime=time)).cartesian
    np.testing.assert_allclose(orbit.state(3000.0)[0], true.xyz.to_value(u.km), atol=3e-3)  # 0.1 arcsec
    np.testing.assert_allclose(orbit.state(3000.0)[1], true.differentials["s"].d_xyz.to_value(u.km / u.s), atol=4e-6)
    assert orbit.period_s == pytest.approx(86400.0 / 15.501, rel=1e-4)
    assert orbit.epoch_year == pytest.approx(2019.9376, abs=1e-3)


def test_a_camera_fixed_to_the_local_vertical_turns_once_per_revolution():
    orbit = kepler_orbit(**ELEMENTS | {"eccentricity": 0.0})
    time = np.array([1000.0, 1001.0])
    attitude, (position, velocity) = orbit.local_vertical(time, 30.0), orbit.state(time)
    assert np.degrees((attitude[1] * attitude[0].inv()).magnitude()) == pytest.approx(360.0 / orbit.period_s, rel=1e-5)
    zenith = position / np.linalg.norm(position, axis=1)[:, None]
    columns, _, boresight = attitude.as_matrix().transpose(1, 0, 2)
    np.testing.assert_allclose((boresight * zenith).sum(1), np.cos(np.radians(30.0)), atol=1e-12)
    np.testing.assert_allclose(boresight @ orbit.pole, 0.5, atol=1e-12)
    np.testing.assert_allclose(columns, -velocity / np.linalg.norm(velocity, axis=1)[:, None], atol=1e-9)
