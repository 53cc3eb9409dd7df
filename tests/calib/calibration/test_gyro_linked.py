"""Frames linked by a gyro of stated noise: between ACC and free attitudes."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_scene import CAMERA, make_scene
from scipy.spatial.transform import Rotation

from calib import AttitudeCorrelated, FreeAttitudes, GyroLinked, GyroNoise, bound

GOOD = GyroNoise.from_data_sheet(angle_random_walk_deg_per_sqrt_h=0.05, bias_deg_per_h=5.0)


def noisy_gyro(scene, noise, rng, *, steps=50):
    """What a gyro integrates to, step by step: rates from the true turns, plus bias and white noise, 1 s per frame."""
    bias = rng.normal(0.0, noise.bias_sigma_rad_per_s, 3)
    turn, out = scene.gyro.as_matrix(), [np.eye(3)]
    for k in range(1, len(turn)):
        change = Rotation.from_matrix(turn[k] @ turn[k - 1].T).as_rotvec()
        measured = out[-1]
        for _ in range(steps):
            # bodies turn by +rate dt, frames' coordinates by -rate dt
            white = noise.angle_random_walk_rad_per_sqrt_s * rng.standard_normal(3) / np.sqrt(steps)
            angle = -change / steps + bias / steps + white
            measured = Rotation.from_rotvec(-angle).as_matrix() @ measured
        out.append(measured)
    return Rotation.from_matrix(np.array(out)), bias


def linked(scene, noise, stars=None, gyro=None):
    gyro = scene.gyro if gyro is None else gyro
    return scene.calibrated(
        GyroLinked(gyro_rotation=gyro, time_s=np.arange(float(len(gyro))), noise=noise), stars=stars
    )


def test_data_sheet_units():
    noise = GyroNoise.from_data_sheet(angle_random_walk_deg_per_sqrt_h=0.6, bias_deg_per_h=3600.0)
    assert noise.angle_random_walk_rad_per_sqrt_s == pytest.approx(np.deg2rad(0.01))
    assert noise.bias_sigma_rad_per_s == pytest.approx(np.deg2rad(1.0))


def test_a_perfect_gyro_is_acc():
    scene = make_scene(frames=10, stars=4)
    acc = scene.calibrated(AttitudeCorrelated(gyro_rotation=scene.gyro)).solution
    found = linked(scene, GyroNoise(angle_random_walk_rad_per_sqrt_s=0.0)).solution
    assert found.names == acc.names
    assert np.abs((found.value - acc.value) / acc.sigma).max() < 1e-3
    np.testing.assert_allclose(found.sigma, acc.sigma, rtol=1e-6)
    assert found.degrees_of_freedom == acc.degrees_of_freedom


def test_a_useless_gyro_is_a_free_attitude_in_every_frame():
    scene = make_scene(frames=10, stars=5)
    free = scene.calibrated(FreeAttitudes()).solution
    found = linked(scene, GyroNoise(angle_random_walk_rad_per_sqrt_s=3.0)).solution
    assert np.abs((found.value[:8] - free.value) / free.sigma).max() < 1e-2
    np.testing.assert_allclose(found.sigma[:8], free.sigma, rtol=1e-3)
    assert np.all(found.sigma[11:] > 0.1)  # the installation is hardly seen, and that is said


def test_a_look_without_stars_changes_nothing():
    """A random walk has no memory: a reading of the gyro half-way between two frames tells nothing of the camera.
    Frames 0.5, 2 and 7 s apart; the walk is as large as the attitude errors of single frames."""
    scene = make_scene(frames=6, stars=4)
    time = np.cumsum([0.0, 0.5, 2.0, 7.0, 0.5, 2.0])
    noise = GyroNoise(angle_random_walk_rad_per_sqrt_s=3e-4)
    seen = np.delete(np.arange(6), 3)
    kept = scene.observations.select(np.isin(scene.observations.frame, seen))
    fewer = replace(kept, frame=np.searchsorted(seen, kept.frame), frames=5)
    sigma = [
        bound(stars, CAMERA, GyroLinked(gyro_rotation=scene.gyro[rows], time_s=time[rows], noise=noise)).sigma
        for stars, rows in ((kept, np.arange(6)), (fewer, seen))
    ]
    np.testing.assert_allclose(sigma[0], sigma[1], rtol=1e-6)


def test_bias_and_walk_are_found():
    scene = make_scene(frames=20, stars=20, rate_deg=1.5)
    noise = GyroNoise.from_data_sheet(angle_random_walk_deg_per_sqrt_h=0.01, bias_deg_per_h=100.0)
    gyro, bias = noisy_gyro(scene, noise, np.random.default_rng(4))
    found = linked(scene, noise, gyro=gyro)
    assert found.converged
    truth = np.concatenate([scene.truth, bias])
    assert np.all(np.abs(found.solution.pulls(truth)) < 5)
    # the data tell the bias far better than the prior did
    assert np.all(found.solution.sigma[-3:] < 0.2 * noise.bias_sigma_rad_per_s)
    assert np.all(np.abs(bias) > 3 * found.solution.sigma[-3:])
    assert (found.attitude * scene.attitude.inv()).magnitude().max() < 3e-4
    # ACC with the same gyro takes the drift for distortion and installation, and its residuals say so
    acc = scene.calibrated(AttitudeCorrelated(gyro_rotation=gyro)).solution
    assert acc.reduced_chi2 > 2.0


@pytest.mark.slow
def test_pulls_are_unit():
    """100 realisations of stars and gyro, 17 unknowns: mean square pull 1 within 5 sigma each."""
    scene = make_scene(frames=10, stars=6)
    rng = np.random.default_rng(2)
    pulls, chi2 = [], []
    for _ in range(100):
        gyro, bias = noisy_gyro(scene, GOOD, rng, steps=10)
        found = linked(scene, GOOD, stars=scene.noisy(rng), gyro=gyro).solution
        assert found.converged
        pulls.append(found.pulls(np.concatenate([scene.truth, bias])))
        chi2.append(found.chi2)
    assert np.all(np.abs(np.mean(np.square(pulls), axis=0) - 1.0) < 5 * np.sqrt(2.0 / 100))
    degrees = 2 * 60 - 14
    assert np.mean(chi2) == pytest.approx(degrees, abs=5 * np.sqrt(2.0 * degrees / 100))
