"""The wide field's residuals and the target's closed form, from drawn errors."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from calib.accuracy.distortion import distortion_statistics, grid_residual_px
from experiments.distortion.experiment import describe_target
from experiments.distortion.settings import DistortionConfig
from experiments.distortion.wide_field import REFERENCE, WideRun, tabulate_wide_field
from experiments.laboratory.distortion_error import grid_position

POINT_PX, MARKING_PX = 0.03, 0.04


def test_residuals_less_the_prescription_are_noise_and_marking(small_camera):
    """RMS ratio 1 over 300 drawn runs, and its scatter from run to run the stated uncertainty."""
    rng, size = np.random.default_rng(3), [small_camera.camera.width_px, small_camera.camera.height_px]
    pixel = rng.uniform(50.0, np.array(size) - 50.0, (32, 2))
    direction = small_camera.camera.nominal_direction(*pixel.T, small_camera.focal_length_mm)
    nominal, position = grid_position(small_camera, direction)
    expected = nominal + 3.0 * position * (position**2).sum(1)[:, None]
    ratios = []
    for _ in range(300):
        seen = expected + np.hypot(POINT_PX, MARKING_PX) * rng.standard_normal(expected.shape) + [0.7, -0.4]
        d, _ = grid_residual_px(nominal, position, seen, seen, REFERENCE)
        found = distortion_statistics(position, d, 3)
        frames = SimpleNamespace(
            arcsec_3sigma=3.0, instrument=small_camera, direction=direction, statistics=lambda *_, found=found: found
        )
        three = np.arange(6.0).reshape(3, 2)
        predicted = SimpleNamespace(
            position_px={"cog": expected},
            point_px={"cog": np.full(expected.shape, POINT_PX)},
            marking_px=MARKING_PX,
            mean_px={"cog": {REFERENCE: three}},
            scatter_px={"cog": {REFERENCE: 0.1 * three}},
        )
        record = tabulate_wide_field(WideRun(method="cog", frames=frames, predicted=predicted, marking_px=2.0 * three))
        ratios.append(record.residual_ratio.value)
    assert np.mean(np.square(ratios)) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 60 / 300))
    assert record.residual_ratio.uncertainty == pytest.approx(np.std(ratios), rel=4.0 / np.sqrt(600))
    np.testing.assert_allclose(record.measured_arcsec, 3.0 * found.sigma_px)
    assert record.predicted_arcsec[2][1].value == pytest.approx(15.0)
    assert record.predicted_arcsec[2][1].uncertainty == pytest.approx(1.5)
    np.testing.assert_allclose(record.marking_error_arcsec, 6.0 * three)
    # frames of a lens with 10 % more distortion are noticed
    wrong = distortion_statistics(position, d + 0.1 * (expected - nominal), 3)
    frames.statistics = lambda *_: wrong
    ratio = tabulate_wide_field(
        WideRun(method="cog", frames=frames, predicted=predicted, marking_px=three)
    ).residual_ratio
    assert ratio.value > 1.0 + 4.0 * ratio.uncertainty
    # the prescription's distortion is what is found, to the noise
    distortion, _ = grid_residual_px(nominal, position, expected, expected, REFERENCE)
    np.testing.assert_allclose(record.measured_arcsec[0] / 3.0, distortion.std(0, ddof=1), rtol=0.2)


def test_the_share_of_pure_noise_that_a_polynomial_removes(star_camera):
    """Drawn noise at random points, a least-squares cubic of ten terms."""
    config = DistortionConfig()
    record = describe_target(config, star_camera, published=True)
    points, rng = config.target.rows * config.target.columns, np.random.default_rng(4)
    position = rng.uniform(-1.0, 1.0, (points, 2))
    removed = [
        distortion_statistics(position, rng.standard_normal((points, 2)), config.order).sigma_px[2] for _ in range(400)
    ]
    removed_fraction = np.sqrt(np.mean(np.square(removed)))
    assert record.marking_removed_arcsec / record.marking_error_arcsec == pytest.approx(
        removed_fraction, rel=4.0 / np.sqrt(800 * 9)
    )
    assert (record.points, record.terms, record.marking_error_arcsec) == (32, 10, pytest.approx(0.5))
    np.testing.assert_array_equal(record.size_px, [star_camera.camera.width_px, star_camera.camera.height_px])
