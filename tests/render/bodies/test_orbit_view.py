"""Sun, limb of the Earth and shadow from an orbit: closed forms and astropy."""

import numpy as np
import pytest

from render.bodies.orbit_view import orbit_view
from render.motion.orbit import EARTH_RADIUS_KM, in_shadow, kepler_orbit, limb_angle_deg


def test_sun_and_moon_are_where_astropy_has_them():
    from astropy.coordinates import get_body, get_sun
    from astropy.time import Time

    view, time = orbit_view(2024.3), Time(2024.3, format="jyear")
    for ours, body in ((view.sun, get_sun(time)), (view.moon, get_body("moon", time))):
        theirs = body.cartesian.xyz.value
        assert np.degrees(np.arccos(ours @ theirs / np.linalg.norm(theirs))) < 0.02  # aberration, light time


def test_a_circular_orbit_through_the_suns_direction_is_dark_as_long_as_its_height_has_it():
    """Sun in the plane of a circular orbit: asin(R / r) / pi of it lies in the cylinder of the shadow."""
    turn = np.linspace(0.0, 2.0 * np.pi, 20_001)[:-1]
    position = (EARTH_RADIUS_KM + 600.0) * np.stack([np.cos(turn), 0.0 * turn, np.sin(turn)], axis=1)
    fraction = in_shadow(position, [1.0, 0.0, 0.0]).mean()
    assert fraction == pytest.approx(np.arcsin(EARTH_RADIUS_KM / (EARTH_RADIUS_KM + 600.0)) / np.pi, abs=1e-4)
    assert not in_shadow([0.0, 7000.0, 0.0], [0.0, 1.0, 0.0])  # between Sun and Earth


def test_angles_to_the_limb():
    """From twice the radius the disk is 30 deg wide to either side; zenith and nadir lie 150 deg from it and inside."""
    position = np.array([0.0, 0.0, 2.0 * EARTH_RADIUS_KM])
    direction = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    np.testing.assert_allclose(limb_angle_deg(direction, position), [150.0, -30.0, 60.0], atol=1e-9)


def test_angles_of_all_bodies_from_an_orbit():
    view, orbit = orbit_view(2024.3), kepler_orbit(
        perigee_km=600.0, eccentricity=0.0, inclination_deg=50.0, node_deg=0.0, perigee_deg=0.0, anomaly_deg=0.0,
        epoch_year=2024.3,
    )  # fmt: skip
    position = orbit.state([0.0, 900.0])[0]
    angles = view.angles_deg(np.stack([view.sun, view.moon]), position)
    np.testing.assert_allclose(angles["sun"], [0.0, np.degrees(np.arccos(view.sun @ view.moon))], atol=1e-6)
    assert 0.0 < angles["moon"][1] < np.degrees(np.arcsin(6978.137 / 384_400.0))  # parallax
    np.testing.assert_allclose(angles["earth"], limb_angle_deg(np.stack([view.sun, view.moon]), position))
