"""Geometry of the bench and its derivatives: matrices by hand, finite differences, closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from star_bench_scene import MODEL, SENSOR, square_bench, star_bench

from calib.calibration.star_bench import (
    aiming_angles,
    clock_covariance_px2,
    design_matrix,
    direction_by_angle,
    direction_by_lean,
    reading_covariance_px2,
    residual_px,
    star_angles_deg,
    star_direction,
    star_vector_by_pixel,
    star_vectors,
    true_unknowns,
    unknown_names,
)
from calib.cameras import BrownConrady
from calib.directional.vector_scatter import vector_sigma_arcsec
from optics.frames import field_direction
from optics.units import ARCSEC_RAD, RAD_ARCSEC


def test_star_angles_and_direction_are_inverse():
    np.testing.assert_allclose(star_direction(0.0, 0.0), [0, 0, 1])
    assert star_direction(90.0, 0.0) @ [1, 0, 0] == pytest.approx(1.0)
    assert star_direction(0.0, 90.0) @ [0, 1, 0] == pytest.approx(1.0)
    angles = np.array([[12.0, -33.0], [-50.0, 4.0]])
    np.testing.assert_allclose(star_angles_deg(star_direction(*angles.T)), angles, atol=1e-12)


@pytest.mark.parametrize("axes", ["xy", "yx", "x-y", "xyz"])
def test_the_star_appears_where_it_was_wanted(axes):
    bench = star_bench(axes, lean=30.0)
    field = np.array([[3.0, -2.0], [-15.0, 0.1], [0.0, 18.0]])
    wanted = field_direction(*field.T)
    angle = aiming_angles(bench, wanted, np.radians([0.0, 90.0, 200.0]))
    np.testing.assert_allclose(bench.star_in_cam(angle), wanted, atol=1e-11)
    if len(axes) == 3 and axes != "x-y":
        np.testing.assert_allclose(np.degrees(angle[:, 2]), [0, 90, 200])


def test_turning_the_table_right_handed_moves_the_star_left_handed():
    """Camera square on the table: a turn about +X brings +Y_cam towards Z, the star at +Z goes to -Y_cam... by hand."""
    seen = square_bench().star_in_cam(np.array([[0.1, 0.0], [0.0, 0.1]]))
    np.testing.assert_allclose(seen, [[0, np.sin(0.1), np.cos(0.1)], [-np.sin(0.1), 0, np.cos(0.1)]], atol=1e-15)


@pytest.mark.parametrize(("axes", "outer", "inner"), [("xy", [1, 0, 0], [0, 1, 0]), ("y-x", [0, 1, 0], [-1, 0, 0])])
def test_what_the_camera_sees_in_matrices(axes, outer, inner):
    """v = A T^T s; the inner axis leans towards the outer one (FISHER23 eq. 1-6)."""
    lean, first, second = 400.0 * ARCSEC_RAD, 0.2, -0.3
    carried = np.cos(lean) * np.array(inner) + np.sin(lean) * np.array(outer)
    turns = [Rotation.from_rotvec(angle * np.array(axis)) for angle, axis in ((first, outer), (second, carried))]
    bench = star_bench(axes, lean=400.0)
    table = turns[0].as_matrix() @ turns[1].as_matrix()
    expected = bench.installation.as_matrix() @ table.T @ bench.star
    np.testing.assert_allclose(bench.star_in_cam(np.array([[first, second]]))[0], expected, atol=1e-14)


def test_effects_are_the_derivatives():
    bench, step = star_bench("xyz", lean=500.0), 1e-6
    angle = np.random.default_rng(3).uniform(-0.5, 0.5, (7, 3))
    for i in range(3):
        ahead, behind = (bench.star_in_cam(angle + sign * step * np.eye(3)[i]) for sign in (1, -1))
        moved = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(direction_by_angle(bench, angle)[:, i], moved, atol=1e-9)
    for i in range(2):
        low, high = (
            star_bench("xyz", lean=np.full(2, 500.0) + sign * step / ARCSEC_RAD * np.eye(2)[i]) for sign in (-1, 1)
        )
        moved = (high.star_in_cam(angle) - low.star_in_cam(angle)) / (2 * step)
        np.testing.assert_allclose(direction_by_lean(bench, angle)[:, i], moved, atol=1e-9)


@pytest.mark.parametrize("axes", ["xy", "xyz"])
def test_design_is_the_derivative(axes):
    """Against finite differences of the whole chain, in the estimator's unknowns."""
    bench, step = star_bench(axes, lean=20.0), 1e-6
    angle = aiming_angles(bench, MODEL.unproject(SENSOR.grid_px(4)), np.arange(16) % 4 * (np.pi / 2))
    columns = design_matrix(MODEL, bench, angle, leans=True)
    first_lean = step / ARCSEC_RAD * np.eye(len(axes) - 1)[0]
    for column, moved in (
        (8, star_bench(axes, lean=20.0, azimuth_deg=0.3 + np.degrees(step))),
        (13, star_bench(axes, lean=20.0 + first_lean)),
    ):
        slope = (MODEL.project(moved.star_in_cam(angle)) - MODEL.project(bench.star_in_cam(angle))) / step
        np.testing.assert_allclose(columns[:, :, column], slope, rtol=1e-4, atol=0.05)


