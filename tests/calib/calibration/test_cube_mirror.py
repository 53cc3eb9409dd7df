"""Conventions and reduction of the cube mirror: published angles, light really reflected, covariance."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.attitude.triad import angle_between_rad
from calib.calibration import cube_mirror
from calib.calibration.table_axes import TableAxes

TABLE = TableAxes.create("xy")
TABLE1 = ((181.398, 0.528), (91.386, -0.048))


def degrees_between(pairs):
    return np.degrees(angle_between_rad(*(cube_mirror.normal_in_table(TABLE, np.radians(pair)) for pair in pairs)))


def test_faces_of_table_1():
    """SCIENCE: with the beam along (0, 0, 1) for both faces, Table 1 as headed gives 90.0121 deg."""
    assert degrees_between(TABLE1) == pytest.approx(90.0121, abs=5e-5)
    assert degrees_between([(b, a) for a, b in TABLE1]) == pytest.approx(90.0124, abs=5e-5)  # inner axis turns by 90
    # eq. 8 as printed, with n2 on the right-hand side: the two normals would be half a degree apart
    first = cube_mirror.normal_in_table(TABLE, np.radians(TABLE1[0]))
    second = cube_mirror.normal_in_table(TABLE, np.radians(TABLE1[1]), [0.0, 1.0, 0.0])
    assert np.degrees(angle_between_rad(first, second)) == pytest.approx(0.58, abs=0.01)


def test_light_in_the_table_frame_is_the_written_out_one():
    """CUBE09 eq. 7: r = (-sin b cos a, sin a, cos b cos a) for outer angle a, inner angle b."""
    a, b = np.radians([[20.0, -7.0], [30.0, 91.0]])
    for one, other in zip(a, b, strict=True):
        written = [-np.sin(other) * np.cos(one), np.sin(one), np.cos(other) * np.cos(one)]
        assert cube_mirror.normal_in_table(TABLE, [one, other]) == pytest.approx(written)


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 180.0, 270.0])
def test_concentric_angles_turn_a_normal_to_the_light(turn_deg):
    """On a crooked table too, from the nominal angles of any face."""
    table, angle = TableAxes.create("xy", non_orthogonality_arcsec=200.0), np.radians([0.7, turn_deg - 1.1])
    normal = cube_mirror.normal_in_table(table, angle)
    assert cube_mirror.concentric_angles(table, normal, np.radians([0.0, turn_deg])) == pytest.approx(angle, abs=1e-9)


def test_stop_rule_played():
    """A perfect operator leaves what the table's steps leave: uniform within half a step; N = 40000. Without steps and
    noise nothing is left of what was beyond the limit, else at most the limit."""
    rule = {"stop_px": 1.0, "settings": 20, "count": 40000}
    left = cube_mirror.trimmed_offset_px(500.0, 1.5, 0.0, gain=1.0, rng=np.random.default_rng(1), **rule)
    assert left == pytest.approx([1.5 / np.sqrt(12)] * 2, rel=0.02)
    coarse = cube_mirror.trimmed_offset_px(500.0, 1.5, 0.0, gain=0.5, rng=np.random.default_rng(1), **rule)
    assert np.all(coarse > left)
    smooth = cube_mirror.trimmed_offset_px(20.0, 0.0, 0.0, gain=1.0, rng=np.random.default_rng(2), **rule)
    assert smooth == pytest.approx([np.sqrt(1.0 / 20.0**2 / 3.0)] * 2, rel=0.15)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.3, -0.2), (-5.0, 8.0)])
def test_normal_that_sends_the_light_there(offset):
    """Light along -Z, reflected by the normal, lands at the offset after 650 mm."""
    normal = cube_mirror.normal_of_offset(offset, 650.0)
    light = np.array([0.0, 0.0, -1.0])
    back = light - 2 * (light @ normal) * normal
    assert back[:2] / back[2] * 650.0 == pytest.approx(offset, abs=1e-10)
    assert np.degrees(cube_mirror.pixel_angle_rad(0.015, 650.0)) * 3600 == pytest.approx(2.38, abs=5e-3)


def test_sun_vectors_arrive_in_the_cube_frame():
    """eq. 12 by construction: a direction fixed in the laboratory, seen by the sensor, is where the cube says it is."""
    rng = np.random.default_rng(2)
    cube_from, sensor_from = Rotation.random(2, rng=rng)
    normals = cube_from.inv().apply([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    solution = cube_mirror.cube_from_table([[0, 0, 1], [1, 0, 0]], normals, covariance_rad2=np.zeros((2, 3, 3)))
    rotation, _ = cube_mirror.sensor_to_cube(solution, sensor_from, np.zeros((3, 3)))
    table = TABLE.rotation([[0.2, -0.4]])[0]
    sun = table.inv().apply([0.1, 0.2, 0.97])
    assert rotation.apply(sensor_from.apply(sun)) == pytest.approx(cube_from.apply(sun), abs=1e-12)
    assert solution.face_angle_rad == pytest.approx(np.pi / 2)


def test_covariance_of_weighted_faces_is_the_scatter():
    """400 noisy pairs of faces 88 deg apart: variances agree to 4 sqrt(2/400) = 0.28 of themselves."""
    rng = np.random.default_rng(3)
    turn = Rotation.from_rotvec([2.0, 0.4, -1.1])
    known = np.array([[0.0, 0.0, 1.0], [np.sin(np.radians(88)), 0.0, np.cos(np.radians(88))]])
    true, sigma = turn.inv().apply(known), np.array([1e-5, 2e-5])
    spread = sigma[:, None, None] ** 2 * (np.eye(3) - true[:, :, None] * true[:, None, :])
    errors = []
    for _ in range(400):
        noisy = true + sigma[:, None] * rng.standard_normal((2, 3))
        noisy /= np.linalg.norm(noisy, axis=1)[:, None]
        found = cube_mirror.cube_from_table(known, noisy, covariance_rad2=spread, method="wahba")
        errors.append(cube_mirror.rotation_error_rad(found.rotation, turn))
    assert np.var(errors, axis=0) == pytest.approx(np.diag(found.covariance_rad2), rel=0.28)
    assert np.mean(errors, axis=0) == pytest.approx([0, 0, 0], abs=4 * 2e-5 / 20)


def test_an_error_of_the_sensor_is_carried_into_the_cube_frame():
    """A small turn of the sensor, oblique to all axes: the covariance of rank one that it has, sent through, is that of
    the error which it really makes."""
    turn = Rotation.from_rotvec([0.4, -0.9, 1.3])
    normals = turn.inv().apply([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    cube = cube_mirror.cube_from_table([[0, 0, 1], [1, 0, 0]], normals, covariance_rad2=np.zeros((2, 3, 3)))
    sensor, error = Rotation.from_rotvec([-0.2, 0.7, 0.5]), np.array([1e-5, 3e-5, -7e-5])
    exact, _ = cube_mirror.sensor_to_cube(cube, sensor, np.zeros((3, 3)))
    disturbed, covariance = cube_mirror.sensor_to_cube(
        cube, Rotation.from_rotvec(error) * sensor, np.outer(error, error)
    )
    made = cube_mirror.rotation_error_rad(disturbed, exact)
    assert covariance == pytest.approx(np.outer(made, made), abs=1e-13)


def test_repeats_are_averaged_and_more_faces_weighted():
    turn = Rotation.from_rotvec([0.0, np.pi, 0.1])
    known = np.array([[0, 0, 1.0], [0, 0, 1.0], [1.0, 0, 0], [-1.0, 0, 0]])
    spread = np.broadcast_to(1e-10 * np.eye(3), (4, 3, 3))
    table = turn.inv().apply(known)
    twice = cube_mirror.cube_from_table(known[:3], table[:3], covariance_rad2=spread[:3])
    once = cube_mirror.cube_from_table(known[1:3], table[1:3], covariance_rad2=spread[1:3])
    assert twice.covariance_rad2[0, 0] == pytest.approx(once.covariance_rad2[0, 0] / 2)
    all_faces = cube_mirror.cube_from_table(known, table, covariance_rad2=spread, method="wahba")
    assert cube_mirror.rotation_error_rad(all_faces.rotation, turn) == pytest.approx([0, 0, 0], abs=1e-9)
    assert np.trace(all_faces.covariance_rad2) < np.trace(twice.covariance_rad2)


@pytest.mark.parametrize("wrong", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("method", ["triad", "wahba"])
def test_repeated_normals_tell_whether_their_covariance_is_right(method, wrong):
    """Two faces measured eight times each: 2 x 2 x 7 degrees of freedom, one more from the angle of the faces."""
    rng = np.random.default_rng(6)
    faces = np.repeat([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], 8, axis=0)
    across = np.eye(3) - faces[:, :, None] * faces[:, None, :]
    table = faces + 1e-5 * np.einsum("nij,nj->ni", across, rng.standard_normal((16, 3)))
    table /= np.linalg.norm(table, axis=1)[:, None]
    found = cube_mirror.cube_from_table(faces, table, covariance_rad2=(1e-5 * wrong) ** 2 * across, method=method)
    assert found.misfit.degrees_of_freedom == 28 + (method == "wahba")
    assert ("stated too small" in found.misfit.note) == (wrong < 1)
    assert ("stated too large" in found.misfit.note) == (wrong > 1)
