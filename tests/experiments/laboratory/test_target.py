"""The multi-star target, a rigid grid of points turned before the camera; the grid target and its surveys."""

import numpy as np
import pytest

from experiments.laboratory.devices.target import (
    CORNERS,
    corner_centres,
    corner_directions,
    grid_directions,
    survey,
    target_directions,
)
from experiments.laboratory.settings.tables import GridTargetConfig, TargetConfig
from optics.errors import DomainError
from render.engine.random import Streams


def angles_between(directions):
    """Angles of all pairs [rad], by the tangent, which keeps small angles exact."""
    a, b = directions[:, None], directions[None]
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))


@pytest.fixture(scope="module")
def corners(star_camera):
    return corner_directions(TargetConfig(), star_camera)


def pixels(instrument, directions):
    """Ideal image f tan(field): +X_cam is +column, +Y_cam is +row."""
    scale = instrument.focal_length_mm / instrument.camera.pixel_pitch_mm
    return instrument.camera.centre_px + scale * directions[..., :2] / directions[..., 2:]


def test_grid_keeps_its_shape_when_the_platform_turns(corners, star_camera):
    middle = target_directions(TargetConfig(), star_camera, np.array([2047.5, 1023.5]))
    for turned in corners:
        assert np.abs(angles_between(turned) - angles_between(middle)).max() < 1e-14


def test_grid_on_the_axis_is_a_square_lattice(star_camera):
    seen = pixels(star_camera, target_directions(TargetConfig(), star_camera, np.array([2047.5, 1023.5])))
    column, row = np.meshgrid(2047.5 + 150.0 * np.arange(-2, 3), 1023.5 + 150.0 * np.arange(-2, 3))
    assert np.abs(seen - np.column_stack([column.ravel(), row.ravel()])).max() < 1e-9


def test_corners_come_in_the_order_of_their_names(corners, star_camera):
    assert CORNERS == ("upper left", "upper right", "lower left", "lower right")
    column, row = pixels(star_camera, corners).mean(1).T
    assert (column < 2047.5).tolist() == [True, False, True, False]
    assert (row < 1023.5).tolist() == [True, True, False, False]  # row 0 is the upper edge


def test_points_are_listed_row_by_row(corners, star_camera):
    seen = pixels(star_camera, corners).reshape(4, 5, 5, 2)
    assert np.all(np.diff(seen[..., 0], axis=2) > 140)
    assert np.all(np.diff(seen[..., 1], axis=1) > 140)
    # turned without roll: rows stay level but for the keystone of a flat grid seen askew (xy/f^2 of the pitch)
    assert np.abs(np.diff(seen[..., 1], axis=2)).max() < 0.5


def test_distance_from_the_edge(corners, star_camera):
    seen = pixels(star_camera, corners)
    # keystone of a grid 300 px out, 1600 px off the axis, f = 37500 px: up to 1 px
    assert seen[0].min(0) == pytest.approx([150.0, 150.0], abs=1.5)
    assert seen[3].max(0) == pytest.approx([4095 - 150.0, 2047 - 150.0], abs=1.5)


@pytest.mark.parametrize(("edge_px", "fits"), [(723.0, True), (723.6, False)])
def test_target_fits_to_the_last_pixel(edge_px, fits):
    # 2 edge + 4 pitch = 2047 px between the first and the last row
    target = TargetConfig(edge_px=edge_px)
    if fits:
        assert corner_centres(target, 4096, 2048).shape == (4, 2)
    else:
        with pytest.raises(DomainError, match=r"5 x 5 points, 150 px apart and 723.6 px .* 4096 x 2048"):
            corner_centres(target, 4096, 2048)


def test_points_stand_on_a_turned_grid(small_camera):
    target = GridTargetConfig(rows=3, columns=5, edge_px=100.0, jitter_px=0.0, roll_arcmin=30.0)
    direction = grid_directions(target, small_camera, Streams(1))
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=1e-15)
    middle = np.array(small_camera.camera.centre_px)
    x, y = np.meshgrid(np.linspace(100.0, 2971.0, 5), np.linspace(100.0, 1435.0, 3))  # 3072 x 1536 px
    flat = np.stack([x.ravel(), y.ravel()], axis=1) - middle
    c, s = np.cos(np.radians(0.5)), np.sin(np.radians(0.5))
    np.testing.assert_allclose(pixels(small_camera, direction), flat @ [[c, s], [-s, c]] + middle, atol=1e-6)


def test_holes_are_drilled_beside_their_places_by_what_is_stated(small_camera):
    """Normal, cut at two standard deviations: variance 0.774 + 4 x 0.0455 = 0.920 of the whole."""
    exact = GridTargetConfig(rows=20, columns=30, jitter_px=0.0, roll_arcmin=0.0)
    rough = GridTargetConfig(rows=20, columns=30, jitter_px=4.0, roll_arcmin=0.0)
    there, here = (pixels(small_camera, grid_directions(one, small_camera, Streams(2))) for one in (rough, exact))
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