def test_reading_noise_on_the_axis_is_pixels_over_the_plate_scale():
    plain = BrownConrady.create(SENSOR, focal_length_mm=40.0)
    found = reading_covariance_px2(plain, square_bench(reading=(1.0, 2.0)), np.zeros((1, 2)))[0]
    arcsec_px = 40.0 / 0.0055 * ARCSEC_RAD
    np.testing.assert_allclose(np.sqrt(np.diagonal(found)), [2.0 * arcsec_px, 1.0 * arcsec_px], rtol=1e-9)
    assert abs(found[0, 1]) < 1e-12


def test_star_vectors_and_their_derivatives():
    """At the true image every vector is the star; the derivative against differences of the unprojected vectors."""
    bench = star_bench(lean=4.0)
    angle = aiming_angles(bench, MODEL.unproject(SENSOR.grid_px(5)), np.zeros(25))
    pixel = MODEL.project(bench.star_in_cam(angle))
    np.testing.assert_allclose(star_vectors(MODEL, bench, pixel, angle), np.tile(bench.star, (25, 1)), atol=1e-12)
    np.testing.assert_allclose(residual_px(MODEL, bench, pixel + 0.25, angle), 0.25, atol=1e-9)
    by_pixel = star_vector_by_pixel(MODEL, bench, angle)
    for axis, step in enumerate(0.01 * np.eye(2)):
        ahead, behind = (star_vectors(MODEL, bench, pixel + sign * step, angle) for sign in (1, -1))
        length = np.linalg.norm(ahead - behind, axis=1) / 0.02
        np.testing.assert_allclose(length, np.linalg.norm(by_pixel[:, :, axis], axis=1), rtol=1e-6)


def test_jitter_of_the_clocks_moves_vectors_across_the_second_axis():
    """The second axis, Y carried by a turn about X, stands nearly across the star: the error is in one of two axes."""
    bench = star_bench(reading=(0.2, 0.5))
    angle = aiming_angles(bench, MODEL.unproject(SENSOR.grid_px(7)), np.zeros(49))
    by_pixel = star_vector_by_pixel(MODEL, bench, angle)
    found = vector_sigma_arcsec(by_pixel, clock_covariance_px2(MODEL, bench, angle, -1e-3, 2e-3))
    carried = Rotation.from_rotvec(angle[:, :1] * [1.0, 0.0, 0.0]).apply(bench.table.true_axis[1])
    part = np.mean(1.0 - (carried @ bench.star) ** 2)
    assert found == pytest.approx(2e-6 * RAD_ARCSEC * np.sqrt(part / 2), rel=1e-9)


def test_unknowns_have_names_and_values():
    bench = star_bench("xyz", lean=(20.0, -30.0))
    names, values = unknown_names(MODEL, bench, leans=True), true_unknowns(MODEL, bench, leans=True)
    known = dict(zip(names, values, strict=True))
    assert known["x0_px"] == 5.0
    assert known["lean2_rad"] == pytest.approx(-30.0 * ARCSEC_RAD)
    assert np.degrees(known["star_azimuth_rad"]) == pytest.approx(0.3)
    assert len(unknown_names(MODEL, bench, leans=False)) == len(true_unknowns(MODEL, bench, leans=False)) == 13
