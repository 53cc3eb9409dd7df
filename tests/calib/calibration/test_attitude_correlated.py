"""ACC: frames linked by a gyro (ACF17)."""

import numpy as np
import pytest
from calibration_scene import CAMERA, START, assert_same_covariance, make_scene
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib.attitude.euler_angles import angles_of_rotation, rotation_of_angles
from calib.attitude.gyro_attitude import link_attitudes
from calib.calibration.attitude_correlated import ANGLE_NAMES, AttitudeCorrelated
from calib.calibration.free_attitudes import FreeAttitudes

ZERO = Rotation.identity()


def acc(scene, stars=None, two_step=True, **attitudes):
    family = AttitudeCorrelated(gyro_rotation=scene.gyro, **attitudes)
    return scene.calibrated(family, stars=stars, two_step=two_step)


@pytest.mark.parametrize("two_step", [True, False])
def test_exact_data_give_the_truth_from_the_document_s_start(two_step):
    """0 px, 20 mm, no distortion, phi = 0, theta = 0 (ACF17, table 2); the truth is 62 deg away."""
    scene = make_scene(frames=20, rate_deg=1.5, sigma_px=0.0)
    found = acc(scene, two_step=two_step, first_attitude=ZERO, installation=ZERO)
    assert found.converged
    assert found.solution.names == (*CAMERA.parameter_names, *ANGLE_NAMES)
    np.testing.assert_allclose(found.solution.value, scene.truth, rtol=1e-5, atol=1e-9)
    assert (found.attitude * scene.attitude.inv()).magnitude().max() < 1e-9
    assert (found.installation * scene.installation.inv()).magnitude() < 1e-8


def test_same_minimum_and_covariance_as_scipy_in_the_document_s_angles():
    """The 14 unknowns of eq. 9 themselves, derivatives by finite differences."""
    scene = make_scene(seed=2, frames=10, stars=10)
    observed = scene.observations
    scale = np.concatenate([CAMERA.parameter_scales, np.full(6, 1e-4)])

    def residuals(x):
        p = scene.truth + x * scale
        linked = link_attitudes(rotation_of_angles(p[8:11]), rotation_of_angles(p[11:]), scene.gyro)
        v = linked[observed.frame].apply(observed.direction.copy())
        return ((CAMERA.with_parameters(p[:8]).project(v) - observed.pixel_px) / 0.05).ravel()

    theirs = least_squares(residuals, np.zeros(14), jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-12)
    found = acc(scene).solution
    assert np.abs((found.value - scene.truth - theirs.x * scale) / found.sigma).max() < 1e-3
    covariance = np.linalg.inv(theirs.jac.T @ theirs.jac) * np.outer(scale, scale)
    np.testing.assert_allclose(found.sigma, np.sqrt(np.diagonal(covariance)), rtol=1e-3)
    assert_same_covariance(found.covariance, covariance, atol=1e-3)


def test_one_star_per_frame_is_enough():
    scene = make_scene(frames=40, stars=1, rate_deg=1.0)
    found = acc(scene)
    assert found.converged
    assert np.all(np.abs(found.solution.pulls(scene.truth)) < 5)
    assert scene.calibrated(FreeAttitudes()).solution.status == "refused"


@pytest.mark.parametrize("theta_deg", [(88.0, 120.0, -60.0), (90.0, 30.0, 10.0), (-45.0, 179.0, 5.0)])
def test_any_installation_is_found(theta_deg):
    """Far from the identity, at and near the gimbal lock of the reported angles."""
    scene = make_scene(frames=12, rate_deg=2.0, theta_deg=theta_deg)
    found = acc(scene)
    assert found.converged
    assert (found.installation * scene.installation.inv()).magnitude() < 2e-3
    np.testing.assert_allclose(angles_of_rotation(found.installation), found.solution.value[11:], atol=1e-12)
    assert np.all(np.abs(found.solution.pulls(scene.truth)[:8]) < 5)


def test_a_turn_about_one_axis_does_not_show_the_installation_about_it():
    scene = make_scene(frames=12, rate_deg=1.5, single_axis=True)
    found = acc(scene)
    assert found.solution.status == "singular"
    assert not found.converged
    sigma = found.solution.sigma
    assert np.isinf(sigma[11:]).any()
    # the camera and the attitudes are none the worse for it
    assert np.isfinite(sigma[:11]).all()
    assert np.all(np.abs(found.solution.pulls(scene.truth)[:8]) < 5)
    assert (found.attitude * scene.attitude.inv()).magnitude().max() < 1e-3


def test_no_turn_at_all():
    scene = make_scene(frames=6, stars=20, rate_deg=0.0)
    found = acc(scene)
    assert found.solution.status == "singular"
    assert "theta1_rad, theta2_rad, theta3_rad" in found.solution.message
    assert np.all(np.abs(found.solution.pulls(scene.truth)[:8]) < 5)


def test_few_stars_and_stars_behind_the_camera_are_refused():
    scene = make_scene(frames=6, stars=5)
    refused = acc(scene, scene.observations.select(np.arange(7) * 4)).solution
    assert refused.status == "refused"
    assert "7 star positions give 14 independent measurements for 14 unknowns" in refused.message
    away = Rotation.from_rotvec([np.pi, 0.0, 0.0]) * scene.attitude[0]
    behind = acc(scene, first_attitude=away, installation=ZERO)
    assert behind.solution.status == "refused"
    assert "outside the domain" in behind.solution.message
    np.testing.assert_array_equal(behind.model.parameters, START.parameters)
