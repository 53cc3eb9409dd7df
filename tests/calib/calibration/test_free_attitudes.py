"""Bundle adjustment with a free attitude in every frame."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_scene import CAMERA, GEOMETRY, NARROW, START, assert_same_covariance, make_scene
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib import FreeAttitudes, Observations, calibrate
from calib.cameras.per_band import PerBand


def test_exact_data_give_the_truth_from_the_document_s_start():
    scene = make_scene(sigma_px=0.0)
    found = scene.calibrated(FreeAttitudes())
    assert found.converged
    # three radial coefficients are nearly one another's: judge by the pixels, then loosely by the values
    direction = CAMERA.unproject(GEOMETRY.grid_px(9))
    np.testing.assert_allclose(found.model.project(direction), CAMERA.project(direction), atol=1e-6)
    np.testing.assert_allclose(found.model.parameters, CAMERA.parameters, rtol=1e-5)
    assert (found.attitude * scene.attitude.inv()).magnitude().max() < 1e-9
    assert found.used.all()


def test_same_minimum_and_covariance_as_scipy():
    """Camera and rotation vectors in one list, derivatives by finite differences."""
    scene = make_scene(seed=3, frames=6, stars=10)
    observed, found = scene.observations, scene.calibrated(FreeAttitudes())
    scale = np.concatenate([CAMERA.parameter_scales, np.full(18, 1e-4)])

    def residuals(x):
        x = x * scale
        attitude = Rotation.from_rotvec(x[8:].reshape(-1, 3)) * scene.attitude
        v = attitude[observed.frame].apply(observed.direction.copy())
        return ((CAMERA.with_parameters(CAMERA.parameters + x[:8]).project(v) - observed.pixel_px) / 0.05).ravel()

    theirs = least_squares(residuals, np.zeros(len(scale)), jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-12)
    difference = found.model.parameters - CAMERA.parameters - (theirs.x * scale)[:8]
    assert np.abs(difference / found.solution.sigma).max() < 1e-3
    assert found.solution.chi2 == pytest.approx(2 * theirs.cost, rel=1e-9)
    covariance = (np.linalg.inv(theirs.jac.T @ theirs.jac) * np.outer(scale, scale))[:8, :8]
    assert_same_covariance(found.covariance, covariance, atol=2e-3)


def test_order_and_start_attitude_make_no_difference():
    scene = make_scene(seed=1)
    shuffled = scene.observations.select(np.random.default_rng(0).permutation(len(scene.observations)))
    one = scene.calibrated(FreeAttitudes())
    other = calibrate(shuffled, START, FreeAttitudes(attitude=scene.attitude), two_step=False)
    assert np.abs((one.model.parameters - other.model.parameters) / one.solution.sigma).max() < 1e-3
    assert other.solution.chi2 == pytest.approx(one.solution.chi2, rel=1e-9)


@pytest.mark.slow
def test_correlated_position_errors_are_weighted():
    """Positions known ten times better along one diagonal: the fit must use it."""
    scene = make_scene(frames=8, stars=12)
    rng = np.random.default_rng(8)
    axes = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2)
    root = axes @ np.diag([0.1, 0.01])
    covariance = np.tile(root @ root.T, (len(scene.observations), 1, 1))
    pulls = []
    for _ in range(40):
        shift = rng.standard_normal(scene.exact_px.shape) @ root.T
        observed = replace(scene.observations, pixel_px=scene.exact_px + shift, covariance_px2=covariance)
        found = calibrate(observed, CAMERA, FreeAttitudes(), two_step=False)
        pulls.append(found.solution.pulls(CAMERA.parameters))
    assert np.all(np.abs(np.mean(np.square(pulls), axis=0) - 1.0) < 5 * np.sqrt(2.0 / 40))
    isotropic = calibrate(scene.noisy(rng, 0.1 / np.sqrt(2)), CAMERA, FreeAttitudes()).solution.sigma
    assert np.all(found.solution.sigma < 0.95 * isotropic)
    assert found.solution.sigma[2] < 0.3 * isotropic[2]


def test_fixed_parameters_keep_their_value():
    scene = make_scene(camera=NARROW)
    start = NARROW.with_parameters([0.0, 0.0, 80.0, 0, 0, 0, 0, 0])
    found = calibrate(scene.observations, start, FreeAttitudes(), free=("focal_length_mm",))
    assert found.solution.names == ("focal_length_mm",)
    np.testing.assert_array_equal(found.model.parameters[[0, 1, 3, 4, 5, 6, 7]], 0.0)
    assert np.count_nonzero(found.covariance) == 1


def test_frames_with_one_star_are_left_out():
    scene = make_scene(frames=6, stars=12)
    keep = (scene.observations.frame != 4) | (np.arange(len(scene.observations)) == 48)
    kept, empty = (scene.observations.select(rows) for rows in (keep, scene.observations.frame != 4))
    found, without = (calibrate(stars, START, FreeAttitudes()) for stars in (kept, empty))
    assert found.converged
    assert "1 frames with fewer than 2 stars" in found.solution.message
    assert np.count_nonzero(~found.used) == 1
    assert without.solution.degrees_of_freedom == found.solution.degrees_of_freedom
    np.testing.assert_allclose(found.model.parameters, without.model.parameters, rtol=1e-9)


def test_frames_of_very_different_size():
    """One frame of 600 stars and 20 of 3: no table padded to the longest, the same numbers."""
    scene = make_scene(frames=21, stars=600, rate_deg=0.5)
    rank = np.arange(len(scene.observations)) % 600
    few = scene.observations.select((scene.observations.frame == 0) | (rank < 3))
    found = calibrate(few, START, FreeAttitudes())
    assert found.converged
    assert np.all(np.abs(found.solution.pulls(CAMERA.parameters)) < 5)


def test_other_camera_models_need_no_change():
    """Two bands with a focal length and principal point each: the estimator only sees the interface."""
    truth = PerBand.create(GEOMETRY, focal_length_mm=[25.6, 25.61], x0_px=[10.0, 10.3], y0_px=[-10.0, -10.1])
    start = PerBand.create(GEOMETRY, focal_length_mm=[20.0, 20.0])
    scene = make_scene(frames=12, stars=20)
    rng = np.random.default_rng(0)
    band = rng.integers(0, 2, len(scene.observations))
    exact = truth.project(scene.attitude[scene.observations.frame].apply(scene.observations.direction.copy()), band)
    observed = Observations.isotropic(
        pixel_px=np.clip(exact + rng.normal(0, 0.05, exact.shape), 0, 1023.4),
        direction=scene.observations.direction,
        frame=scene.observations.frame,
        sigma_px=0.05,
        band=band,
    ).select(np.all((exact > 1) & (exact < 1022), axis=1))
    found = calibrate(observed, start, FreeAttitudes())
    assert found.converged
    assert np.all(np.abs(found.solution.pulls(truth.parameters)) < 5)
