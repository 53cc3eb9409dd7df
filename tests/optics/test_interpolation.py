"""Bilinear interpolation against SciPy's, and at the edges of the table."""

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from optics.interpolation import bilinear


def test_a_table_between_its_knots_and_beyond_its_edges():
    rng = np.random.default_rng(1)
    knots = np.cumsum(rng.uniform(0.5, 2.0, 5)), np.cumsum(rng.uniform(0.5, 2.0, 4))
    table = rng.normal(size=(5, 4))
    positions = tuple(rng.uniform(k[0], k[-1], 200) for k in knots)
    expected = RegularGridInterpolator(knots, table)(np.stack(positions, axis=-1))
    np.testing.assert_allclose(bilinear(table, knots, positions), expected, rtol=1e-12, atol=1e-14)
    corners = np.array([1e3, -1e3])
    assert bilinear(table, knots, (corners, -corners)).tolist() == [table[-1, 0], table[0, -1]]
