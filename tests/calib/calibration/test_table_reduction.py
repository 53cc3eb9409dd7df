"""The joint calibration: exact data give the bench back; what does not fit is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.star_bench import StarBench, aiming_angles, star_direction
from calib.calibration.table_axes import TableAxes
from calib.calibration.table_reduction import (
    PoseData,
    calibrate_on_table,
    calibrated_bench,
    check_count,
    check_fit,
    check_parity,
)
from calib.cameras import BrownConrady, SensorGeometry
from optics.errors import DomainError
from optics.units import ARCSEC_RAD

SENSOR = SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055)
MODEL = BrownConrady.create(SENSOR, focal_length_mm=40.0, x0_px=5.0, y0_px=-3.0, q1_per_mm2=1e-5, p2_per_mm=1e-6)
START = BrownConrady.create(SENSOR, focal_length_mm=38.0)
AHEAD = np.array([0.0, 0.0, 1.0])
LEAN_ARCSEC = 8.0
BELIEVED = TableAxes.create("xy", reading_noise_arcsec=0.3)


@pytest.fixture(scope="module")
def bench() -> StarBench:
    return StarBench(
        table=TableAxes.create("xy", non_orthogonality_arcsec=LEAN_ARCSEC, reading_noise_arcsec=0.3),
        star=star_direction(0.5, -0.4),
        installation=Rotation.from_rotvec([0.01, 0.02, -0.05]),
    )


@pytest.fixture(scope="module")
def exact(bench: StarBench) -> PoseData:
    """81 places over the detector, without noise."""
    angle = aiming_angles(bench, MODEL.unproject(SENSOR.grid_px(9)), np.zeros(81))
    covariance = np.tile(np.array([[4e-4, 1e-4], [1e-4, 2e-4]]), (81, 1, 1))
    return PoseData(pixel_px=MODEL.project(bench.star_in_cam(angle)), covariance_px2=covariance, reading_rad=angle)


def test_exact_data_give_the_bench_back(bench: StarBench, exact: PoseData) -> None:
    """The estimator is linear in the lean: (8 arcsec)^2 is 1.5e-9 rad."""
    check_parity(exact, BELIEVED, START, AHEAD)
    calibration = calibrate_on_table(exact, BELIEVED, START, leans=True)
    check_fit(calibration, "exact", "")
    found = calibrated_bench(calibration, BELIEVED)
    assert found.table.non_orthogonality_arcsec[0] * ARCSEC_RAD == pytest.approx(LEAN_ARCSEC * ARCSEC_RAD, abs=2e-7)
    np.testing.assert_allclose(found.star, bench.star, atol=1e-7)
    np.testing.assert_allclose(
        calibration.model.project(found.star_in_cam(exact.reading_rad)), exact.pixel_px, atol=1e-3
    )


def test_known_moves_of_the_data_come_back_with_their_sign(bench: StarBench, exact: PoseData) -> None:
    """Images: the principal point. Outer reading: the star about that axis. Inner one: the installation, A -> A R.

    All three hold exactly.
    """
    shift, outer, inner = np.array([0.9, -0.6]), 60.0 * ARCSEC_RAD, -40.0 * ARCSEC_RAD
    moved = replace(exact, pixel_px=exact.pixel_px + shift, reading_rad=exact.reading_rad + np.array([outer, inner]))
    before, after = (calibrate_on_table(data, BELIEVED, START, leans=True) for data in (exact, moved))
    for name, size in zip(("x0_px", "y0_px"), shift, strict=True):
        assert after.model.value(name) - before.model.value(name) == pytest.approx(size, rel=1e-3)
    first, second = (calibrated_bench(one, BELIEVED) for one in (before, after))
    np.testing.assert_allclose(
        second.star, Rotation.from_rotvec([outer, 0, 0]).apply(first.star.copy()), atol=1e-3 * outer
    )
    mount = first.installation * Rotation.from_rotvec(inner * bench.table.true_axis[1])
    np.testing.assert_allclose((second.installation * mount.inv()).as_rotvec(), 0.0, atol=1e-3 * abs(inner))


@pytest.mark.parametrize("believed", ["x-y", "-xy", "yx"])
def test_mirrored_axes_are_refused(believed: str, exact: PoseData) -> None:
    with pytest.raises(DomainError, match="mirrored"):
        check_parity(exact, TableAxes.create(believed), START, AHEAD)


def test_a_believed_table_that_points_away(exact: PoseData) -> None:
    data = replace(exact, reading_rad=np.linspace([-2.5, 0.0], [2.5, 0.0], 81))
    with pytest.raises(DomainError, match="behind the camera"):
        check_parity(data, BELIEVED, START, AHEAD)


def test_too_few_places() -> None:
    with pytest.raises(DomainError, match="7 places give 14 measurements for 14 unknowns"):
        check_count(7, BELIEVED)
    check_count(8, BELIEVED)


def test_a_fit_that_does_not_fit_is_no_result(exact: PoseData) -> None:
    wrong = replace(exact, pixel_px=np.roll(exact.pixel_px, 1, axis=0))
    with pytest.raises(DomainError, match=r"times their noise; check order and signs"):
        check_fit(calibrate_on_table(wrong, BELIEVED, START, leans=True), "wrong", "check order and signs")
