"""Line-of-sight map: a turn is no error, the covariance predicts the spread."""

import numpy as np
import pytest
from calibration_scene import CAMERA, GEOMETRY
from scipy.spatial.transform import Rotation

from calib.cameras import BrownConrady, PerBand, Polynomial
from calib.cameras.line_of_sight import best_rotation, drawn_rms, expected_rms, line_of_sight_map, mean_square_matrix
from optics.units import ARCSEC_RAD, RAD_ARCSEC

GRID = GEOMETRY.grid_px(9)


def spread(model, sigma_px, seed):
    """A covariance with correlations, whose sigmas move the image by about ``sigma_px``."""
    mix = np.random.default_rng(seed).normal(size=(len(model.parameters),) * 2)
    factor = sigma_px * model.parameter_scales[:, None] * mix / np.sqrt(len(mix))
    return factor @ factor.T, factor


@pytest.mark.parametrize("angle_rad", [0.0, 1e-6, 1e-3, 0.5, 3.0])
def test_a_pure_rotation_is_no_error(angle_rad):
    turn = Rotation.from_rotvec(angle_rad * np.array([2.0, -1.0, 2.0]) / 3.0)
    truth = turn.apply(CAMERA.unproject(GRID))
    truth.setflags(write=False)  # as the arrays of records are
    result = line_of_sight_map(CAMERA, truth, GRID)
    np.testing.assert_allclose(result.error_arcsec, 0.0, atol=1e-9)
    assert (result.rotation * turn.inv()).magnitude() < 1e-12
    assert result.rms_arcsec < 1e-9


def test_a_longer_focal_length_points_inwards_by_the_known_amount():
    """A pinhole that takes f for f (1 + e) sees tan smaller by e: the angle by e sin cos, whatever the turn."""
    true = BrownConrady.create(GEOMETRY, focal_length_mm=25.6)
    wrong = BrownConrady.create(GEOMETRY, focal_length_mm=25.6 * (1 + 1e-5))
    turned = Rotation.from_rotvec([0.4, 0.1, -2.0]).apply(true.unproject(GRID))
    result = line_of_sight_map(wrong, turned, GRID)
    offset = (GRID - GEOMETRY.centre_px) * 0.01
    radius = np.hypot(*offset.T)
    angle = np.arctan(radius / 25.6)
    inwards = -1e-5 * np.sin(angle) * np.cos(angle) * RAD_ARCSEC
    np.testing.assert_allclose(np.hypot(*result.error_arcsec.T), -inwards, rtol=1e-4, atol=1e-9)
    towards = np.divide(offset, radius[:, None], out=np.zeros_like(offset), where=radius[:, None] > 0)
    along = np.sum(result.error_arcsec * towards, axis=1)
    np.testing.assert_allclose(along, inwards, rtol=3e-3, atol=1e-9)  # +X is not quite tangent at the edge


def test_an_error_towards_a_larger_column_is_positive_in_x():
    """The middle pixel looks too far towards +X; over so many pixels the rotation hardly follows."""
    truth = CAMERA.unproject(GRID)
    middle = len(GRID) // 2
    truth[middle] -= [1e-5, 0.0, 0.0]
    truth[middle] /= np.linalg.norm(truth[middle])
    error = line_of_sight_map(CAMERA, truth, GRID).error_arcsec
    assert error[middle, 0] > 0.9 * 1e-5 * RAD_ARCSEC
    assert abs(error[middle, 1]) < 0.02 * error[middle, 0]


@pytest.mark.parametrize(
    "family", ["brown_conrady", *(pytest.param(one, marks=pytest.mark.slow) for one in ("polynomial", "per_band"))]
)
def test_monte_carlo_of_parameters_agrees_with_the_predicted_map(family):
    """A sigma from N = 800 draws is known to 1/sqrt(2 N) = 2.5 %; the largest of 50 may be off by 4.5 times that."""
    count, pixel = 800, GEOMETRY.grid_px(5)
    model = {
        "brown_conrady": CAMERA,
        "polynomial": Polynomial.create(GEOMETRY, focal_length_mm=25.6, degree=3),
        "per_band": PerBand.create(GEOMETRY, focal_length_mm=[25.6, 25.7], q1_per_mm2=2e-4),
    }[family]
    band = np.arange(len(pixel)) % 2 if family == "per_band" else None
    covariance, factor = spread(model, 0.02, seed=8)
    truth = model.unproject(pixel, band)
    rng = np.random.default_rng(21)
    errors = np.empty((count, len(pixel), 2))
    for k in range(count):
        drawn = model.with_parameters(model.parameters + factor @ rng.standard_normal(len(factor)))
        errors[k] = line_of_sight_map(drawn, truth, pixel, band=band).error_arcsec
    predicted = line_of_sight_map(model, truth, pixel, covariance=covariance, band=band)
    measured = np.sqrt(np.mean(errors**2, axis=0))
    ratio = measured / predicted.predicted_sigma_arcsec
    assert np.abs(ratio - 1.0).max() < 4.5 / np.sqrt(2 * count)
    rms = np.sqrt(np.mean(np.sum(errors**2, axis=2)))
    # the square of a map's RMS scatters least when many patterns share in it, and at most like one normal variable's
    assert abs(rms / predicted.predicted_rms_arcsec - 1.0) < 4.0 / np.sqrt(2 * count)


