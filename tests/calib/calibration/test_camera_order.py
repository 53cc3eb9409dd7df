"""Order of a camera model, floor of its errors and predicted frames, from stars behind known cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib import BrownConrady, Observations, Polynomial, SensorGeometry
from calib.calibration.camera_order import as_calibrated, calibrate_with_floor, cross_validate, simplest_adequate
from calib.calibration.frame_attitudes import (
    camera_residuals,
    frame_attitude,
    frame_attitudes,
    predicted_residuals,
    split_half_error_arcsec,
)
from calib.cameras.fit import as_brown_conrady, fit_to_map
from optics.attitude import attitude_error_arcsec

GEOMETRY = SensorGeometry(width_px=800, height_px=600, pixel_pitch_mm=0.01)
CAMERA = BrownConrady.create(GEOMETRY, focal_length_mm=30.0, q1_per_mm2=-4e-4)
TURNS = Rotation.random(5, rng=np.random.default_rng(3))


def stars(sigma_px=0.03, per_frame=60, floor_px=0.0, seed=1):
    rng = np.random.default_rng(seed)
    pixel = rng.uniform([0, 0], [799, 599], (5 * per_frame, 2))
    frame = np.repeat(np.arange(5), per_frame)
    direction = np.concatenate([turn.inv().apply(CAMERA.unproject(pixel[frame == k])) for k, turn in enumerate(TURNS)])
    pixel = pixel + np.hypot(sigma_px, floor_px) * rng.standard_normal(pixel.shape)
    return Observations.isotropic(pixel_px=pixel, direction=direction, frame=frame, sigma_px=sigma_px)


def test_the_order_of_the_lens_is_chosen():
    tried = [cross_validate(stars(), CAMERA, order) for order in ("pinhole", "radial_1", "radial_2")]
    assert [one.parameters for one in tried] == [3, 4, 5]
    assert simplest_adequate(tried).order == "radial_1"
    assert tried[0].mean_chi2 > 2.0
    # 5 frames of 60 stars and 117 degrees of freedom: 1 within 4 sqrt(2 / 585), and what the camera's error adds
    assert tried[1].mean_chi2 == pytest.approx(1.0, abs=0.25)
    assert tried[1].residual_px == pytest.approx(0.03, rel=0.12)


def test_error_beyond_the_noise_is_measured():
    """Median of 300 squared lengths: its relative error is 1 / (ln 2 sqrt(300)), of the floor about half of that."""
    made, floor = calibrate_with_floor(stars(floor_px=0.06), CAMERA, "radial_1", start_px=0.03)
    assert floor == pytest.approx(0.06, rel=0.2)
    assert made.converged
    sigma = np.sqrt(made.covariance[*[made.model.parameter_names.index("q1_per_mm2")] * 2])
    assert abs(made.model.value("q1_per_mm2") + 4e-4) < 4.0 * sigma


def test_frames_with_a_given_camera():
    observed = stars()
    attitudes = frame_attitudes(observed, CAMERA, list(TURNS))
    error = attitude_error_arcsec(attitudes, TURNS)
    arcsec_per_px = 206265.0 / 3000.0
    assert np.abs(error[:, :2]).max() < 5.0 * 0.03 / np.sqrt(60.0) * arcsec_per_px
    residual = camera_residuals(observed, CAMERA, attitudes)
    assert np.sqrt((residual**2).mean()) == pytest.approx(0.03, rel=0.1)
    one = observed.select(observed.frame == 2)
    shifted = replace(one, pixel_px=np.vstack([one.pixel_px[:1] + 5.0, one.pixel_px[1:]]), frame=one.frame * 0)
    _, used = predicted_residuals(shifted, CAMERA)
    assert not used[0]
    assert used[1:].sum() >= 57


def test_halves_of_the_stars_state_the_error_of_the_attitude():
    """Half differences of 40 draws against the error of the attitudes themselves: both within 4 / sqrt(80)."""
    halves, errors = [], []
    for seed in range(40):
        drawn = stars(seed=seed, per_frame=20)
        one = drawn.select(drawn.frame == 0)
        halves.append(split_half_error_arcsec(one, CAMERA))
        errors.append(attitude_error_arcsec(frame_attitude(one, CAMERA), TURNS[0]))
    ratio = np.sqrt((np.square(halves)[:, :2]).mean() / (np.square(errors)[:, :2]).mean())
    assert ratio == pytest.approx(1.0, abs=4.0 / np.sqrt(80.0))
    assert np.isnan(split_half_error_arcsec(one.select(slice(11)), CAMERA)).all()


def test_a_known_camera_as_its_stars_would_give_it():
    exact = as_calibrated(CAMERA, "radial_1", focal_length_mm=29.0)
    np.testing.assert_allclose(exact.parameters, CAMERA.parameters, atol=1e-6)
    grid = GEOMETRY.grid_px(9)
    start = Polynomial.create(GEOMETRY, degree=5, focal_length_mm=30.0)
    polynomial = fit_to_map(start, CAMERA.unproject(grid), grid, turn=False).model
    same = as_brown_conrady(polynomial)
    np.testing.assert_allclose(same.project(polynomial.unproject(grid)), grid, atol=0.02)
    assert as_brown_conrady(CAMERA) is CAMERA
