"""Angles between stars as least-squares problems: closed forms against loops over pairs."""

import numpy as np
import pytest

from calib.calibration.interstar_pairs import PairProblem, StarFrames, WeightedPairProblem, pair_covariance
from calib.cameras.base import unproject_jacobian

ALL = np.ones(8, bool)


def written_out(scene, model, stars):
    """Misclosures, their derivatives, and the covariance of all pairs, frame by frame with loops."""
    seen = unproject_jacobian(model, scene.observations.pixel_px)
    rows, noise, y = [], [], []
    for k in range(scene.observations.frames):
        place = np.flatnonzero(scene.observations.frame == k)
        for a in range(len(place)):
            for b in range(a + 1, len(place)):
                i, j = place[a], place[b]
                u, v = seen.direction[i], seen.direction[j]
                y.append(u @ v - scene.observations.direction[i] @ scene.observations.direction[j])
                rows.append(v @ seen.by_parameter[i] + u @ seen.by_parameter[j])
                g = np.zeros((len(scene.observations), 2))
                g[i], g[j] = 0.05 * v @ seen.by_pixel[i], 0.05 * u @ seen.by_pixel[j]
                noise.append(g.ravel())
    return np.array(y), np.array(rows), np.array(noise)


def test_closed_forms_against_loops(scenes):
    """Normal matrix, gradient, covariance and weighted residuals of 4 frames of 7 stars, pair by pair."""
    scene = scenes.make_scene(frames=4, stars=7)
    model = scenes.CAMERA.with_parameters(scenes.CAMERA.parameters * 1.001)
    y, rows, noise = written_out(scene, model, 7)
    stars = StarFrames(scene.observations, "all")
    problem = PairProblem(stars, model, ALL, 1.0)
    evaluation = problem.evaluate(np.array(model.parameters))
    np.testing.assert_allclose(evaluation.residual[:, 0], y, atol=1e-14)
    scale = np.sqrt(np.sum(rows**2, axis=0))
    for weight in (np.ones(len(y)), np.random.default_rng(0).uniform(0, 1, len(y))):
        system = problem.system(evaluation, weight)
        np.testing.assert_allclose(
            system.common / np.outer(scale, scale), (rows.T * weight) @ rows / np.outer(scale, scale), atol=1e-12
        )
        np.testing.assert_allclose(system.gradient / scale, (rows.T * weight) @ y / scale, atol=1e-13)
        gain = np.linalg.solve((rows.T * weight) @ rows / np.outer(scale, scale), rows.T * weight / scale[:, None])
        expected = (gain @ noise) @ (gain @ noise).T / np.outer(scale, scale)
        found = pair_covariance(problem, evaluation, weight)
        sigma = np.sqrt(np.diagonal(expected))
        np.testing.assert_allclose(found / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-8)
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
