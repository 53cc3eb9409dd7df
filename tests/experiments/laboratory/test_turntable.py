"""The turntable: its convention against hand-worked turns, its derivatives against finite differences, its noise."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.laboratory.devices.turntable import Turntable, build_turntable
from optics.errors import ConfigError, DomainError
from optics.units import ARCSEC_RAD
from render.engine.random import Streams


def test_outer_axis_stays_and_inner_one_is_carried() -> None:
    table = build_turntable("xy")
    quarter = np.pi / 2
    np.testing.assert_allclose(table.rotation([[quarter, 0.0]]).apply([0.0, 1.0, 0.0]), [[0, 0, 1]], atol=1e-15)
    # inner first: z -> x about y; x stays where it is when the outer axis x turns
    np.testing.assert_allclose(table.rotation([[quarter, quarter]]).apply([0.0, 0.0, 1.0]), [[1, 0, 0]], atol=1e-15)
    # the inner axis itself is carried by the outer one: y -> z
    np.testing.assert_allclose(table.rotation([[quarter, 0.7]]).apply([0.0, 1.0, 0.0]), [[0, 0, 1]], atol=1e-15)


def test_three_axes_are_intrinsic_euler_angles() -> None:
    angle = np.random.default_rng(4).uniform(-1, 1, (20, 3))
    expected = Rotation.from_euler("ZXY", angle).as_matrix()
    np.testing.assert_allclose(build_turntable("zxy").rotation(angle).as_matrix(), expected, atol=1e-14)


def test_opposite_sense() -> None:
    angle = np.array([[0.3, -0.2]])
    reversed_table = build_turntable("x-y")
    expected = build_turntable("xy").rotation(angle * [1.0, -1.0]).as_matrix()
    np.testing.assert_allclose(reversed_table.rotation(angle).as_matrix(), expected, atol=1e-15)


def test_axes_enclose_what_is_stated() -> None:
    axis = build_turntable("zxy", non_orthogonality_arcsec=(20.0, -35.0)).true_axis
    for pair, lean in (((0, 1), 20.0), ((1, 2), -35.0)):
        enclosed = np.arccos(axis[pair[0]] @ axis[pair[1]])
        assert (np.pi / 2 - enclosed) / ARCSEC_RAD == pytest.approx(lean, abs=1e-6)
    np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1.0, atol=1e-15)


def _turn_rate(table: Turntable, angle: np.ndarray, later: tuple[Turntable, np.ndarray], step: float) -> np.ndarray:
    return (later[0].rotation(later[1]) * table.rotation(angle).inv()).as_rotvec() / step


def test_rates_are_the_derivatives() -> None:
    leans = (3000.0, -2000.0)
    table = build_turntable("zxy", non_orthogonality_arcsec=leans)
    angle, step = np.random.default_rng(1).uniform(-1.5, 1.5, (6, 3)), 1e-6
    for i in range(3):
        moved = _turn_rate(table, angle, (table, angle + step * np.eye(3)[i]), step)
        np.testing.assert_allclose(moved, table.angle_rates(angle)[:, i], atol=3e-6)
    for i in range(2):
        other = build_turntable("zxy", non_orthogonality_arcsec=np.array(leans) + step / ARCSEC_RAD * np.eye(2)[i])
        moved = _turn_rate(table, angle, (other, angle), step)
        np.testing.assert_allclose(moved, table.lean_rates(angle)[:, i], atol=3e-6)


def test_nothing_wrong_with_it_reads_what_was_asked() -> None:
    angle = np.random.default_rng(0).uniform(-1, 1, (5, 2))
    table = build_turntable("yx")
    true = table.set(angle, Streams(1))
    np.testing.assert_array_equal(true, angle)
    np.testing.assert_array_equal(table.read(true, Streams(1)), angle)


def test_noise_of_setting_and_reading() -> None:
    """N = 20000: a standard deviation is known to 1 / sqrt(2 N) = 0.5 %, four of those are allowed."""
    table = build_turntable("xy", reading_noise_arcsec=(0.3, 0.4), setting_noise_arcsec=2.0)
    asked = np.zeros((20000, 2))
    true = table.set(asked, Streams(3))
    error = (table.read(true, Streams(3)) - true) / ARCSEC_RAD
    np.testing.assert_allclose(error.std(0), [0.3, 0.4], rtol=0.02)
    np.testing.assert_allclose(true.std(0) / ARCSEC_RAD, [2.0, 2.0], rtol=0.02)
    together = np.column_stack([error, true / ARCSEC_RAD])
    assert np.abs(np.corrcoef(together.T) - np.eye(4)).max() < 4 / np.sqrt(20000)


def test_noise_depends_on_nothing_but_its_place() -> None:
    table = build_turntable("xy", reading_noise_arcsec=1.0)
    long, short = (table.read(np.zeros((n, 2)), Streams(3)) for n in (9, 4))
    np.testing.assert_array_equal(long[:4], short)
    assert not np.array_equal(short, table.read(np.zeros((4, 2)), Streams(3), call=1))


def test_steps_and_encoder_wave() -> None:
    table = build_turntable(
        "xy", step_arcsec=(10.0, 0.0), encoder_amplitude_arcsec=(2.0, 0.0), encoder_cycles=(3.0, 1.0)
    )
    asked = np.array([[14.0, 14.0], [16.0, 16.0]]) * ARCSEC_RAD
    np.testing.assert_allclose(table.set(asked, Streams(0)) / ARCSEC_RAD, [[10, 14], [20, 16]], atol=1e-9)
    angle = np.array([[np.pi / 6, np.pi / 6]])  # sin(3 * 30 deg) = 1
    np.testing.assert_allclose((table.read(angle, Streams(0)) - angle) / ARCSEC_RAD, [[2.0, 0.0]], atol=1e-9)


@pytest.mark.parametrize(
    ("axes", "options", "words"),
    [
        ("x", {}, "1 axes; a table of 2 or 3"),
        ("xyzx", {}, "4 axes"),
        ("xx", {}, "enclose 0.000000 deg"),
        ([[1, 0, 0], [0, 2, 0]], {}, "length 2"),
        ("xy", {"reading_noise_arcsec": -0.3}, "must not be negative"),
        ("xy", {"reading_noise_arcsec": (0.3, 0.3, 0.3)}, "shape"),
        ("xy", {"reading_noise_arcsec": np.nan}, "finite"),
        ("xy", {"non_orthogonality_arcsec": 40000.0}, "at most 36000 arcsec"),
    ],
)
def test_bad_tables(axes: object, options: dict, words: str) -> None:
    with pytest.raises(DomainError, match=words):
        build_turntable(axes, **options)


@pytest.mark.parametrize("axes", ["", "xq", "x-", "--x", "1"])
def test_unreadable_axes(axes: str) -> None:
    with pytest.raises(ConfigError, match="letters x, y, z"):
        build_turntable(axes)


@pytest.mark.parametrize("angle", [[0.0, 0.0], [[0.0]], [[0.0, np.nan]]])
def test_bad_angles(angle: list) -> None:
    with pytest.raises(DomainError):
        build_turntable("xy").rotation(angle)
