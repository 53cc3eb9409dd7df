"""The laboratory target: a rigid grid of points, turned to where the camera is to see it."""

import numpy as np
import pytest

from experiments.laboratory.devices.target import CORNERS, corner_centres, corner_directions, target_directions
from experiments.laboratory.settings.tables import TargetConfig
from optics.errors import DomainError


def angles_between(directions):
    """Angles of all pairs [rad], by the tangent, which keeps small angles exact."""
    a, b = directions[:, None], directions[None]
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))


@pytest.fixture(scope="module")
def corners(star_camera):
    return corner_directions(TargetConfig(), star_camera)


def pixels(star_camera, directions):
    """Ideal image f tan(field): +X_cam is +column, +Y_cam is +row."""
    scale = star_camera.focal_length_mm / 5.5e-3
    return np.array([2047.5, 1023.5]) + scale * directions[..., :2] / directions[..., 2:]


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


def test_target_outside_the_field_of_the_lens_is_refused():
    from render.sensor_file.instrument import build_instrument
    from render.sensor_file.tables import InstrumentConfig

    wide = build_instrument(InstrumentConfig(lens="star_tracker_26mm"))
    with pytest.raises(DomainError, match=r"deg from the axis.*field of 16.5 deg"):
        corner_directions(TargetConfig(), wide)
