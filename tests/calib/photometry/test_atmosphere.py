"""Zenith, refraction and air mass against ERFA and closed forms."""

from __future__ import annotations

from datetime import UTC, datetime

import erfa
import numpy as np
import pytest

from calib.photometry.atmosphere import airmass, fit_zenith, refracted, zenith_directions

TAKEN = [datetime(2019, 7, 29, 20, 47, 26 + k, tzinfo=UTC) for k in range(6)]
UP = np.array([0.0, 0.0, 1.0])


def test_site_by_the_altitudes_of_the_boresights_and_a_zenith_that_turns_with_the_earth():
    zenith = zenith_directions(52.1, 4.4, TAKEN)
    around = np.random.default_rng(2).standard_normal((6, 3))
    side = np.cross(zenith, around)
    side /= np.linalg.norm(side, axis=1)[:, None]
    altitude = np.radians([40, 40, 60, 60, 50, 45.0])
    boresight = np.sin(altitude)[:, None] * zenith + np.cos(altitude)[:, None] * side
    fit = fit_zenith(boresight, np.degrees(altitude) - 1.2, TAKEN)
    assert fit is not None
    np.testing.assert_allclose([fit.latitude_deg, fit.longitude_deg, fit.offset_deg], [52.1, 4.4, 1.2], atol=1e-6)
    assert fit_zenith(boresight[:3], np.degrees(altitude[:3]), TAKEN[:3]) is None
    assert fit_zenith(boresight, np.degrees(altitude)[::-1], TAKEN) is None  # altitudes of another mount
    # A sidereal day later the zenith is the same; declination is the latitude (to 0.2 deg of precession)
    later = datetime(2019, 7, 30, 20, 43, 30, tzinfo=UTC)
    first, second = zenith_directions(52.1, 4.4, [TAKEN[0], later])
    assert np.degrees(np.arccos(first @ second)) < 0.01
    assert np.degrees(np.arcsin(first[2])) == pytest.approx(52.1, abs=0.2)


@pytest.mark.parametrize("altitude", [35.0, 50.0, 70.0])
def test_refraction_is_that_of_erfa(altitude):
    a, b = erfa.refco(1010.0, 10.0, 0.0, 0.6)
    z = np.radians(90.0 - altitude)
    direction = np.array([[np.sin(z), 0.0, np.cos(z)]])
    apparent = refracted(direction, UP, 58.3)
    angle = np.degrees(np.arccos(apparent[0] @ direction[0])) * 3600.0
    assert angle == pytest.approx(np.degrees(a * np.tan(z) + b * np.tan(z) ** 3) * 3600.0, rel=0.01)
    assert apparent[0, 2] > direction[0, 2]


def test_airmass_of_the_published_table():
    """Kasten and Young (1989), table 2: 1.9939 at 30 deg, 5.5841 at 10 deg, 37.92 at the horizon."""
    altitude = np.radians([90.0, 30.0, 10.0, 0.0])
    direction = np.column_stack([np.cos(altitude), np.zeros(4), np.sin(altitude)])
    np.testing.assert_allclose(airmass(direction, UP), [1.0, 1.9939, 5.5841, 37.92], rtol=5e-4)
