"""Parts of the sky by closed forms: areas of caps, gaps, arcs, sides of a cone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from render.sky.partition import cone_directions, leakage, parts_by_arcs, parts_by_caps, parts_by_latitude

FRACTION = {"train": 0.8, "validation": 0.1, "test": 0.1}
POLE = np.array([0.0, 0.6, 0.8])


def counted(part_of, boresights):
    names = np.array([part_of(v) for v in boresights])
    used = names[names != "gap"]
    return names, {name: float((used == name).mean()) for name in FRACTION}


def least_angle(names, boresights):
    """Smallest angle between boresights of different parts."""
    masks = [names == name for name in FRACTION]
    pairs = [(boresights[a] @ boresights[b].T).max() for k, a in enumerate(masks) for b in masks[k + 1 :]]
    return np.arccos(np.clip(max(pairs), -1.0, 1.0))


def test_caps_have_their_fractions_and_gaps():
    boresights = np.random.default_rng(1).standard_normal((4000, 3))
    boresights /= np.linalg.norm(boresights, axis=1, keepdims=True)
    names, parts = counted(parts_by_caps(FRACTION, POLE, 0.3), boresights)
    for name, wanted in FRACTION.items():
        assert parts[name] == pytest.approx(wanted, abs=4.0 * np.sqrt(wanted / 3000.0))
    assert least_angle(names, boresights) >= 0.3


def test_sides_of_a_cone():
    axes = Rotation.from_euler("xyz", [20, 40, 70], degrees=True).as_matrix()
    cone = cone_directions(axes, 0.2, 3000)
    assert (cone @ axes[2]).min() == pytest.approx(np.cos(0.2), abs=1e-4)
    assert np.degrees(np.arccos(cone.mean(0) @ axes[2] / np.linalg.norm(cone.mean(0)))) < 0.1
    names, parts = counted(parts_by_latitude(FRACTION, cone, 0.02, np.array([0.3, -1.0, 0.5])), cone)
    assert parts == pytest.approx(FRACTION, abs=0.01)
    assert least_angle(names, cone) >= 0.02


def test_arcs_of_a_scan():
    start = np.array([np.sin(0.7), 0.0, np.cos(0.7)])
    turns = Rotation.from_rotvec(np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)[:, None] * np.array([0, 0, 1.0]))
    boresights = turns.apply(start)
    names, parts = counted(parts_by_arcs(FRACTION, np.array([0.0, 0.0, 1.0]), start, 0.05), boresights)
    assert parts == pytest.approx(FRACTION, abs=0.02)
    assert least_angle(names, boresights) >= 0.05 - 2e-3
    assert (names != "gap").mean() > 0.5


def test_leakage_is_counted():
    """Against all pairs: fields at random have a neighbour that was taught within a degree or two."""
    rng = np.random.default_rng(7)
    places = {
        name: np.column_stack([rng.uniform(0, 40, n), rng.uniform(-20, 20, n)])
        for name, n in (("train", 60), ("test", 30))
    }
    found = leakage({name: list(map(tuple, rows)) for name, rows in places.items()}, 5.0)["test"]
    train, test = (
        np.column_stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])
        for a, d in (np.radians(places[name]).T for name in ("train", "test"))
    )
    angle = np.degrees(np.arccos(np.clip(test @ train.T, -1, 1))).min(axis=1)
    assert (found.frames, found.near, found.shared) == (30, (angle < 2.5).sum(), (angle < 5.0).sum())
    assert found.nearest_deg == pytest.approx(angle.min(), abs=1e-6)
    assert np.isnan(leakage({"test": [(0.0, 0.0)]}, 5.0)["test"].nearest_deg)
