"""Cramer-Rao bounds: equal to what the estimators state at the truth, and to what they scatter by."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.calibration.attitude_correlated import calibrate_attitude_correlated
from calib.calibration.bounds import (
    bound_attitude_correlated,
    bound_free_attitude,
    bound_gyro_linked,
    bound_interstar,
    bound_turntable,
    predicted_attitude_correlated,
)
from calib.calibration.free_attitude import calibrate_free_attitude
from calib.calibration.gyro_linked import GyroNoise, calibrate_gyro_linked
from calib.calibration.interstar import calibrate_interstar
from calib.calibration.turntable import calibrate_turntable
from optics.errors import DomainError

NOISE = GyroNoise.from_data_sheet(angle_random_walk_deg_per_sqrt_h=0.05, bias_deg_per_h=1.0)


@pytest.fixture(scope="module")
def scene(scenes):
    return scenes.make_scene(frames=10, stars=6, sigma_px=0.0)


def test_estimators_on_exact_data_state_the_bound(scenes, scene):
    """No noise in the data, the noise stated: each estimator's covariance is its bound."""
    observed, time = scene.observations, np.arange(10.0)
    common = (observed, scene.gyro, scenes.CAMERA, scene.attitude[0], scene.installation)
    pairs = [
        (bound_free_attitude(observed, scenes.CAMERA, scene.attitude), calibrate_free_attitude(observed, scenes.START)),
        (bound_attitude_correlated(*common), calibrate_attitude_correlated(observed, scene.gyro, scenes.START)),
        (
            bound_gyro_linked(*common, time_s=time, noise=NOISE),
            calibrate_gyro_linked(observed, scene.gyro, scenes.START, time_s=time, noise=NOISE),
        ),
        (bound_interstar(observed, scenes.CAMERA), calibrate_interstar(observed, scenes.START, weighting="full")),
        (bound_interstar(observed, scenes.CAMERA, weighting="none"), calibrate_interstar(observed, scenes.START)),
    ]
    for bound, found in pairs:
        assert bound.names == found.solution.names
        np.testing.assert_allclose(bound.sigma, found.solution.sigma, rtol=1e-4)
        assert bound.condition == pytest.approx(found.solution.condition, rel=1e-3)
        sigma = bound.sigma[:8]
        np.testing.assert_allclose(
            bound.camera_covariance / np.outer(sigma, sigma), found.covariance / np.outer(sigma, sigma), atol=1e-3
        )


def test_who_knows_more_has_the_smaller_bound(scenes, scene):
    common = (scene.observations, scene.gyro, scenes.CAMERA, scene.attitude[0], scene.installation)
    time = {"time_s": np.arange(10.0)}
    perfect = bound_attitude_correlated(*common).sigma[:8]
    linked = bound_gyro_linked(*common, **time, noise=NOISE).sigma[:8]
    free = bound_free_attitude(scene.observations, scenes.CAMERA, scene.attitude).sigma
    unweighted = bound_interstar(scene.observations, scenes.CAMERA, weighting="none").sigma
    assert np.all(perfect < linked)
    assert np.all(linked < free)
    assert np.all(free < unweighted)
    np.testing.assert_allclose(bound_interstar(scene.observations, scenes.CAMERA).sigma, free, rtol=1e-4)
    # a gyro believed to be perfect that is not: worse than one whose noise is known
    believed = predicted_attitude_correlated(*common, **time, noise=NOISE)
    assert np.all(believed.sigma[:8] > linked)
    nothing = GyroNoise(angle_random_walk_rad_per_sqrt_s=0.0)
    np.testing.assert_allclose(
        predicted_attitude_correlated(*common, **time, noise=nothing).sigma[:8], perfect, rtol=1e-9
    )


def test_fewer_unknowns_and_empty_frames(scenes, scene):
    free = ("x0_px", "y0_px", "focal_length_mm")
    few = bound_free_attitude(scene.observations, scenes.CAMERA, scene.attitude, free=free)
    every = bound_free_attitude(scene.observations, scenes.CAMERA, scene.attitude)
    assert few.names == free
    assert np.all(few.sigma < every.sigma[:3])
    assert np.count_nonzero(few.camera_covariance) == 9
    # a frame left with one star tells nothing
    alone = scene.observations.select((scene.observations.frame > 0) | (np.arange(len(scene.observations)) == 0))
    gone = scene.observations.select(scene.observations.frame > 0)
    np.testing.assert_allclose(
        bound_free_attitude(alone, scenes.CAMERA, scene.attitude).sigma,
        bound_free_attitude(gone, scenes.CAMERA, scene.attitude).sigma,
        rtol=1e-9,
    )


