"""Neighbours of stars: the brightest within reach, and the nearest brighter one."""

import numpy as np

from render.sky.view import neighbours


def test_neighbours_within_reach_both_ways():
    """Three stars in a row, 1 and 2 mrad apart, and one alone."""
    angle = np.array([0.0, 1e-3, 3e-3, 0.5])
    direction = np.column_stack([np.sin(angle), np.zeros(4), np.cos(angle)])
    brightest, nearest = neighbours(direction, np.array([5.0, 4.0, 3.0, 1.0]), 2.5e-3)
    assert brightest.tolist() == [4.0, 3.0, 4.0, np.inf]
    np.testing.assert_allclose(nearest, [1e-3, 2e-3, np.inf, np.inf], rtol=1e-6)
