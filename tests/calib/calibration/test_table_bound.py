"""The bound against a closed form, against the estimator's own covariance, and against what must hold of any bound."""

import numpy as np
import pytest
from star_bench_scene import MODEL, SENSOR, square_bench, star_bench

from calib.calibration.star_bench import aiming_angles, reading_covariance_px2
from calib.calibration.table_bound import map_error_by_noise, table_bound
from calib.calibration.table_reduction import PoseData, calibrate_on_table
from calib.cameras import BrownConrady
from optics.units import ARCSEC_RAD

SIGMA_PX = 0.01


def _setup(axes):
    bench = star_bench(axes, 20.0, 0.3)
    direction = MODEL.unproject(SENSOR.grid_px(9))
    angle = aiming_angles(bench, direction, np.asarray(np.arange(len(direction)) % 4 * (np.pi / 2)))
    covariance = np.tile(np.eye(2) * SIGMA_PX**2, (len(direction), 1, 1))
    return bench, direction, angle, covariance


@pytest.mark.parametrize("field_deg", [3.0, 6.0])
def test_principal_point_in_closed_form(field_deg):
    """Only principal point, focal length and installation unknown: sigma / sqrt(n <t^4>), <t^4> of a square grid.
    Second order in the field: the next term is t^2, 0.3 % at 6 deg."""
    model, plain = BrownConrady.of_field(SENSOR, field_deg), ("x0_px", "y0_px", "focal_length_mm")
    assert model.unproject([[-0.5, 1023.5]])[0] @ model.unproject([[2047.5, 1023.5]])[0] == pytest.approx(
        np.cos(np.radians(field_deg))
    )
    bench = square_bench()
    direction = model.unproject(SENSOR.grid_px(13))
    covariance = np.tile(np.eye(2) * SIGMA_PX**2, (169, 1, 1))
    angle = aiming_angles(bench, direction, np.zeros(169))
    found = table_bound(model, bench, angle, covariance, direction, leans=False, star=False, free=plain)
    t = (SENSOR.grid_px(13)[:, 0] - SENSOR.centre_px[0]) * 0.0055 / model.value("focal_length_mm")
    # what tells a shift from a turn apart is (t_x^2, t_x t_y) less its mean: its mean square is that of t^4
    assert found.of("x0_px") == pytest.approx(SIGMA_PX / np.sqrt(169 * np.mean(t**4)), rel=0.005)
    assert found.of("y0_px") == pytest.approx(found.of("x0_px"), rel=1e-3)


@pytest.mark.parametrize("axes", ["xy", "xyz"])
def test_bound_is_the_covariance_of_the_estimator(axes):
    """Two ways to the same: readings carried to the images here, readings as unknowns with a prior there."""
    bench, direction, angle, covariance = _setup(axes)
    angle = angle + 5.0 * ARCSEC_RAD * np.random.default_rng(1).standard_normal(angle.shape)
    noise = covariance + reading_covariance_px2(MODEL, bench, angle)
    found = table_bound(MODEL, bench, angle, noise, direction, leans=True)
    # exact data: the estimator's covariance is that at the truth
    data = PoseData(pixel_px=MODEL.project(bench.star_in_cam(angle)), covariance_px2=covariance, reading_rad=angle)
    calibration = calibrate_on_table(data, bench.table.nominal, MODEL, leans=True, start_star=np.array(bench.star))
    assert calibration.converged
    assert calibration.solution.names == found.names
    np.testing.assert_allclose(calibration.solution.sigma, found.sigma, rtol=2e-3)


def test_shares_add_up_and_knowledge_never_hurts():
    bench, direction, angle, covariance = _setup("xyz")
    noise = covariance + reading_covariance_px2(MODEL, bench, angle)
    total = table_bound(MODEL, bench, angle, noise, direction, leans=True)
    shares = map_error_by_noise(MODEL, bench, angle, covariance, direction)
    assert set(shares) == {"centroids", *(f"readings, {name} axis" for name in ("outer", "middle", "inner"))}
    assert np.sqrt(sum(v**2 for v in shares.values())) == pytest.approx(total.map_sigma_arcsec, rel=1e-6)
    for known in ({"leans": False}, {"star": False}, {"free": MODEL.parameter_names[:6]}):
        better = table_bound(MODEL, bench, angle, noise, direction, **({"leans": True} | known))
        assert better.map_sigma_arcsec <= total.map_sigma_arcsec * (1 + 1e-9)
    assert min(total.inflation(name) for name in total.names[:8]) >= 1.0
