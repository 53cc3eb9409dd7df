"""The bench on paper: aiming, setting and reading."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.bench import Bench, aim, visit
from experiments.laboratory.single_star.star import star_angles_deg, star_direction
from optics.errors import DomainError
from optics.frames import field_direction
from optics.units import ARCSEC_RAD
from render.engine.random import Streams


def _bench(axes: str = "xy", lean: float = 0.0, **options: float) -> Bench:
    return Bench(
        table=build_turntable(axes, non_orthogonality_arcsec=lean, **options),
        star=star_direction(0.3, -0.2),
        installation=Rotation.from_rotvec([0.01, -0.02, 0.3]),
    )


def test_star_angles_and_direction_are_inverse() -> None:
    np.testing.assert_allclose(star_direction(0.0, 0.0), [0, 0, 1])
    assert star_direction(90.0, 0.0) @ [1, 0, 0] == pytest.approx(1.0)
    assert star_direction(0.0, 90.0) @ [0, 1, 0] == pytest.approx(1.0)
    angles = np.array([[12.0, -33.0], [-50.0, 4.0]])
    np.testing.assert_allclose(star_angles_deg(star_direction(*angles.T)), angles, atol=1e-12)


@pytest.mark.parametrize("axes", ["xy", "yx", "x-y", "xyz"])
def test_the_star_appears_where_it_was_wanted(axes: str) -> None:
    bench = _bench(axes, lean=30.0)
    field = np.array([[3.0, -2.0], [-15.0, 0.1], [0.0, 18.0]])
    wanted = field_direction(*field.T)
    angle = aim(bench, wanted, np.radians([0.0, 90.0, 200.0]))
    np.testing.assert_allclose(bench.seen(angle), wanted, atol=1e-11)
    if len(axes) == 3 and axes != "x-y":
        np.testing.assert_allclose(np.degrees(angle[:, 2]), [0, 90, 200])


def test_turning_the_table_right_handed_moves_the_star_left_handed() -> None:
    """Camera square on the table: a turn about +X brings +Y_cam towards Z, the star at +Z goes to -Y_cam... by hand."""
    bench = Bench(table=build_turntable("xy"), star=np.array([0.0, 0.0, 1.0]), installation=Rotation.identity())
    seen = bench.seen(np.array([[0.1, 0.0], [0.0, 0.1]]))
    np.testing.assert_allclose(seen, [[0, np.sin(0.1), np.cos(0.1)], [-np.sin(0.1), 0, np.cos(0.1)]], atol=1e-15)


@pytest.mark.parametrize(("axes", "outer", "inner"), [("xy", [1, 0, 0], [0, 1, 0]), ("y-x", [0, 1, 0], [-1, 0, 0])])
def test_what_the_camera_sees_in_matrices(axes: str, outer: list[float], inner: list[float]) -> None:
    """v = A T^T s; the inner axis leans towards the outer one (FISHER23 eq. 1-6)."""
    lean, first, second = 400.0 * ARCSEC_RAD, 0.2, -0.3
    carried = np.cos(lean) * np.array(inner) + np.sin(lean) * np.array(outer)
    turns = [Rotation.from_rotvec(angle * np.array(axis)) for angle, axis in ((first, outer), (second, carried))]
    bench = _bench(axes, lean=400.0)
    table = turns[0].as_matrix() @ turns[1].as_matrix()
    expected = bench.installation.as_matrix() @ table.T @ bench.star
    np.testing.assert_allclose(bench.seen(np.array([[first, second]]))[0], expected, atol=1e-14)


def test_a_star_along_the_outer_axis_cannot_be_steered() -> None:
    bench = Bench(table=build_turntable("zx"), star=np.array([0.0, 0.0, 1.0]), installation=Rotation.identity())
    with pytest.raises(DomainError, match="cannot turn the camera"):
        aim(bench, field_direction([3.0, 90.0 - 1e-3], [0.0, 0.0]), np.zeros(2))


def test_a_visit_knows_what_is_and_what_is_read() -> None:
    bench = _bench("xy", reading_noise_arcsec=2.0, setting_noise_arcsec=10.0)
    wanted = field_direction([1.0, -1.0], [0.5, 2.0])
    visits = visit(bench, np.zeros((2, 2)), wanted, np.zeros(2), Streams(5), readings=2)
    np.testing.assert_allclose(visits.direction, bench.seen(visits.true_rad.copy()), atol=1e-15)
    off = np.linalg.norm(visits.direction - wanted, axis=1) / ARCSEC_RAD
    assert np.all((off > 0.1) & (off < 60.0))
    read = np.abs(visits.reading_rad - visits.true_rad) / ARCSEC_RAD
    assert np.all((read > 0.0) & (read < 10.0))
