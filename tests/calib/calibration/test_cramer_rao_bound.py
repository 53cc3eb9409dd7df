"""Cramer-Rao bounds: equal to what the estimators state at the truth, and to what they scatter by."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_scene import CAMERA, START, assert_same_covariance, make_scene
from scipy.spatial.transform import Rotation

from calib import Observations, TurntableAttitudes, bound, calibrate
from calib.calibration.gyro_linked import GyroNoise

NOISE = GyroNoise.from_data_sheet(angle_random_walk_deg_per_sqrt_h=0.05, bias_deg_per_h=1.0)


@pytest.fixture(scope="module")
def scene():
    return make_scene(frames=10, stars=6, sigma_px=0.0)


def true(method, scene):
    """The family at the truth."""
    family = scene.family(method, NOISE)
    if method == "free":
        return replace(family, attitude=scene.attitude)
    if method in ("acc", "linked"):
        return replace(family, first_attitude=scene.attitude[0], installation=scene.installation)
    return family


@pytest.mark.parametrize("method", ["free", "acc", "linked", "weighted angles", "angles"])
def test_estimators_on_exact_data_state_the_bound(scene, method):
    """No noise in the data, the noise stated: each estimator's covariance is its bound."""
    limit = bound(scene.observations, CAMERA, true(method, scene))
    found = scene.calibrated(scene.family(method, NOISE))
    assert limit.names == found.solution.names
    np.testing.assert_allclose(limit.sigma, found.solution.sigma, rtol=1e-4)
    assert limit.condition == pytest.approx(found.solution.condition, rel=1e-3)
    assert_same_covariance(limit.camera_covariance, found.covariance, atol=1e-3)


def test_fewer_unknowns_and_empty_frames(scene):
    free, family = ("x0_px", "y0_px", "focal_length_mm"), true("free", scene)
    few = bound(scene.observations, CAMERA, family, free=free)
    every = bound(scene.observations, CAMERA, family)
    assert few.names == free
    assert np.all(few.sigma < every.sigma[:3])
    assert np.count_nonzero(few.camera_covariance) == 9
    # a frame left with one star holds no information
    alone = scene.observations.select((scene.observations.frame > 0) | (np.arange(len(scene.observations)) == 0))
    gone = scene.observations.select(scene.observations.frame > 0)
    np.testing.assert_allclose(bound(alone, CAMERA, family).sigma, bound(gone, CAMERA, family).sigma, rtol=1e-9)


def test_turntable_bound():
    rng = np.random.default_rng(0)
    star = np.array([0.0, 0.0, 1.0])
    angle = np.deg2rad(rng.uniform(-8, 8, (200, 2)))
    table = Rotation.from_rotvec(np.outer(angle[:, 0], [0, 1, 0])) * Rotation.from_rotvec(
        np.outer(angle[:, 1], [1, 0, 0])
    )
    installation = Rotation.from_rotvec([0.01, 0.02, 0.03])
    exact = CAMERA.project(installation.apply(table.inv().apply(star)))
    observed = Observations.isotropic(
        pixel_px=exact, direction=np.tile(star, (200, 1)), frame=np.arange(200), sigma_px=0.05
    )
    limit = bound(observed, CAMERA, TurntableAttitudes(table_rotation=table, installation=installation))
    found = calibrate(observed, START, TurntableAttitudes(table_rotation=table)).solution
    assert limit.names == found.names
    np.testing.assert_allclose(limit.sigma, found.sigma, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["free", "angles"])
def test_estimators_reach_their_bound(method):
    """100 realisations of sparse noisy frames, from the document's start: scatter over bound within 5 sigma of 1."""
    scene = make_scene(frames=15, stars=5, sigma_px=0.0)
    rng, errors = np.random.default_rng(12), []
    template = scene.noisy(np.random.default_rng(0), 0.2)
    limit = bound(template, CAMERA, true(method, scene))
    for _ in range(100):
        found = calibrate(scene.noisy(rng, 0.2), START, scene.family(method, NOISE))
        assert found.converged
        errors.append(found.solution.value - scene.truth[: len(limit.names)])
    ratio = np.std(errors, axis=0) / limit.sigma
    assert np.all(np.abs(ratio - 1.0) < 5 / np.sqrt(200))
    mean = np.mean(errors, axis=0) / limit.sigma * np.sqrt(100)
    assert np.all(np.abs(mean) < 5)
