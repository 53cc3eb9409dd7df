"""The reflected spot: overlap of two circles, light that is all there, particles that scatter as they should."""

import numpy as np
import pytest

from render.bench.scene import BenchGeometry
from render.bench.spot import landing_points_px, mask_spot_variance_px2, spot_profile

GEOMETRY = BenchGeometry(cube_offset_mm=np.zeros(3))


def test_profile_of_the_spot():
    """All light of the aperture is in it; a point sees the whole sun inside a - b and none beyond a + b."""
    reach = 1.25 + 1300 * np.tan(np.radians(1.5 / 60))
    radius = np.linspace(0, reach, 20001)
    profile = spot_profile(GEOMETRY, radius)
    assert np.trapezoid(profile * 2 * np.pi * radius, radius) == pytest.approx(np.pi * 1.25**2, rel=1e-6)
    assert profile[0] == 1.0
    assert spot_profile(GEOMETRY, [2.5 - reach - 1e-3, reach + 1e-3]) == pytest.approx([1.0, 0.0])


def test_landing_points_fill_the_profile():
    """Particles in 30 rings of equal area against two circles overlapping; 2^16 particles count a ring to 2 %."""
    hole, lean = 1.25 / 0.015, GEOMETRY.blur_mm(GEOMETRY.path_mm) / 0.015
    x, y, per_px = landing_points_px(hole, lean, 16, 3)
    edge = (hole + lean) * np.sqrt(np.linspace(0.0, 1.0, 31))
    count, _ = np.histogram(np.hypot(x, y), edge)
    fine = edge[:-1, None] + np.diff(edge)[:, None] * (np.arange(16) + 0.5) / 16
    closed = (spot_profile(GEOMETRY, fine * 0.015) * fine).sum(1) / fine.sum(1)
    assert np.abs(count / (np.pi * np.diff(edge**2) * per_px) - closed).max() < 0.06


def test_particles_of_mask_spots_scatter_less_than_independent_ones():
    """Independent particles of a disk of radius r, each in its pixel, would give (r^2 / 4 + 1 / 12) / n."""
    found = mask_spot_variance_px2(14.0, 0.2, np.array([1.0, 0.8, 0.7, 0.9]), 10)
    independent = (14.0**2 / 4 + 1 / 12) / 1024
    assert 1e-3 * independent < found < 0.5 * independent
    assert mask_spot_variance_px2(14.0, 0.2, np.array([1.0, 0.8, 0.7, 0.9]), 12) < 0.5 * found
