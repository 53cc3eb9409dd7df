"""The document's numbers and the true map from surveys with drawn errors and a distortion that is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.accuracy.distortion_prediction import ExpectedMapError
from experiments.distortion import experiment as study
from experiments.distortion.experiment import evaluate_map, tabulate_numbers, tabulate_points, tabulate_removed
from experiments.distortion.settings import DistortionConfig
from experiments.laboratory.bench.points import nominal_px
from experiments.laboratory.distortion_error import DistortionMeasurement, dense_grid
from optics.units import RAD_ARCSEC

ROWS, COLUMNS, ORDER, SURVEYS, MARKING_ARCSEC = 4, 5, 2, 100, 2.0
REFERENCES = ("nominal", "aligned", "calibrated")


@pytest.fixture(scope="module")
def config():
    target = {"rows": ROWS, "columns": COLUMNS}
    return DistortionConfig(order=ORDER, surveys=SURVEYS, map_rows=9, reference="nominal", compare=(), target=target)


def bent_px(pixel, camera):
    """Distortion of second order in the pixels, 3 px at the corners."""
    u, v = ((np.asarray(pixel) - camera.centre_px) / (0.5 * np.hypot(camera.width_px, camera.height_px))).T
    return np.column_stack([3.0 * u * v, 2.0 * u**2 - v**2])


def measured_on(instrument, config, *, marking_error_arcsec, bent=True):
    camera, rng = instrument.camera, np.random.default_rng(3)
    x, y = np.meshgrid(np.linspace(100, camera.width_px - 100, COLUMNS), np.linspace(90, camera.height_px - 90, ROWS))
    direction = camera.nominal_direction(x.ravel(), y.ravel(), instrument.focal_length_mm)
    turn = rng.standard_normal((SURVEYS, len(direction), 3)) * marking_error_arcsec / RAD_ARCSEC
    surveyed = Rotation.from_rotvec(turn.reshape(-1, 3)).apply(np.tile(direction, (SURVEYS, 1)))
    nominal = nominal_px(instrument, direction)
    seen = nominal + (bent_px(nominal, camera) if bent else 0.0)
    return DistortionMeasurement(
        instrument=instrument,
        order=config.order,
        frames=10,
        direction=direction,
        surveyed=surveyed.reshape(SURVEYS, -1, 3),
        session_px={config.methods[0]: np.stack([seen, seen])},
        sigma_px={},
        light=SimpleNamespace(nominal_px=nominal, photon_px=seen),
    )


def prediction(config, point_px=0.01):
    three = 0.1 * np.arange(1.0, 7.0).reshape(3, 2)
    return SimpleNamespace(
        mean_px={config.methods[0]: {r: k * three for k, r in enumerate(REFERENCES, 1)}},
        of_surveys_px=lambda method, reference, surveys: three / surveys * (1 + REFERENCES.index(reference)),
        bundle_px=np.full((ROWS * COLUMNS, 2), 7.0),
    )


def test_a_polynomial_divides_marking_error_by_its_degrees_of_freedom(small_camera, config):
    """Of W points with error s, k terms leave s sqrt((W - k) / (W - 1)) and take s sqrt((k - 1) / (W - 1))."""
    frames = measured_on(small_camera, config, marking_error_arcsec=MARKING_ARCSEC, bent=False)
    found = tabulate_numbers(frames, prediction(config), config.methods[0])
    count, terms, error = ROWS * COLUMNS, (ORDER + 1) * (ORDER + 2) // 2, 3.0 * MARKING_ARCSEC
    for name, freedom in enumerate((count - 1, count - terms, terms - 1)):
        size = error * np.sqrt(freedom / (count - 1))
        reach = 4.0 / np.sqrt(2.0 * freedom * SURVEYS) + 0.01
        assert found.all_surveys_arcsec[0, name] == pytest.approx([size, size], rel=reach)
        # a number of one survey has the scatter of a chi of so many degrees, known to 1 / sqrt(2 surveys)
        scatter = size / np.sqrt(2.0 * freedom)
        assert found.survey_scatter_arcsec[0, name] == pytest.approx([scatter] * 2, rel=4.0 / np.sqrt(2.0 * SURVEYS))
        assert np.abs(found.single_survey_arcsec[0, name] - size).max() < 4.0 * scatter
    scale = 3.0 * small_camera.pixel_arcsec
    for k in range(3):
        one = found.predicted_arcsec[k][2][1]
        assert (one.value, one.uncertainty) == pytest.approx((0.6 * scale * (k + 1), 0.6 * scale * (k + 1) / SURVEYS))
    taken = tabulate_removed(found, frames, config, published=True)
    assert [one.uncertainty for one in taken.all_surveys_arcsec] == pytest.approx(found.survey_scatter_arcsec[0, 2])
    assert list(taken.above_published_percent) == [100.0, 100.0]  # six arcsec of marking against some 0.4
    assert tabulate_removed(found, frames, config, published=False).above_published_percent is None


def test_points_of_the_first_survey(small_camera, config):
    frames = measured_on(small_camera, config, marking_error_arcsec=0.0)
    rows = tabulate_points(frames, prediction(config), config)
    np.testing.assert_allclose(rows.residual_before_px, bent_px(rows.nominal_px, small_camera.camera), atol=1e-6)
    np.testing.assert_allclose(rows.residual_after_px, 0.0, atol=1e-6)
    np.testing.assert_array_equal(rows.measured_px, rows.light_px)
    assert (rows.ray_trace_px == 7.0).all()


def test_the_map_of_a_distortion_that_the_polynomial_knows(small_camera, config, monkeypatch):
    """Nothing is left but what marking errors carry in; the distortion itself by least squares of one's own."""
    camera = small_camera.camera
    grid = nominal_px(small_camera, dense_grid(small_camera, 9, 17))
    monkeypatch.setattr(study, "traced_bundles", lambda *_: grid + bent_px(grid, camera))
    forecast = ExpectedMapError(bias_px=np.array([0.3, 0.0]), noise_px=np.array([0.4, 0.2]))
    monkeypatch.setattr(study, "predict_map", lambda *_, **__: forecast)
    frames = measured_on(small_camera, config, marking_error_arcsec=0.0)
    found = evaluate_map(None, small_camera, frames, config, 0.01)
    scale = 3.0 * small_camera.pixel_arcsec
    assert np.abs(found.single_survey_arcsec[:2]).max() < 1e-6
    assert np.abs(found.single_survey_arcsec[2]).max() < 0.01  # its camera holds a cubic, which the polynomial does not
    assert np.abs(found.residual_px).max() < 1e-5
    u, v = ((grid - camera.centre_px) / 1000.0).T
    one, none = np.ones_like(u), np.zeros_like(u)
    design = np.concatenate([np.array([one, none, u, -v]), np.array([none, one, v, u])], axis=1).T
    bent = bent_px(grid, camera).T.ravel()
    left = (bent - design @ np.linalg.lstsq(design, bent, rcond=None)[0]).reshape(2, -1)
    np.testing.assert_allclose(found.uncorrected_arcsec[0], scale * np.sqrt((left**2).mean(1)), rtol=1e-6)
    assert found.predicted_arcsec[2] == pytest.approx(scale * np.array([0.5, 0.2]))
    assert (found.bias_arcsec[1, 0], found.propagated_arcsec[1, 0]) == pytest.approx((0.3 * scale, 0.4 * scale))
    assert len(found.position_px) == 9 * 17  # 9 rows: every one is drawn
    assert np.abs(found.distortion_px).max() == pytest.approx(np.abs(left).max())
    assert np.isfinite(found.point_deleted_arcsec).all()
    assert found.point_deleted_arcsec[:2].max() < 1e-4
    # marking errors: the RMS over the surveys of the maps, each of its own polynomial
    marked = measured_on(small_camera, config, marking_error_arcsec=MARKING_ARCSEC)
    noisy = evaluate_map(None, small_camera, marked, config, 0.01)
    one_right = replace(frames, surveyed=np.concatenate([frames.surveyed[:1], marked.surveyed[1:]]))
    assert one_right.deleted_rms_px(config.methods[0], "nominal").max() < 1e-4  # the first survey is the one in use
    # a fit of k = 6 terms to W = 20 points: k / W of the variance at the points, shift and roll taken out
    error = 3.0 * MARKING_ARCSEC * np.sqrt((6 - 1.5) / 20.0)
    assert noisy.all_surveys_arcsec[0] == pytest.approx([error] * 2, rel=0.35)
    assert noisy.ratio[1][0].value == pytest.approx(noisy.all_surveys_arcsec[1, 0] / (0.5 * scale))
    assert noisy.ratio[1][0].uncertainty == pytest.approx(noisy.ratio[1][0].value / np.sqrt(18.0 * SURVEYS))
    assert noisy.row_deleted_arcsec[0, 0] > noisy.point_deleted_arcsec[0, 0] > noisy.single_survey_arcsec[0, 0] / 2.0
