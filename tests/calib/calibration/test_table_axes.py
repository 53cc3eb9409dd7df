"""Axes of a turntable: convention against hand-worked turns, derivatives against finite differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.table_axes import TableAxes
from optics.units import ARCSEC_RAD


def test_outer_axis_stays_inner_one_is_carried_and_both_enclose_what_is_stated() -> None:
    table = TableAxes.create("xy")
    quarter = np.pi / 2
    np.testing.assert_allclose(table.rotation([[quarter, 0.0]]).apply([0.0, 1.0, 0.0]), [[0, 0, 1]], atol=1e-15)
    # inner first: z -> x about y; x stays where it is when the outer axis x turns
    np.testing.assert_allclose(table.rotation([[quarter, quarter]]).apply([0.0, 0.0, 1.0]), [[1, 0, 0]], atol=1e-15)
    # the inner axis itself is carried by the outer one: y -> z
    np.testing.assert_allclose(table.rotation([[quarter, 0.7]]).apply([0.0, 1.0, 0.0]), [[0, 0, 1]], atol=1e-15)
    axis = TableAxes.create("zxy", non_orthogonality_arcsec=(20.0, -35.0)).true_axis
    for pair, lean in (((0, 1), 20.0), ((1, 2), -35.0)):
        enclosed = np.arccos(axis[pair[0]] @ axis[pair[1]])
        assert (np.pi / 2 - enclosed) / ARCSEC_RAD == pytest.approx(lean, abs=1e-6)
    np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1.0, atol=1e-15)


def test_three_axes_are_intrinsic_euler_angles_and_a_minus_turns_the_sense() -> None:
    angle = np.random.default_rng(4).uniform(-1, 1, (20, 3))
    expected = Rotation.from_euler("ZXY", angle).as_matrix()
    np.testing.assert_allclose(TableAxes.create("zxy").rotation(angle).as_matrix(), expected, atol=1e-14)
    angle = np.array([[0.3, -0.2]])
    reversed_table = TableAxes.create("x-y")
    expected = TableAxes.create("xy").rotation(angle * [1.0, -1.0]).as_matrix()
    np.testing.assert_allclose(reversed_table.rotation(angle).as_matrix(), expected, atol=1e-15)


def _turn_rate(table: TableAxes, angle: np.ndarray, later: tuple[TableAxes, np.ndarray], step: float) -> np.ndarray:
    return (later[0].rotation(later[1]) * table.rotation(angle).inv()).as_rotvec() / step


def test_rates_are_the_derivatives() -> None:
    leans = (3000.0, -2000.0)
    table = TableAxes.create("zxy", non_orthogonality_arcsec=leans)
    angle, step = np.random.default_rng(1).uniform(-1.5, 1.5, (6, 3)), 1e-6
    for i in range(3):
        moved = _turn_rate(table, angle, (table, angle + step * np.eye(3)[i]), step)
        np.testing.assert_allclose(moved, table.angle_rates(angle)[:, i], atol=3e-6)
    for i in range(2):
        other = TableAxes.create("zxy", non_orthogonality_arcsec=np.array(leans) + step / ARCSEC_RAD * np.eye(2)[i])
        moved = _turn_rate(table, angle, (other, angle), step)
        np.testing.assert_allclose(moved, table.lean_rates(angle)[:, i], atol=3e-6)
