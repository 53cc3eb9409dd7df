"""The bound against a closed form, against the estimator's own covariance, and against what must hold of any bound."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.cameras import BrownConrady, SensorGeometry
from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.bench import Bench, aim, visit
from experiments.laboratory.single_star.derivatives import reading_covariance_px2
from experiments.laboratory.single_star.reduce import Data, reduce_data
from experiments.laboratory.single_star.star import star_direction
from experiments.turntable.bound import bound, knowledge, noise_shares
from experiments.turntable.fields import SWEEP_SIDE, field_sweep, ideal_bound, ideal_camera
from optics.errors import DomainError
from render.engine.random import Streams

SENSOR = SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055)
MODEL = BrownConrady.create(SENSOR, focal_length_mm=40.0, x0_px=5.0, y0_px=-3.0, q1_per_mm2=1e-4, p1_per_mm=1e-5)
SIGMA_PX = 0.01


def _bench(axes: str) -> Bench:
    return Bench(
        table=build_turntable(axes, non_orthogonality_arcsec=20.0, reading_noise_arcsec=0.3),
        star=star_direction(0.5, -0.4),
        installation=Rotation.from_rotvec([0.01, 0.02, -0.05]),
    )


def _setup(axes: str, side: int = 9):
    bench = _bench(axes)
    direction = MODEL.unproject(SENSOR.grid_px(side))
    angle = aim(bench, direction, np.asarray(np.arange(len(direction)) % 4 * (np.pi / 2)))
    covariance = np.tile(np.eye(2) * SIGMA_PX**2, (len(direction), 1, 1))
    return bench, direction, angle, covariance


@pytest.mark.parametrize("field_deg", [3.0, 6.0])
def test_principal_point_in_closed_form(field_deg: float) -> None:
    """Only principal point, focal length and installation unknown: sigma / sqrt(n <t^4>), <t^4> of a square grid.

    Second order in the field: the next term is t^2, 0.3 % at 6 deg.
    """
    model, plain = ideal_camera(field_deg), ("x0_px", "y0_px", "focal_length_mm")
    found = ideal_bound(model, "xy", SIGMA_PX, star=False, free=plain)
    t = (model.geometry.grid_px(SWEEP_SIDE)[:, 0] - model.geometry.centre_px[0]) * 0.0055 / model.value(plain[2])
    # what tells a shift from a turn apart is (t_x^2, t_x t_y) less its mean: its mean square is that of t^4
    assert found.of("x0_px") == pytest.approx(SIGMA_PX / np.sqrt(SWEEP_SIDE**2 * np.mean(t**4)), rel=0.005)
    assert found.of("y0_px") == pytest.approx(found.of("x0_px"), rel=1e-3)


def test_principal_point_falls_with_the_square_of_the_field_and_the_line_of_sight_does_not() -> None:
    narrow, wide = field_sweep([3.0, 6.0], SIGMA_PX)
    for point, line in (("principal_point_sigma_px", "line_arcsec"), ("rolled_point_px", "rolled_line_arcsec")):
        assert getattr(narrow, point) / getattr(wide, point) == pytest.approx(4.0, rel=0.03)
        in_images = [getattr(one, line) / one.image_arcsec for one in (narrow, wide)]
        assert in_images[0] == pytest.approx(in_images[1], rel=0.03)
        assert in_images[1] < 1.0 / np.sqrt(2.0)
    assert narrow.point_over_line > 100


@pytest.mark.parametrize("axes", ["xy", "xyz"])
def test_bound_is_the_covariance_of_the_estimator(axes: str) -> None:
    """Two ways to the same: readings carried to the images here, readings as unknowns with a prior there."""
    bench, direction, angle, covariance = _setup(axes)
    visits = visit(
        bench, SENSOR.grid_px(9), direction, np.asarray(np.arange(81) % 4 * (np.pi / 2)), Streams(1), readings=1
    )
    angle = np.array(visits.true_rad)
    noise = covariance + reading_covariance_px2(MODEL, bench, angle)
    found = bound(MODEL, bench, angle, noise, direction, leans=True)
    # exact data: the estimator's covariance is that at the truth
    data = Data(pixel_px=MODEL.project(bench.seen(angle)), covariance_px2=covariance, reading_rad=angle)
    calibration = reduce_data(data, bench.table.nominal, MODEL, leans=True, start_star=np.array(bench.star))
    assert calibration.converged
    assert calibration.solution.names == found.names
    np.testing.assert_allclose(calibration.solution.sigma, found.sigma, rtol=2e-3)


def test_shares_add_up_and_knowledge_never_hurts() -> None:
    bench, direction, angle, covariance = _setup("xyz")
    noise = covariance + reading_covariance_px2(MODEL, bench, angle)
    total = bound(MODEL, bench, angle, noise, direction, leans=True)
    shares = noise_shares(MODEL, bench, angle, covariance, direction)
    assert set(shares) == {"centroids", *(f"readings, {name} axis" for name in ("outer", "middle", "inner"))}
    assert np.sqrt(sum(v**2 for v in shares.values())) == pytest.approx(total.map_sigma_arcsec, rel=1e-6)
    known = knowledge(MODEL, bench, angle, noise, direction)
    assert known.pop("nothing more") == pytest.approx(total.map_sigma_arcsec)
    assert max(known.values()) <= total.map_sigma_arcsec * (1 + 1e-9)
    assert min(total.inflation(name) for name in total.names[:8]) >= 1.0


def test_places_that_do_not_determine_the_unknowns() -> None:
    bench, direction, angle, covariance = _setup("xy")
    with pytest.raises(DomainError, match="6 places give 12 measurements for 14 unknowns"):
        bound(MODEL, bench, angle[:6], covariance[:6], direction, leans=True)
    with pytest.raises(DomainError, match="do not determine"):
        bound(MODEL, bench, np.repeat(angle[:1], 81, axis=0), covariance, direction, leans=True)
