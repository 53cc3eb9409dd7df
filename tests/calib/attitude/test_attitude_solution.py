"""Wahba's problem: exactness, covariance, loss, parity, degenerate frames, bad input."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from star_directions import field_directions, noisy_directions

from calib.attitude.attitude_solution import solve_wahba, solve_wahba_many
from optics.attitude import attitude_error_arcsec
from optics.units import RAD_ARCSEC

METHODS = ("svd", "quest")
SIGMA_RAD = 5e-6


def many_frames(rng, *, frames=400, stars=20, half_width_deg=10.0):
    truth = Rotation.random(frames, rng=rng)
    v_cam = field_directions(rng, frames * stars, half_width_deg)
    frame = np.repeat(np.arange(frames), stars)
    return truth, v_cam, truth[frame].inv().apply(v_cam), frame


@pytest.mark.parametrize("method", METHODS)
def test_same_as_scipy_with_weights(method):
    rng = np.random.default_rng(2)
    v_cam, turn = field_directions(rng, 12, 8.0), Rotation.random(rng=rng)
    noisy, sigma = noisy_directions(rng, v_cam, 1e-3), rng.uniform(0.5e-3, 2e-3, 12)
    v_ref = turn.inv().apply(v_cam)
    theirs, rssd = Rotation.align_vectors(noisy, v_ref, weights=sigma**-2)
    ours = solve_wahba(noisy, v_ref, sigma_rad=sigma, method=method)
    assert np.abs(attitude_error_arcsec(ours.rotation, theirs)).max() < 1e-11 * RAD_ARCSEC
    assert 2 * ours.loss == pytest.approx(rssd**2, rel=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (0.3, -0.5, 0.8)])
@pytest.mark.parametrize("short_of_180_rad", [0.0, 1e-9])
def test_half_turn(method, axis, short_of_180_rad):
    truth = Rotation.from_rotvec((np.pi - short_of_180_rad) * np.array(axis) / np.linalg.norm(axis))
    v_cam = field_directions(np.random.default_rng(5), 8, 6.0)
    solved = solve_wahba(v_cam, truth.inv().apply(v_cam), sigma_rad=SIGMA_RAD, method=method)
    assert np.abs(attitude_error_arcsec(solved.rotation, truth)).max() < 1e-12 * RAD_ARCSEC


@pytest.mark.parametrize("method", METHODS)
def test_two_stars_and_three_axes(method):
    """The fewest stars, and directions with a threefold root among the singular values."""
    truth = Rotation.from_euler("xyz", [20, -50, 130], degrees=True)
    for v_cam in (np.eye(3)[:2], np.eye(3), -np.eye(3)):
        solved = solve_wahba(v_cam, truth.inv().apply(v_cam), sigma_rad=SIGMA_RAD, method=method)
        assert np.abs(attitude_error_arcsec(solved.rotation, truth)).max() < 1e-13 * RAD_ARCSEC
        assert solved.ok


@pytest.mark.parametrize("stars", [2, 3, 20])
def test_errors_follow_the_covariance(stars):
    """Pulls of N = 4000 frames: standard deviation 1 +- 4 / sqrt(2 N); whitened jointly, so the correlations too."""
    frames = 4000
    rng = np.random.default_rng(6)
    truth, v_cam, v_ref, frame = many_frames(rng, frames=frames, stars=stars, half_width_deg=6.0)
    if stars == 2:  # a pair close together has no linear error in roll
        v_cam[::2, 0] += 0.2
        v_cam /= np.linalg.norm(v_cam, axis=1, keepdims=True)
        v_ref = truth[frame].inv().apply(v_cam)
    sigma = rng.uniform(0.5, 2.0, len(v_cam)) * SIGMA_RAD
    solved = solve_wahba_many(noisy_directions(rng, v_cam, sigma[:, None]), v_ref, frame, sigma_rad=sigma)
    error = attitude_error_arcsec(solved.rotation, truth) / RAD_ARCSEC
    pulls = np.einsum("fij,fj->fi", np.linalg.inv(np.linalg.cholesky(solved.covariance_rad2)), error)
    tolerance = 4 / np.sqrt(2 * frames)
    assert np.abs(pulls.std(axis=0) - 1).max() < tolerance
    assert np.abs(pulls.mean(axis=0)).max() < 4 / np.sqrt(frames)
    assert np.abs(np.corrcoef(pulls.T) - np.eye(3)).max() < 4 / np.sqrt(frames)


def test_roll_is_worse_than_the_boresight_by_the_field():
    """Stars on a ring at radius a: roll over cross-boresight error is sqrt((1 + cos^2 a) / 2) / sin a."""
    a, phase = np.radians(5.0), np.arange(12) * np.pi / 6
    ring = np.column_stack([np.sin(a) * np.cos(phase), np.sin(a) * np.sin(phase), np.full(12, np.cos(a))])
    sigma = solve_wahba(ring, ring, sigma_rad=SIGMA_RAD).sigma_arcsec
    assert sigma[0] == pytest.approx(sigma[1], rel=1e-9)
    assert sigma[2] / sigma[0] == pytest.approx(np.sqrt((1 + np.cos(a) ** 2) / 2) / np.sin(a), rel=1e-9)


def test_loss_is_half_a_chi_square():
    """Mean over N frames within 4 sigma of its expectation, and the probabilities even."""
    frames, stars = 3000, 9
    rng = np.random.default_rng(7)
    _, v_cam, v_ref, frame = many_frames(rng, frames=frames, stars=stars)
    solved = solve_wahba_many(noisy_directions(rng, v_cam, SIGMA_RAD), v_ref, frame, sigma_rad=SIGMA_RAD)
    law = chi2(2 * stars - 3)
    assert (solved.expected_loss == law.mean() / 2).all()
    assert solved.loss.mean() == pytest.approx(law.mean() / 2, abs=4 * law.std() / 2 / np.sqrt(frames))
    assert solved.probability == pytest.approx(law.sf(2 * solved.loss), abs=1e-12)
    assert solved.ok.all()


def test_unknown_sigma_is_estimated():
    frames, stars = 500, 20
    rng = np.random.default_rng(8)
    truth, v_cam, v_ref, frame = many_frames(rng, frames=frames, stars=stars)
    noisy = noisy_directions(rng, v_cam, SIGMA_RAD)
    solved = solve_wahba_many(noisy, v_ref, frame)
    degrees = frames * (2 * stars - 3)
    assert np.mean(solved.sigma_rad**2) == pytest.approx(SIGMA_RAD**2, rel=4 * np.sqrt(2 / degrees))
    assert np.isnan(solved.probability).all()
    assert solved.frame(0).misfit.degrees_of_freedom == 0  # nothing is tested
    pulls = attitude_error_arcsec(solved.rotation, truth) / solved.sigma_arcsec
    assert pulls.std() == pytest.approx(1, abs=4 / np.sqrt(2 * pulls.size) + 0.02)  # Student's t of 37 degrees: +1.4 %
    scaled = solve_wahba_many(noisy, v_ref, frame, weight=np.full(len(frame), 7.0))
    assert np.allclose(scaled.covariance_rad2, solved.covariance_rad2, rtol=1e-9, atol=0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("stated", [True, False])
def test_mirrored_sky_is_reported(method, stated):
    rng = np.random.default_rng(9)
    _, v_cam, v_ref, frame = many_frames(rng, frames=300, stars=6)
    noisy = noisy_directions(rng, v_cam, SIGMA_RAD)
    sigma = SIGMA_RAD if stated else None
    for flipped in (noisy * [-1, 1, 1], noisy * [1, -1, 1], noisy[:, [1, 0, 2]]):
        solved = solve_wahba_many(flipped, v_ref, frame, sigma_rad=sigma, method=method)
        assert (solved.status == "mirrored").all()
        assert (solved.parity == -1).all()
    assert "mirrored" in solved.frame(0).message
    upright = solve_wahba_many(noisy[:, [1, 0, 2]] * [-1, 1, 1], v_ref, frame, sigma_rad=sigma, method=method)
    assert upright.ok.all()  # two flips are a rotation


def test_mirrored_sky_of_a_wrong_focal_length_and_of_two_stars():
    """A start model that is off by 2 % does not hide the flip."""
    rng = np.random.default_rng(10)
    v_cam, turn = field_directions(rng, 15, 10.0), Rotation.random(rng=rng)
    wrong = v_cam * [1.02, 1.02, 1]
    wrong /= np.linalg.norm(wrong, axis=1, keepdims=True)
    v_ref = turn.inv().apply(v_cam)
    assert solve_wahba(wrong, v_ref, sigma_rad=SIGMA_RAD).status == "inconsistent"
    assert solve_wahba(wrong * [-1, 1, 1], v_ref, sigma_rad=SIGMA_RAD).status == "mirrored"
    rng = np.random.default_rng(11)
    v_cam = field_directions(rng, 2, 10.0)
    v_ref = Rotation.random(rng=rng).inv().apply(v_cam * [-1, 1, 1])
    solved = solve_wahba(noisy_directions(rng, v_cam, SIGMA_RAD), v_ref, sigma_rad=SIGMA_RAD)
    assert solved.ok
    assert solved.parity == 0


@pytest.mark.parametrize("n", [3, 4, 5, 20])
def test_two_exchanged_stars_are_named_and_not_called_a_mirrored_sky(n):
    """A third of such frames of three stars fit a reflection better than any rotation; rows count in the list."""
    rng = np.random.default_rng(9)
    _, v_cam, v_ref, frame = many_frames(rng, frames=60, stars=n)
    seen, given = noisy_directions(rng, v_cam, SIGMA_RAD), np.array(v_ref)
    first = n * np.arange(60)
    given[first + 1], given[first + n - 1] = v_ref[first + n - 1], v_ref[first + 1]
    order = rng.permutation(60 * n)
    solved = solve_wahba_many(seen[order], given[order], frame[order], sigma_rad=SIGMA_RAD)
    assert (solved.status == "exchanged").all()
    wanted = np.stack([first + 1, first + n - 1], axis=1)
    np.testing.assert_array_equal(np.sort(order[solved.exchanged], axis=1), wanted)
    pair = solved.exchanged[7]
    assert f"stars {pair[0]} and {pair[1]}" in solved.frame(7).message


def test_exchanged_stars_are_found_without_a_sigma_too():
    rng = np.random.default_rng(10)
    v_cam = field_directions(rng, 12, 8.0)
    given = v_cam[[0, 1, 9, 3, 4, 5, 6, 7, 8, 2, 10, 11]]
    found = solve_wahba(noisy_directions(rng, v_cam, SIGMA_RAD), given)
    assert found.status == "exchanged"
    assert found.exchanged.tolist() == [2, 9]
    assert solve_wahba(noisy_directions(rng, v_cam, SIGMA_RAD), v_cam).exchanged.tolist() == [-1, -1]


@pytest.mark.parametrize("wrong", [0.01, 0.1, 1.0, 10.0, 100.0])
def test_a_stated_sigma_that_is_wrong_is_said(wrong):
    rng = np.random.default_rng(11)
    v_cam = field_directions(rng, 15, 8.0)
    found = solve_wahba(noisy_directions(rng, v_cam, SIGMA_RAD), v_cam, sigma_rad=SIGMA_RAD * wrong)
    assert found.misfit.degrees_of_freedom == 27
    assert found.status == ("inconsistent" if wrong < 1 else "ok")
    assert ("too small a sigma" in found.message) == (wrong < 1)
    assert ("stated too large" in repr(found)) == (wrong > 1)


def test_wrong_matches_are_inconsistent_and_close_pairs_degenerate():
    rng = np.random.default_rng(12)
    v = field_directions(rng, 10, 8.0)
    solved = solve_wahba(v, np.roll(v, 3, axis=0), sigma_rad=SIGMA_RAD)
    assert solved.status == "inconsistent"
    assert "wrong matches" in solved.message
    assert not solved.ok
    v = field_directions(np.random.default_rng(13), 2, 1e-4)
    assert solve_wahba(v, v, sigma_rad=1e-5).status == "degenerate"
    assert solve_wahba(v, v, sigma_rad=1e-9).ok


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "v_cam",
    [np.empty((0, 3)), [[0, 0, 1.0]], [[0, 0, 1.0], [0, 0, 1.0]], [[0, 0.6, 0.8], [0, -0.6, -0.8], [0, 0.6, 0.8]]],
    ids=["none", "one", "twice the same", "two ends of a line"],
)
def test_degenerate_frames_are_reported(method, v_cam):
    v_cam = np.reshape(v_cam, (-1, 3)).astype(float)
    turn = Rotation.from_euler("y", 40, degrees=True)
    solved = solve_wahba(v_cam, turn.inv().apply(v_cam) if len(v_cam) else v_cam, sigma_rad=SIGMA_RAD, method=method)
    assert solved.status == "degenerate"
    assert np.isinf(solved.sigma_arcsec).all()
    assert np.allclose(solved.rotation.apply(turn.inv().apply(v_cam)) if len(v_cam) else v_cam, v_cam, atol=1e-9)


def test_frames_of_any_size_in_any_order():
    """A ragged batch, shuffled, with an empty frame, equals the frames one by one."""
    rng = np.random.default_rng(14)
    sizes = [5, 0, 2, 1, 30]
    frame = np.repeat(np.arange(5), sizes)
    truth = Rotation.random(5, rng=rng)
    v_cam = field_directions(rng, len(frame), 9.0)
    v_ref = truth[frame].inv().apply(v_cam)
    noisy, order = noisy_directions(rng, v_cam, SIGMA_RAD), rng.permutation(len(frame))
    many = solve_wahba_many(noisy[order], v_ref[order], frame[order], frames=6, sigma_rad=SIGMA_RAD)
    assert many.stars.tolist() == [*sizes, 0]
    assert many.status.tolist() == ["ok", "degenerate", "ok", "degenerate", "ok", "degenerate"]
    for k in (0, 2, 4):
        one = solve_wahba(noisy[frame == k], v_ref[frame == k], sigma_rad=SIGMA_RAD)
        assert np.abs(attitude_error_arcsec(one.rotation, many.frame(k).rotation)).max() < 1e-13 * RAD_ARCSEC
        assert one.loss == pytest.approx(many.frame(k).loss, rel=1e-6)
        assert one.covariance_rad2 == pytest.approx(many.frame(k).covariance_rad2, rel=1e-9)
