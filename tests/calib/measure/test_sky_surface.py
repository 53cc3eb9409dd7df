"""Smooth sky through the levels of blocks: a known polynomial with an outlier and a gap."""

from __future__ import annotations

import numpy as np
import pytest

from calib.measure.sky_surface import sky_surface

BLOCK = 16


def level_at(x, y):
    return 300.0 + 0.2 * x - 0.1 * y + 4e-4 * x * y


def test_a_polynomial_comes_back_in_every_pixel_and_few_blocks_give_their_mean():
    shape, mesh = (12 * BLOCK + 5, 15 * BLOCK + 3), (12, 15)
    y, x = np.indices(mesh) * BLOCK + (BLOCK - 1) / 2.0
    level, sigma = level_at(x, y), np.full(mesh, 0.5)
    level += 0.01 * np.random.default_rng(1).standard_normal(mesh)
    level[3, 4] += 50.0
    level[8, 8], sigma[8, 8] = 0.0, np.nan
    surface = sky_surface(level, sigma, shape, BLOCK)
    assert surface.shape == shape
    row, column = np.indices(shape)
    inside = (slice(8, 12 * BLOCK - 8), slice(8, 15 * BLOCK - 8))
    np.testing.assert_allclose(surface[inside], level_at(column, row)[inside], atol=0.1)
    surface = sky_surface(np.array([[1.0, 3.0], [2.0, 2.0]]), np.ones((2, 2)), (32, 32), BLOCK)
    assert np.ptp(surface) == pytest.approx(0.0, abs=1e-12)
    assert surface[0, 0] == pytest.approx(2.0)
