"""Grid target."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.laboratory.points import nominal_px
from experiments.laboratory.targets import GridTarget, grid_directions, survey
from optics.errors import DomainError
from optics.units import ARCSEC_RAD


def test_grid_points_lie_on_the_detector_where_they_should(star_camera):
    target = GridTarget(jitter_px=0.0, roll_arcmin=0.0, edge_px=100.0)
    place = nominal_px(star_camera, grid_directions(target, star_camera, np.random.default_rng(0)))
    assert place.shape == (32, 2)
    np.testing.assert_allclose(place[0], (100.0, 100.0), atol=1e-6)
    np.testing.assert_allclose(place[-1], (3995.0, 1947.0), atol=1e-6)


def test_roll_turns_the_grid(star_camera):
    straight, rolled = (
        nominal_px(
            star_camera,
            grid_directions(
                GridTarget(jitter_px=0.0, roll_arcmin=roll, edge_px=100.0), star_camera, np.random.default_rng(0)
            ),
        )
        for roll in (0.0, 6.0)
    )
    rise = (rolled - straight)[7, 1] - (rolled - straight)[0, 1]
    assert rise / (straight[7, 0] - straight[0, 0]) == pytest.approx(np.radians(0.1), rel=1e-3)


def test_marking_errors_are_angles(star_camera):
    target = GridTarget(marking_error_arcsec=0.2)
    direction = grid_directions(target, star_camera, np.random.default_rng(0))
    copies = 300
    surveyed = survey(target, direction, np.random.default_rng(3), copies=copies)
    off = (surveyed[..., :2] / surveyed[..., 2:] - direction[:, :2] / direction[:, 2:]) / ARCSEC_RAD
    assert off.std() == pytest.approx(0.2, rel=4.0 / np.sqrt(2.0 * copies * 64))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rows": 1}, "at least 2 x 2"),
        ({"marking_error_arcsec": -0.1}, "marking_error_arcsec"),
        ({"jitter_px": np.nan}, "jitter_px"),
    ],
)
def test_impossible_targets_are_refused(changes, said):
    with pytest.raises(DomainError, match=said):
        GridTarget(**changes)


def test_a_grid_without_room_is_refused(star_camera):
    with pytest.raises(DomainError, match="does not fit"):
        grid_directions(GridTarget(edge_px=1500.0), star_camera, np.random.default_rng(0))
