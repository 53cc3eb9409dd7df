"""Bundle adjustment with a free attitude in every frame."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib.calibration.calibrate import calibrate
from calib.calibration.free_attitudes import FreeAttitudes
from calib.calibration.observations import Observations
from calib.cameras.per_band import PerBand


def test_exact_data_give_the_truth_from_the_document_s_start(scenes):
    scene = scenes.make_scene(sigma_px=0.0)
    found = calibrate(scene.observations, scenes.START, FreeAttitudes())
    assert found.converged
    # three radial coefficients are nearly one another's: judge by the pixels, then loosely by the values
    direction = scenes.CAMERA.unproject(scenes.GEOMETRY.grid_px(9))
    np.testing.assert_allclose(found.model.project(direction), scenes.CAMERA.project(direction), atol=1e-6)
    np.testing.assert_allclose(found.model.parameters, scenes.CAMERA.parameters, rtol=1e-5)
    assert (found.attitude * scene.attitude.inv()).magnitude().max() < 1e-9
    assert found.used.all()


def stacked(scene, start):
    """The same problem for scipy: camera and rotation vectors in one list, derivatives by finite differences."""
    observed, frames = scene.observations, scene.observations.frames
    scale = np.concatenate([start.parameter_scales, np.full(3 * frames, 1e-4)])

    def residuals(x):
        x = x * scale
        camera = start.with_parameters(start.parameters + x[:8])
        attitude = Rotation.from_rotvec(x[8:].reshape(-1, 3)) * scene.attitude
        v = attitude[observed.frame].apply(observed.direction.copy())
        return ((camera.project(v) - observed.pixel_px) / 0.05).ravel()

    return residuals, scale


def test_same_minimum_and_covariance_as_scipy(scenes):
    scene = scenes.make_scene(seed=3, frames=6, stars=10)
    found = calibrate(scene.observations, scenes.START, FreeAttitudes())
    residuals, scale = stacked(scene, scenes.CAMERA)
    theirs = least_squares(residuals, np.zeros(len(scale)), jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-12)
    sigma = found.solution.sigma
    difference = found.model.parameters - scenes.CAMERA.parameters - (theirs.x * scale)[:8]
    assert np.abs(difference / sigma).max() < 1e-3
    assert found.solution.chi2 == pytest.approx(2 * theirs.cost, rel=1e-9)
    information = theirs.jac.T @ theirs.jac
    covariance = (np.linalg.inv(information) * np.outer(scale, scale))[:8, :8]
    np.testing.assert_allclose(sigma, np.sqrt(np.diagonal(covariance)), rtol=2e-3)
    np.testing.assert_allclose(
        found.covariance / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=2e-3
    )


def test_order_and_start_attitude_make_no_difference(scenes):
    scene = scenes.make_scene(seed=1)
    shuffled = scene.observations.select(np.random.default_rng(0).permutation(len(scene.observations)))
    one = calibrate(scene.observations, scenes.START, FreeAttitudes())
    other = calibrate(shuffled, scenes.START, FreeAttitudes(attitude=scene.attitude), two_step=False)
    assert np.abs((one.model.parameters - other.model.parameters) / one.solution.sigma).max() < 1e-3
    assert other.solution.chi2 == pytest.approx(one.solution.chi2, rel=1e-9)


@pytest.mark.slow
def test_correlated_position_errors_are_weighted(scenes):
    """Positions known ten times better along one diagonal: the fit must use it."""
    scene = scenes.make_scene(frames=8, stars=12)
    rng = np.random.default_rng(8)
    axes = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2)
    root = axes @ np.diag([0.1, 0.01])
    covariance = np.tile(root @ root.T, (len(scene.observations), 1, 1))
    pulls = []
    for _ in range(40):
        shift = rng.standard_normal(scene.exact_px.shape) @ root.T
        observed = replace(scene.observations, pixel_px=scene.exact_px + shift, covariance_px2=covariance)
        found = calibrate(observed, scenes.CAMERA, FreeAttitudes(), two_step=False)
        pulls.append(found.solution.pulls(scenes.CAMERA.parameters))
    assert np.all(np.abs(np.mean(np.square(pulls), axis=0) - 1.0) < 5 * np.sqrt(2.0 / 40))
    isotropic = calibrate(scene.noisy(rng, 0.1 / np.sqrt(2)), scenes.CAMERA, FreeAttitudes()).solution.sigma
    assert np.all(found.solution.sigma < 0.95 * isotropic)
    assert found.solution.sigma[2] < 0.3 * isotropic[2]


def test_fixed_parameters_keep_their_value(scenes):
    scene = scenes.make_scene(camera=scenes.NARROW)
    start = scenes.NARROW.with_parameters([0.0, 0.0, 80.0, 0, 0, 0, 0, 0])
    found = calibrate(scene.observations, start, FreeAttitudes(), free=("focal_length_mm",))
    assert found.solution.names == ("focal_length_mm",)
    np.testing.assert_array_equal(found.model.parameters[[0, 1, 3, 4, 5, 6, 7]], 0.0)
    assert np.count_nonzero(found.covariance) == 1


def test_frames_with_one_star_are_left_out(scenes):
    scene = scenes.make_scene(frames=6, stars=12)
    keep = (scene.observations.frame != 4) | (np.arange(len(scene.observations)) == 48)
    found = calibrate(scene.observations.select(keep), scenes.START, FreeAttitudes())
    without = calibrate(
        scene.observations.select(scene.observations.frame != 4), scenes.START, FreeAttitudes()
    )  # frame 4 is empty here
    assert found.converged
    assert "1 frames with fewer than 2 stars" in found.solution.message
    assert np.count_nonzero(~found.used) == 1
    assert without.solution.degrees_of_freedom == found.solution.degrees_of_freedom
    np.testing.assert_allclose(found.model.parameters, without.model.parameters, rtol=1e-9)


def test_frames_of_very_different_size(scenes):
    """One frame of 600 stars and 20 of 3: no table padded to the longest, the same numbers."""
    scene = scenes.make_scene(frames=21, stars=600, rate_deg=0.5)
    rank = np.arange(len(scene.observations)) % 600
    few = scene.observations.select((scene.observations.frame == 0) | (rank < 3))
    found = calibrate(few, scenes.START, FreeAttitudes())
    assert found.converged
    assert np.all(np.abs(found.solution.pulls(scenes.CAMERA.parameters)) < 5)


def test_other_camera_models_need_no_change(scenes):
    """Two bands with a focal length and principal point each: the estimator only sees the interface."""
    truth = PerBand.create(scenes.GEOMETRY, focal_length_mm=[25.6, 25.61], x0_px=[10.0, 10.3], y0_px=[-10.0, -10.1])
    start = PerBand.create(scenes.GEOMETRY, focal_length_mm=[20.0, 20.0])
    scene = scenes.make_scene(frames=12, stars=20)
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
