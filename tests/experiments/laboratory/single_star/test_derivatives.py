"""What angles, leans and unknowns do to the star and its image, against finite differences and a closed form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.cameras import BrownConrady, SensorGeometry
from experiments.laboratory.devices.turntable import build_turntable
from experiments.laboratory.single_star.bench import Bench, aim
from experiments.laboratory.single_star.derivatives import angle_effect, design, lean_effect, reading_covariance_px2
from experiments.laboratory.single_star.star import star_direction
from optics.units import ARCSEC_RAD

SENSOR = SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055)
MODEL = BrownConrady.create(SENSOR, focal_length_mm=40.0, x0_px=5.0, y0_px=-3.0, q1_per_mm2=1e-4, p1_per_mm=1e-5)


def _bench(axes: str, lean: float) -> Bench:
    return Bench(
        table=build_turntable(axes, non_orthogonality_arcsec=lean),
        star=star_direction(0.3, -0.2),
        installation=Rotation.from_rotvec([0.01, -0.02, 0.3]),
    )


def test_effects_are_the_derivatives() -> None:
    bench, step = _bench("xyz", lean=500.0), 1e-6
    angle = np.random.default_rng(3).uniform(-0.5, 0.5, (7, 3))
    for i in range(3):
        moved = (bench.seen(angle + step * np.eye(3)[i]) - bench.seen(angle - step * np.eye(3)[i])) / (2 * step)
        np.testing.assert_allclose(angle_effect(bench, angle)[:, i], moved, atol=1e-9)
    for i in range(2):
        low, high = (
            _bench("xyz", lean=np.full(2, 500.0) + sign * step / ARCSEC_RAD * np.eye(2)[i]) for sign in (-1, 1)
        )
        moved = (high.seen(angle) - low.seen(angle)) / (2 * step)
        np.testing.assert_allclose(lean_effect(bench, angle)[:, i], moved, atol=1e-9)


@pytest.mark.parametrize("axes", ["xy", "xyz"])
def test_design_is_the_derivative(axes: str) -> None:
    """Against finite differences of the whole chain, in the estimator's unknowns."""
    bench = _bench(axes, lean=20.0)
    angle = aim(bench, MODEL.unproject(SENSOR.grid_px(4)), np.asarray(np.arange(16) % 4 * (np.pi / 2)))
    columns = design(MODEL, bench, angle, leans=True)
    step = 1e-6
    azimuth = Bench(
        table=bench.table, star=star_direction(0.3 + np.degrees(step), -0.2), installation=bench.installation
    )
    moved = (MODEL.project(azimuth.seen(angle)) - MODEL.project(bench.seen(angle))) / step
    np.testing.assert_allclose(columns[:, :, 8], moved, rtol=1e-4, atol=0.05)
    leans = np.full(len(axes) - 1, 20.0)
    leans[0] += step / ARCSEC_RAD
    leaning = build_turntable(axes, non_orthogonality_arcsec=leans)
    lean = Bench(table=leaning, star=bench.star, installation=bench.installation)
    moved = (MODEL.project(lean.seen(angle)) - MODEL.project(bench.seen(angle))) / step
    np.testing.assert_allclose(columns[:, :, 13], moved, rtol=1e-4, atol=0.05)


def test_reading_noise_on_the_axis_is_pixels_over_the_plate_scale() -> None:
    bench = Bench(
        table=build_turntable("xy", reading_noise_arcsec=(1.0, 2.0)),
        star=np.array([0.0, 0.0, 1.0]),
        installation=Rotation.identity(),
    )
    plain = BrownConrady.create(SENSOR, focal_length_mm=40.0)
    found = reading_covariance_px2(plain, bench, np.zeros((1, 2)))[0]
    arcsec_px = 40.0 / 0.0055 * ARCSEC_RAD
    np.testing.assert_allclose(np.sqrt(np.diagonal(found)), [2.0 * arcsec_px, 1.0 * arcsec_px], rtol=1e-9)
    assert abs(found[0, 1]) < 1e-12
