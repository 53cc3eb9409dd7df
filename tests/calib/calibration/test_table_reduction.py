"""The joint calibration: exact data give the bench back; what does not fit is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from star_bench_scene import MODEL, SENSOR, star_bench

from calib.calibration import table_reduction
from calib.calibration.star_bench import aiming_angles
from calib.calibration.table_axes import TableAxes
from calib.cameras import BrownConrady
from optics.units import ARCSEC_RAD

START = BrownConrady.create(SENSOR, focal_length_mm=38.0)
AHEAD = np.array([0.0, 0.0, 1.0])
LEAN_ARCSEC = 8.0
BELIEVED = TableAxes.create("xy", reading_noise_arcsec=0.3)


@pytest.fixture(scope="module")
def bench():
    return star_bench("xy", LEAN_ARCSEC, 0.3)


@pytest.fixture(scope="module")
def exact(bench):
    """81 places over the detector, without noise."""
    angle = aiming_angles(bench, MODEL.unproject(SENSOR.grid_px(9)), np.zeros(81))
    covariance = np.tile(np.array([[4e-4, 1e-4], [1e-4, 2e-4]]), (81, 1, 1))
    return table_reduction.PoseData(
        pixel_px=MODEL.project(bench.star_in_cam(angle)), covariance_px2=covariance, reading_rad=angle
    )


def test_exact_data_give_the_bench_back(bench, exact):
    """The estimator is linear in the lean: (8 arcsec)^2 is 1.5e-9 rad."""
    table_reduction.check_count(8, BELIEVED)
    table_reduction.check_parity(exact, BELIEVED, START, AHEAD)
    calibration = table_reduction.calibrate_on_table(exact, BELIEVED, START, leans=True)
    table_reduction.check_fit(calibration, "exact", "")
    found = table_reduction.calibrated_bench(calibration, BELIEVED)
    assert found.table.non_orthogonality_arcsec[0] * ARCSEC_RAD == pytest.approx(LEAN_ARCSEC * ARCSEC_RAD, abs=2e-7)
    np.testing.assert_allclose(found.star, bench.star, atol=1e-7)
    np.testing.assert_allclose(
        calibration.model.project(found.star_in_cam(exact.reading_rad)), exact.pixel_px, atol=1e-3
    )


def test_known_moves_of_the_data_come_back_with_their_sign(bench, exact):
    """Images: the principal point. Outer reading: the star about that axis. Inner one: the installation, A -> A R.
    All three hold exactly."""
    shift, outer, inner = np.array([0.9, -0.6]), 60.0 * ARCSEC_RAD, -40.0 * ARCSEC_RAD
    moved = replace(exact, pixel_px=exact.pixel_px + shift, reading_rad=exact.reading_rad + np.array([outer, inner]))
    before, after = (table_reduction.calibrate_on_table(data, BELIEVED, START, leans=True) for data in (exact, moved))
    for name, size in zip(("x0_px", "y0_px"), shift, strict=True):
        assert after.model.value(name) - before.model.value(name) == pytest.approx(size, rel=1e-3)
    first, second = (table_reduction.calibrated_bench(one, BELIEVED) for one in (before, after))
    np.testing.assert_allclose(
        second.star, Rotation.from_rotvec([outer, 0, 0]).apply(first.star.copy()), atol=1e-3 * outer
    )
    mount = first.installation * Rotation.from_rotvec(inner * bench.table.true_axis[1])
    np.testing.assert_allclose((second.installation * mount.inv()).as_rotvec(), 0.0, atol=1e-3 * abs(inner))
