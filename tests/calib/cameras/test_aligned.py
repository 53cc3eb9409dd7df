"""A camera model behind a rotation, and the fit that needs it."""

import numpy as np
from calibration_scene import CAMERA, GEOMETRY
from scipy.spatial.transform import Rotation
from star_directions import field_directions

from calib import Polynomial, fit_camera
from calib.cameras.aligned import AlignedCamera
from render.records import PixelMap

TILT = Rotation.from_rotvec([0.004, -0.003, 0.01])


def directions(count=40):
    return field_directions(np.random.default_rng(3), count, 10.0)


def test_turning_the_stars_or_the_camera_is_the_same():
    aligned, v = AlignedCamera.create(CAMERA, TILT), directions()
    assert np.allclose(aligned.project(v), CAMERA.project(TILT.apply(v)), atol=1e-12)
    assert np.allclose(aligned.unproject(aligned.project(v)), v, atol=1e-12)


def test_derivatives_are_those_of_finite_differences():
    aligned, v, step = AlignedCamera.create(CAMERA, TILT), directions(), 1e-6
    at = aligned.project_jacobian(v)
    for axis in range(3):
        move = step * np.eye(3)[axis]
        difference = (aligned.project(v + move) - aligned.project(v - move)) / (2 * step)
        assert np.allclose(at.by_direction[:, :, axis], difference, atol=1e-4)
    for column, scale in enumerate(aligned.parameter_scales):
        move = 1e-4 * scale * np.eye(len(aligned.parameters))[column]
        high, low = (aligned.with_parameters(aligned.parameters + sign * move).project(v) for sign in (1, -1))
        assert np.allclose(at.by_parameter[:, :, column] * 2e-4 * scale, high - low, atol=1e-9)


def test_fitted_camera_knows_the_directions_of_a_map_that_its_model_cannot_hold():
    """A camera whose axis is off by 0.1 deg: the polynomial's gauge cannot follow, the aligned camera does."""
    truth = Polynomial.create(GEOMETRY, focal_length_mm=25.6, degree=5)
    rng = np.random.default_rng(1)
    truth = truth.with_parameters(
        truth.parameters + 0.3 * truth.parameter_scales * rng.uniform(-1, 1, truth.parameters.size)
    )
    tilt = Rotation.from_rotvec([1.7e-3, -0.8e-3, 0.0])
    v = directions(400)
    pixel = truth.project(tilt.apply(v))
    fit = fit_camera(
        PixelMap(direction=v, pixel_px=pixel, width_px=1024, height_px=1024, pixel_pitch_mm=0.01, focal_length_mm=25.7)
    )
    assert fit.max_px < 2e-3
    assert np.abs(fit.camera.project(v) - pixel).max() < 2e-3
    assert np.abs(fit.camera.unproject(pixel) - v).max() < 2e-3 * 0.01 / 25.6
