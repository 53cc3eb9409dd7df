"""Radii of the field divided at kinks, against functions whose kinks are known."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from render.tracing.wave_segments import radial_edges


def light(r):
    """Of a beam that one aperture begins to cut at 0.6 and another one at 0.75."""
    return 1.0 - 0.1 * r**2 - 0.8 * np.maximum(r - 0.6, 0.0) ** 1.5 - 0.5 * np.maximum(r - 0.75, 0.0) ** 2


def test_polynomials_follow_light_with_kinks_between_the_edges_and_nowhere_else():
    r = (np.arange(320) + 0.5) / 320
    edges = radial_edges(r, light(r)[:, None], 0.3 * (r - r**3)[:, None], 9, 6)
    assert np.abs(edges - 0.6).min() < 0.02
    assert edges[0] > 0.55
    node = -np.cos(np.pi * (np.arange(6) + 0.5) / 6)
    for low, high in zip(edges, [*edges[1:], 1.0], strict=True):
        place = 0.5 * (low + high) + 0.5 * (high - low) * node
        at = np.linspace(low, high, 101)[1:-1]
        assert np.abs(BarycentricInterpolator(place, light(place))(at) - light(at)).max() < 5e-5


def test_a_smooth_field_is_not_divided():
    r = (np.arange(320) + 0.5) / 320
    even, odd = np.cos(np.outer(r, [0.5, 2.0])), np.sin(3.0 * r)[:, None]
    assert len(radial_edges(r, even, odd, 9, 6)) == 0
