"""Conventions by meaning: where a star lands, and where each neighbour puts the centre of the first pixel."""

import numpy as np
import pytest

from optics import frames, load_lens, spot_moments

SIZE = (4096, 2048)


def test_field_angles_are_those_of_the_projections_and_polar_directions_broadcast():
    v = frames.field_direction(3.0, -2.0)
    assert np.linalg.norm(v) == pytest.approx(1.0, abs=1e-15)
    assert v[0] / v[2] == pytest.approx(np.tan(np.radians(3.0)), abs=1e-15)
    assert v[1] / v[2] == pytest.approx(-np.tan(np.radians(2.0)), abs=1e-15)
    np.testing.assert_allclose(frames.field_angles_deg(v), (3.0, -2.0), atol=1e-13)
    v = frames.polar_direction([0.0, 30.0, 90.0], 45.0)
    half = np.sqrt(0.5)
    expected = [[0.0, 0.0, 1.0], [0.5 * half, 0.5 * half, np.sqrt(0.75)], [half, half, 0.0]]
    np.testing.assert_allclose(v, expected, atol=1e-15)


def test_light_travels_away_from_its_star():
    """x_lens = -X_cam, y_lens = Y_cam, z_lens = -Z_cam, and light runs against the direction of the star."""
    lens_axes_in_cam = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
    v = frames.field_direction([1.0, -4.0], [2.0, 0.5])
    np.testing.assert_allclose(frames.light_direction(v), (lens_axes_in_cam @ -v.T).T, atol=1e-16)
    np.testing.assert_allclose(frames.star_direction(frames.light_direction(v)), v, atol=1e-16)
    assert np.linalg.det(lens_axes_in_cam) == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["star_camera_206mm", "star_tracker_26mm", "double_gauss_50mm"])
def test_star_towards_plus_x_lands_at_a_larger_column_and_plus_y_at_a_larger_row(name):
    spots = spot_moments(load_lens(name), [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [600.0])
    column, row = frames.pixel_from_lens(spots.x_mm[:, 0], spots.y_mm[:, 0], pitch_mm=5.5e-3, size_px=SIZE)
    assert column[0] == pytest.approx(2047.5, abs=0.02)
    assert row[0] == pytest.approx(1023.5, abs=0.02)
    assert column[1] > column[0] + 50
    assert row[2] > row[0] + 50
    assert abs(row[1] - row[0]) < 0.02
    assert abs(column[2] - column[0]) < 0.02


def test_first_pixel_centre_in_every_convention():
    assert frames.pixel_to_mitsuba(0, 0) == (0.5, 0.5)
    assert frames.pixel_to_fits(0, 0) == (1.0, 1.0)
    assert frames.pixel_from_fits(13.25, 0.5) == (12.25, -0.5)
    assert frames.pixel_to_tetra3(3, 7) == (7.5, 3.5)
    assert frames.pixel_to_tetra3rs(2047.5, 1023.5, size_px=SIZE) == (0.0, 0.0)
    assert frames.pixel_to_tetra3rs(4095, 2047, size_px=SIZE) == (2047.5, 1023.5)


def test_equatorial_angles_are_those_of_astropy():
    from astropy.coordinates import SkyCoord

    v = np.random.default_rng(2).standard_normal((50, 3))
    v[0] = 0.0, 0.0, -1.0
    known = SkyCoord(*v.T, representation_type="cartesian").spherical
    ra, dec = frames.equatorial_deg(v)
    assert ra == pytest.approx(known.lon.deg, abs=1e-12)
    assert dec == pytest.approx(known.lat.deg, abs=1e-12)
