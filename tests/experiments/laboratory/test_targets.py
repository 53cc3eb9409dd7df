"""Grid targets: where their points are, and how far off a survey puts them."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.laboratory.devices.target import grid_directions, survey
from experiments.laboratory.settings.tables import GridTargetConfig
from render.engine.random import Streams


def on_the_detector(instrument, direction):
    """Ideal images: f times the tangents, in pixels from the middle, rows downwards."""
    tangent = instrument.focal_length_mm * direction[:, :2] / direction[:, 2:]
    return tangent / instrument.camera.pixel_pitch_mm + np.array(instrument.camera.centre_px)


def test_points_stand_on_a_turned_grid(small_camera):
    target = GridTargetConfig(rows=3, columns=5, edge_px=100.0, jitter_px=0.0, roll_arcmin=30.0)
    direction = grid_directions(target, small_camera, Streams(1))
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=1e-15)
    middle = np.array(small_camera.camera.centre_px)
    x, y = np.meshgrid(np.linspace(100.0, 2971.0, 5), np.linspace(100.0, 1435.0, 3))  # 3072 x 1536 px
    flat = np.stack([x.ravel(), y.ravel()], axis=1) - middle
    c, s = np.cos(np.radians(0.5)), np.sin(np.radians(0.5))
    np.testing.assert_allclose(on_the_detector(small_camera, direction), flat @ [[c, s], [-s, c]] + middle, atol=1e-6)


def test_holes_are_drilled_beside_their_places_by_what_is_stated(small_camera):
    """Normal, cut at two standard deviations: variance 0.774 + 4 x 0.0455 = 0.920 of the whole."""
    exact = GridTargetConfig(rows=20, columns=30, jitter_px=0.0, roll_arcmin=0.0)
    rough = GridTargetConfig(rows=20, columns=30, jitter_px=4.0, roll_arcmin=0.0)
    there, here = (
        on_the_detector(small_camera, grid_directions(one, small_camera, Streams(2))) for one in (rough, exact)
    )
    apart = there - here
    assert np.abs(apart).max() == pytest.approx(8.0, abs=1e-6)
    assert apart.std() == pytest.approx(4.0 * np.sqrt(0.7737 + 4 * 0.0455), rel=4 / np.sqrt(2400))


def test_surveys_are_off_by_the_marking_error_independently(small_camera):
    """0.5 arcsec at 3 sigma unless said otherwise (ACC18); at the edge an angle e reads e (1 + t^2) at most."""
    assert GridTargetConfig().marking_error_arcsec == pytest.approx(0.5 / 3.0)
    target = GridTargetConfig(marking_error_arcsec=0.3)
    direction = grid_directions(target, small_camera, Streams(1))
    copies = survey(target, direction, np.random.default_rng(3), copies=200)
    assert copies.shape == (200, 32, 3)
    angle = np.degrees(np.linalg.norm(copies - direction, axis=2)) * 3600.0
    assert np.sqrt((angle**2).mean() / 2.0) == pytest.approx(0.3, rel=4 / np.sqrt(2 * 2 * 6400) + 0.003)
    assert abs(np.corrcoef((copies - direction)[0].ravel(), (copies - direction)[1].ravel())[0, 1]) < 0.5


def test_the_same_streams_are_the_same_hardware(small_camera):
    """A budget predicts for the points that it measures."""
    target = GridTargetConfig(rows=3, columns=5, edge_px=100.0)
    first, second = (grid_directions(target, small_camera, Streams(3).child("grid")) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert np.abs(grid_directions(target, small_camera, Streams(4).child("grid")) - first).max() > 1e-6
