"""Trails: members of a line of light, and stars drawn out by a motion of the camera."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from calib.measure.detection.trails import star_shape, trail_members


def test_a_star_in_the_direction_of_a_trail_is_no_piece_of_it():
    """Light from column 8 to 62 with five pieces; in the dark beyond it a star on the same line."""
    image = np.zeros((100, 120))
    image[50, 8:63] = 10.0
    x = np.array([12, 24, 36, 48, 60, 95])
    assert trail_members(image, x, np.full(6, 50)).tolist() == [True] * 5 + [False]


@pytest.mark.parametrize(("trail_px", "sigma_px"), [(0.0, 1.0), (14.0, 1.0), (0.0, 3.0)])
def test_shape_of_stars_is_as_they_were_drawn(trail_px, sigma_px):
    """Nine stars in noise, uniform trails along (0.8, 0.6), a tenth closer star left out."""
    rng, size = np.random.default_rng(3), 200
    place = np.array([(30.0 + 60 * i, 30.0 + 60 * j) for i in range(3) for j in range(3)]) + rng.uniform(
        -0.5, 0.5, (9, 2)
    )
    image = np.zeros((size, size))
    for step in np.linspace(-0.5, 0.5, 57) * trail_px:
        x, y = np.rint(place + step * np.array([0.8, 0.6])).astype(int).T
        np.add.at(image, (y, x), 1.0 / 57)
    dn = 100.0 + 1e5 * gaussian_filter(image, sigma_px) + rng.standard_normal((size, size))
    shape = star_shape(dn, np.vstack([place, place[:1] + 3.0]), noise_dn=1.0)
    assert shape.trail_px == pytest.approx(trail_px, abs=0.3)
    assert shape.width_px == pytest.approx(np.hypot(sigma_px, 12**-0.5 if trail_px else 0.0), rel=0.1)  # rounding
    if trail_px:
        assert shape.angle_deg == pytest.approx(np.degrees(np.arctan2(0.6, 0.8)), abs=1.0)
    nothing = star_shape(dn, place[:2], noise_dn=1.0)
    assert nothing.trail_px == 0.0
    assert np.isnan(nothing.width_px)
