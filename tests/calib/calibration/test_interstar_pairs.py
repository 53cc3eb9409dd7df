"""Angles between stars as least-squares problems: closed forms against loops over pairs."""

from itertools import combinations

import numpy as np
import pytest
from calibration_scene import CAMERA, make_scene

from calib.calibration.interstar_pairs import PairProblem, StarFrames, WeightedPairProblem, pair_covariance
from calib.cameras.base import unproject_jacobian

ALL = np.ones(8, bool)


def written_out(scene, model):
    """Misclosures, their derivatives, and the covariance of all pairs, frame by frame with loops."""
    seen = unproject_jacobian(model, scene.observations.pixel_px)
    rows, noise, y = [], [], []
    for k in range(scene.observations.frames):
        for i, j in combinations(np.flatnonzero(scene.observations.frame == k), 2):
            u, v = seen.direction[i], seen.direction[j]
            y.append(u @ v - scene.observations.direction[i] @ scene.observations.direction[j])
            rows.append(v @ seen.by_parameter[i] + u @ seen.by_parameter[j])
            g = np.zeros((len(scene.observations), 2))
            g[i], g[j] = 0.05 * v @ seen.by_pixel[i], 0.05 * u @ seen.by_pixel[j]
            noise.append(g.ravel())
    return np.array(y), np.array(rows), np.array(noise)


def test_closed_forms_against_loops():
    """Normal matrix, gradient, covariance and weighted residuals of 4 frames of 7 stars, pair by pair."""
    scene = make_scene(frames=4, stars=7)
    model = CAMERA.with_parameters(CAMERA.parameters * 1.001)
    y, rows, noise = written_out(scene, model)
    number = np.zeros((7, 7), int)
    number[np.triu_indices(7, 1)] = np.arange(21)
    scale = np.sqrt(np.sum(rows**2, axis=0))
    for pairs in ("consecutive", "all"):
        stars = StarFrames(scene.observations, pairs)
        frame, first, second = stars.pair
        chosen = 21 * frame + (number + number.T)[first, second]
        problem = PairProblem(stars, model, ALL, 1.0)
        evaluation = problem.evaluate(np.array(model.parameters))
        np.testing.assert_allclose(evaluation.residual[:, 0], y[chosen], atol=1e-14)
        system = problem.system(evaluation, np.ones(len(chosen)))
        scaled = rows[chosen] / scale
        np.testing.assert_allclose(system.common / np.outer(scale, scale), scaled.T @ scaled, atol=1e-12)
        np.testing.assert_allclose(system.gradient / scale, scaled.T @ y[chosen], atol=1e-13)
        error = np.linalg.pinv(scaled) @ noise[chosen] / scale[:, None]
        sigma = np.sqrt(np.sum(error**2, axis=1))
        covariance = pair_covariance(problem, evaluation)
        np.testing.assert_allclose(
            covariance / np.outer(sigma, sigma), error @ error.T / np.outer(sigma, sigma), atol=1e-8
        )
    full = WeightedPairProblem(stars, model, ALL)
    inverse = np.linalg.pinv(noise @ noise.T, rcond=1e-9)
    weighted = full.evaluate(np.array(model.parameters))
    assert np.sum(weighted.residual**2) == pytest.approx(y @ inverse @ y, rel=1e-6)
    system = full.system(weighted, np.ones(28))
    expected = rows.T @ inverse @ rows
    scale = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(system.common / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-6)
    np.testing.assert_allclose(
        system.gradient / scale, rows.T @ inverse @ y / scale, atol=1e-6 * np.sqrt(y @ inverse @ y)
    )
