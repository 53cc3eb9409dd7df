"""Cone searches against brute force, and their speed."""

import numpy as np
import pytest
from fields import star_catalog

from render.catalogue.index import build_index


@pytest.fixture(scope="module")
def index():
    return build_index(star_catalog(20000))


@pytest.mark.parametrize("radius_deg", [0.01, 10.0, 120.0])
@pytest.mark.parametrize("centre", [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0.6, 0.0, -0.8]])
def test_same_stars_as_brute_force(index, radius_deg, centre):
    v, radius = index.catalog.direction, np.radians(radius_deg)
    angle = np.arctan2(np.linalg.norm(np.cross(v, centre), axis=1), v @ np.array(centre, float))
    assert index.within(centre, radius).tolist() == np.flatnonzero(angle <= radius).tolist()


def test_magnitude_limit_includes_itself(index):
    limit = float(np.sort(index.catalog.magnitude)[500])
    rows = index.within([0.0, 1.0, 0.0], np.pi, magnitude_limit=limit)
    assert len(rows) == 501
    assert index.catalog.magnitude[rows].max() == limit


def test_star_without_magnitude():
    magnitude = np.full(10, 5.0)
    magnitude[3] = np.nan
    index = build_index(star_catalog(10, magnitude=magnitude))
    assert len(index.within([1.0, 0, 0], np.pi)) == 10
    assert 3 not in index.within([1.0, 0, 0], np.pi, magnitude_limit=99.0)


def test_tiny_cones_hold_their_star(index):
    # 1e-9 rad, 0.2 mas: a cosine would not tell it from 0
    for row in range(20):
        assert index.within(index.catalog.direction[row], 1e-9).tolist() == [row]