def test_parameters_that_only_turn_the_camera_predict_no_error():
    """A long pinhole: the principal point is a turn, up to terms of second order in the field (3 deg)."""
    narrow = BrownConrady.create(GEOMETRY, focal_length_mm=206.2)
    covariance = np.zeros((8, 8))
    covariance[0, 0] = 1.0
    result = line_of_sight_map(narrow, narrow.unproject(GRID), GRID, covariance=covariance)
    pixel_arcsec = 0.01 / 206.2 * RAD_ARCSEC
    assert result.predicted_rms_arcsec < (5.12 / 206.2) ** 2 * pixel_arcsec
    moved = narrow.with_parameters(narrow.parameters + np.eye(8)[0])
    measured = line_of_sight_map(moved, narrow.unproject(GRID), GRID).rms_arcsec
    assert measured == pytest.approx(result.predicted_rms_arcsec, rel=0.01)


def test_what_is_not_known_is_nan_or_infinite():
    truth = CAMERA.unproject(GRID)
    assert np.isnan(line_of_sight_map(CAMERA, truth, GRID).predicted_sigma_arcsec).all()
    assert np.isnan(line_of_sight_map(CAMERA, truth, GRID).predicted_rms_arcsec)
    unknown = np.zeros((8, 8))
    unknown[3, 3] = np.inf
    assert line_of_sight_map(CAMERA, truth, GRID, covariance=unknown).predicted_rms_arcsec == np.inf
    folded = BrownConrady.create(GEOMETRY, focal_length_mm=25.6, q1_per_mm2=-4e-3)
    truth = BrownConrady.create(GEOMETRY, focal_length_mm=25.6).unproject(GRID)
    result = line_of_sight_map(folded, truth, GRID, covariance=np.eye(8) * 1e-20)
    lost = np.isnan(result.error_arcsec).any(axis=1)
    assert 0 < lost.sum() < len(GRID)
    assert np.isnan(result.predicted_sigma_arcsec[lost]).all()
    assert np.isfinite(result.predicted_sigma_arcsec[~lost]).all()
    assert np.isnan(result.rms_arcsec)


def test_best_rotation_is_a_rotation_even_for_a_mirrored_sky():
    truth = CAMERA.unproject(GRID)
    turn = best_rotation(truth * [-1.0, 1.0, 1.0], truth)
    assert np.linalg.det(turn.as_matrix()) == pytest.approx(1.0)
    small = Rotation.from_rotvec([3 * ARCSEC_RAD, -2 * ARCSEC_RAD, 50 * ARCSEC_RAD])
    assert (best_rotation(truth, small.apply(truth)) * small.inv()).magnitude() * RAD_ARCSEC < 1e-9


def test_map_error_passes_its_limit_as_often_as_stated():
    """1000 calibrations drawn from the covariance; the eigenvalues are unequal, so no single chi-square holds."""
    model, (covariance, factor) = CAMERA, spread(CAMERA, 1e-3, 3)
    truth = model.unproject(GRID)
    stated = line_of_sight_map(model, truth, GRID, covariance=covariance)
    assert stated.mean_square_arcsec2.sum() == pytest.approx(stated.predicted_rms_arcsec**2)
    draws = np.random.default_rng(8).normal(size=(1000, len(factor))) @ factor.T
    found = np.array(
        [line_of_sight_map(model.with_parameters(model.parameters + d), truth, GRID).rms_arcsec for d in draws]
    )
    for probability in (0.5, 0.9, 0.99):
        share = float((found > stated.rms_limit_arcsec(probability)).mean())
        assert share == pytest.approx(1.0 - probability, abs=4.0 * (probability * (1.0 - probability) / 1000) ** 0.5)


def test_mean_square_matrix_against_the_map():
    """Linear in small changes of the parameters; the map removes its rotation by Kabsch's method."""
    model, truth, matrix = CAMERA, CAMERA.unproject(GRID), mean_square_matrix(CAMERA, GRID)
    covariance, factor = spread(model, 0.01, 3)
    change = factor @ np.random.default_rng(5).standard_normal(8)
    found = line_of_sight_map(model.with_parameters(model.parameters + change), truth, GRID, covariance=covariance)
    assert np.sqrt(change @ matrix @ change) == pytest.approx(found.rms_arcsec, rel=2e-3)
    assert expected_rms(matrix, covariance) == pytest.approx(found.predicted_rms_arcsec, rel=1e-3)


def test_drawn_errors_have_both_covariances():
    """8000 draws: mean squares of the efficient and of the worse estimate within 4 sigma, on the same data."""
    rng, rows = np.random.default_rng(4), np.random.default_rng(1).standard_normal((30, 3))
    matrix = rows.T @ rows / 15.0
    better = np.diag([1.0, 4.0, 9.0]) * 1e-2
    worse = better + np.outer([1.0, 2.0, -1.0], [1.0, 2.0, -1.0]) * 1e-2
    drawn = drawn_rms(matrix, better, worse, 8000, rng)
    for found, covariance in zip(drawn, (better, worse), strict=True):
        square = found**2
        expected = expected_rms(matrix, covariance) ** 2
        assert square.mean() == pytest.approx(expected, abs=4.0 * square.std() / np.sqrt(square.size))
    assert np.corrcoef(drawn[0] ** 2, drawn[1] ** 2)[0, 1] > 0.3
