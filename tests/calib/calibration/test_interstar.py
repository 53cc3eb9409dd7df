"""Calibration from interstar angles, as published and fully weighted."""

from __future__ import annotations

import numpy as np
import pytest

from calib.calibration.free_attitude import calibrate_free_attitude
from calib.calibration.interstar import calibrate_interstar
from calib.calibration.interstar_pairs import PairProblem, StarFrames, WeightedPairProblem, pair_covariance
from calib.cameras.base import unproject_jacobian
from optics.errors import ConfigError, DomainError

ALL = np.ones(8, bool)


@pytest.mark.parametrize("options", [{}, {"pairs": "consecutive"}, {"weighting": "full"}, {"two_step": False}])
def test_exact_data_give_the_truth(scenes, options):
    scene = scenes.make_scene(sigma_px=0.0)
    found = calibrate_interstar(scene.observations, scenes.START, **options)
    assert found.converged
    direction = scenes.CAMERA.unproject(scenes.GEOMETRY.grid_px(9))
    np.testing.assert_allclose(found.model.project(direction), scenes.CAMERA.project(direction), atol=1e-5)
    assert (found.attitude * scene.attitude.inv()).magnitude().max() < 1e-7
    assert found.installation is None


def test_full_weights_lose_nothing(scenes):
    """The same information as a free attitude in every frame: same estimate, covariance, sum of squares."""
    scene = scenes.make_scene(seed=4, frames=10, stars=15)
    few = scene.observations.select(np.random.default_rng(1).random(len(scene.observations)) < 0.7)  # 5 to 14 per frame
    free = calibrate_free_attitude(few, scenes.START).solution
    found = calibrate_interstar(few, scenes.START, weighting="full").solution
    assert np.abs((found.value - free.value) / free.sigma).max() < 0.02  # second order of the noise
    np.testing.assert_allclose(found.sigma, free.sigma, rtol=1e-3)
    assert found.chi2 == pytest.approx(free.chi2, rel=1e-3)
    assert found.degrees_of_freedom == free.degrees_of_freedom


def test_two_stars_per_frame(scenes):
    scene = scenes.make_scene(frames=40, stars=2)
    free = calibrate_free_attitude(scene.observations, scenes.START).solution
    found = calibrate_interstar(scene.observations, scenes.START, weighting="full").solution
    assert found.converged
    np.testing.assert_allclose(found.sigma, free.sigma, rtol=2e-2)
    assert np.abs((found.value - free.value) / free.sigma).max() < 0.2


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


def test_unweighted_is_worse_and_says_by_how_much(scenes):
    """40 realisations: the covariance with the correlations of pairs is right, the naive one would be too small."""
    scene = scenes.make_scene(frames=8, stars=12)
    rng = np.random.default_rng(7)
    pulls, excess = [], []
    for _ in range(40):
        observed = scene.noisy(rng)
        found = calibrate_interstar(observed, scenes.CAMERA, two_step=False).solution
        pulls.append(found.pulls(scenes.CAMERA.parameters))
        excess.append(found.sigma)
    assert np.all(np.abs(np.mean(np.square(pulls), axis=0) - 1.0) < 5 * np.sqrt(2.0 / 40))
    free = calibrate_free_attitude(observed, scenes.CAMERA).solution.sigma
    assert np.all(np.mean(excess, axis=0) > 1.05 * free)


def test_a_mirrored_sky_is_refused_though_all_angles_fit(scenes):
    scene = scenes.make_scene()
    flipped = scene.observations.pixel_px * [-1.0, 1.0] + [1023.0, 0.0]
    from dataclasses import replace

    found = calibrate_interstar(replace(scene.observations, pixel_px=flipped), scenes.START).solution
    assert found.status == "refused"
    assert "the sky is mirrored" in found.message
    assert found.reduced_chi2 < 1.5


@pytest.mark.parametrize("weighting", ["none", "full"])
def test_ten_percent_wrong_matches_are_survived(scenes, weighting):
    scene = scenes.make_scene(frames=20, stars=25)
    observed, wrong = scene.with_wrong_matches(0.1, np.random.default_rng(3))
    found = calibrate_interstar(observed, scenes.START, weighting=weighting, loss="tukey")
    assert found.converged
    assert f"{wrong.sum()} stars do not fit" in found.solution.message
    np.testing.assert_array_equal(found.used, ~wrong)
    assert np.all(np.abs(found.solution.pulls(scenes.CAMERA.parameters)) < 5)
    assert calibrate_interstar(observed, scenes.START).solution.status == "refused"


def test_sixty_percent_wrong_matches_are_refused(scenes):
    scene = scenes.make_scene(frames=12, stars=25)
    observed, _ = scene.with_wrong_matches(0.6, np.random.default_rng(3))
    found = calibrate_interstar(observed, scenes.START, loss="tukey").solution
    assert found.status == "refused"
    assert "wrong" in found.message


def test_too_few_stars(scenes):
    scene = scenes.make_scene(frames=8, stars=2)
    found = calibrate_interstar(scene.observations, scenes.START).solution
    assert found.status == "refused"
    assert "8 independent angles for 8 unknowns" in found.message
    alone = scenes.make_scene(frames=30, stars=1)
    found = calibrate_interstar(alone.observations, scenes.START).solution
    assert found.status == "refused"
    assert "0 independent angles" in found.message


def test_bad_input(scenes):
    scene = scenes.make_scene(frames=4, stars=5)
    with pytest.raises(ConfigError, match="weighting 'some'"):
        calibrate_interstar(scene.observations, scenes.START, weighting="some")
    crowded = scenes.make_scene(frames=1, stars=6000)
    with pytest.raises(DomainError, match="keep the brightest 5477 stars"):
        calibrate_interstar(crowded.observations, scenes.START)