def test_stars_behind_the_camera_have_no_bound(scenes, scene):
    away = Rotation.from_rotvec([np.pi, 0.0, 0.0]) * scene.attitude
    with pytest.raises(DomainError, match="behind the camera"):
        bound_free_attitude(scene.observations, scenes.CAMERA, away)


def test_turntable_bound(scenes):
    from calib.calibration.observations import Observations

    rng = np.random.default_rng(0)
    star = np.array([0.0, 0.0, 1.0])
    angle = np.deg2rad(rng.uniform(-8, 8, (200, 2)))
    table = Rotation.from_rotvec(np.outer(angle[:, 0], [0, 1, 0])) * Rotation.from_rotvec(
        np.outer(angle[:, 1], [1, 0, 0])
    )
    installation = Rotation.from_rotvec([0.01, 0.02, 0.03])
    exact = scenes.CAMERA.project(installation.apply(table.inv().apply(star)))
    observed = Observations.isotropic(
        pixel_px=exact, direction=np.tile(star, (200, 1)), frame=np.arange(200), sigma_px=0.05
    )
    bound = bound_turntable(observed, table, scenes.CAMERA, installation)
    found = calibrate_turntable(observed, table, scenes.START).solution
    assert bound.names == found.names
    np.testing.assert_allclose(bound.sigma, found.sigma, rtol=1e-5)


@pytest.mark.slow
def test_scatter_of_acc_with_an_imperfect_gyro_is_predicted(scenes, scene):
    """200 realisations of stars, bias and walk: each standard deviation within 5 of its sigmas (1 / sqrt(400))."""
    from calib.calibration.gyro_linked import _bias_levers

    time = np.arange(10.0)
    predicted = predicted_attitude_correlated(
        scene.observations,
        scene.gyro,
        scenes.CAMERA,
        scene.attitude[0],
        scene.installation,
        time_s=time,
        noise=NOISE,
    )
    rng, errors = np.random.default_rng(11), []
    lever = _bias_levers(scene.gyro.as_matrix(), time)
    for _ in range(200):
        walk = np.cumsum(rng.normal(0.0, NOISE.angle_random_walk_rad_per_sqrt_s, (10, 3)), axis=0)
        walk -= walk[0]
        drift = lever @ rng.normal(0.0, NOISE.bias_sigma_rad_per_s, 3) + walk
        gyro = scene.gyro * Rotation.from_rotvec(-drift)
        found = calibrate_attitude_correlated(scene.noisy(rng), gyro, scenes.START)
        assert found.converged
        errors.append(found.solution.value - scene.truth)
    ratio = np.std(errors, axis=0) / predicted.sigma
    assert np.all(np.abs(ratio - 1.0) < 5 / np.sqrt(400))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["free", "acc", "full", "none"])
def test_estimators_reach_their_bound(scenes, method):
    """200 realisations of sparse noisy frames, from the document's start: scatter over bound within 5 sigma of 1."""
    scene = scenes.make_scene(frames=15, stars=5, sigma_px=0.0)
    rng, errors = np.random.default_rng(12), []
    template = scene.noisy(np.random.default_rng(0), 0.2)
    run, bound = {
        "free": (
            lambda o: calibrate_free_attitude(o, scenes.START),
            bound_free_attitude(template, scenes.CAMERA, scene.attitude),
        ),
        "acc": (
            lambda o: calibrate_attitude_correlated(o, scene.gyro, scenes.START),
            bound_attitude_correlated(template, scene.gyro, scenes.CAMERA, scene.attitude[0], scene.installation),
        ),
        "full": (
            lambda o: calibrate_interstar(o, scenes.START, weighting="full"),
            bound_interstar(template, scenes.CAMERA),
        ),
        "none": (
            lambda o: calibrate_interstar(o, scenes.START),
            bound_interstar(template, scenes.CAMERA, weighting="none"),
        ),
    }[method]
    for _ in range(200):
        found = run(scene.noisy(rng, 0.2))
        assert found.converged
        errors.append(found.solution.value - scene.truth[: len(bound.names)])
    ratio = np.std(errors, axis=0) / bound.sigma
    assert np.all(np.abs(ratio - 1.0) < 5 / np.sqrt(400))
    mean = np.mean(errors, axis=0) / bound.sigma * np.sqrt(200)
    assert np.all(np.abs(mean) < 5)
