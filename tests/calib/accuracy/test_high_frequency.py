"""ACC18 eq. 3-12 on numbers whose statistics are known."""

from __future__ import annotations

import numpy as np
import pytest

from calib.accuracy import high_frequency

M, W = 400, 25
STARS = np.random.default_rng(5).uniform(0.0, 2000.0, (W, 2))


def test_common_motion_and_errors_that_neighbours_share_do_not_show_in_the_steps():
    walk = np.random.default_rng(0).normal(size=(M, 1, 2)).cumsum(0)
    assert np.abs(high_frequency.step_residual_px(STARS + walk)).max() < 1e-9
    error = np.tile(0.1 * np.random.default_rng(2).normal(size=(1, W, 2)), (M, 1, 1))
    assert high_frequency.step_rms_px(STARS + error).max() < 1e-9
    assert high_frequency.position_rms_px(error).min() > 0.05


def test_a_star_that_jumps_once_is_seen_in_one_step():
    mean = np.tile(STARS, (4, 1, 1))
    mean[2:, 3, 0] += 0.5
    left = high_frequency.step_residual_px(mean)
    assert left[1, 3, 0] == pytest.approx(0.5 * (1 - 1 / W))
    assert np.abs(left[[0, 2]]).max() < 1e-12
    assert np.abs(left[..., 1]).max() < 1e-12


def test_independent_errors_show_sqrt_2_times_in_the_steps_and_once_when_halved():
    rng = np.random.default_rng(1)
    sigma, noise, frames = np.array([0.02, 0.03]), 0.05, 30
    error = sigma * rng.normal(size=(M, W, 2))
    mean = STARS + error + noise / np.sqrt(frames) * rng.normal(size=(M, W, 2))
    margin = 4.0 / np.sqrt(M * W)  # two axes, differences share positions: variance of the square is below 3 / (M W)
    document = high_frequency.step_rms_px(mean)
    expected = np.sqrt(2.0 * (sigma**2 + noise**2 / frames) * (1 - 1 / W))
    np.testing.assert_allclose(document, expected, rtol=margin)
    np.testing.assert_allclose(
        high_frequency.independent_position_rms_px(document, np.full((M, W, 2), noise), frames), sigma, rtol=2 * margin
    )
    np.testing.assert_allclose(
        high_frequency.position_rms_px(mean - STARS, np.full((M, W, 2), noise), frames), sigma, rtol=2 * margin
    )


def test_the_jackknife_gives_the_scatter_from_one_set_of_stars_to_the_next():
    rng = np.random.default_rng(3)
    runs = [STARS + 0.02 * rng.normal(size=(12, W, 2)) for _ in range(200)]
    scatter = np.std([high_frequency.step_rms_px(run) for run in runs], axis=0)
    estimate = np.sqrt(np.mean([high_frequency.step_rms_standard_error_px(run) ** 2 for run in runs], axis=0))
    printed = high_frequency.high_frequency_error(runs[0], 5.5)
    np.testing.assert_allclose(printed.arcsec, 16.5 * high_frequency.step_rms_px(runs[0]))
    np.testing.assert_allclose(printed.uncertainty_arcsec, 16.5 * high_frequency.step_rms_standard_error_px(runs[0]))
    assert printed.n == W * 11
    np.testing.assert_allclose(estimate, scatter, rtol=0.25)  # 200 runs: 5 % each, and the jackknife's bias upwards


def test_degrees_of_freedom_of_correlated_steps():
    """Scatter of a sum of squares is sqrt(2 / degrees): of five stars in 12 steps that share half with the next one."""
    rng, free = np.random.default_rng(4), 5
    drawn = rng.standard_normal((4000, 13, free))
    left = drawn[:, 1:] + drawn[:, :-1]
    square = (left**2).sum((1, 2))
    degrees = 1.0 / np.mean([1.0 / high_frequency._degrees(one, free) for one in left])
    assert degrees == pytest.approx(2.0 * square.mean() ** 2 / square.var(), rel=0.08)


POSITIONS, POSITION_STARS, FRAMES, RUNS = 8, 16, 10, 250


def scene(rng, error_px, frame_px, *, neighbours=0.0, stars=POSITION_STARS):
    """Centroids (m, f, W, 2): places of the stars, a path with scale and roll, errors of positions, noise of frames."""
    base = rng.uniform(0, 1000, (stars, 2))
    path = np.cumsum(rng.normal(0.2, 0.05, (POSITIONS, 2)), 0)
    strain = rng.normal(0, 1e-5, (2, 2))
    error = rng.normal(0.0, error_px, (POSITIONS, stars, 2))
    for m in range(1, POSITIONS):
        error[m] = neighbours * error[m - 1] + np.sqrt(1 - neighbours**2) * error[m]
    moved = base + path[:, None] + np.arange(POSITIONS)[:, None, None] * ((base - 500) @ strain) + error
    return moved[:, None] + rng.normal(0.0, frame_px, (POSITIONS, FRAMES, stars, 2))


def estimates(error_px, frame_px, seed=3, **scenes):
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(RUNS):
        centroid = scene(rng, error_px, frame_px, **scenes)
        found.append(
            high_frequency.position_error(centroid.mean(1), centroid.std(1, ddof=1), np.full(POSITIONS, FRAMES))
        )
    return found


@pytest.mark.parametrize(("error_px", "neighbours"), [(0.02, 0.0), (0.02, 0.7), (0.006, 0.0)])
def test_estimate_and_interval_hold_the_truth(error_px, neighbours):
    """Variance without bias within its standard error; 95 % intervals hold the truth in 95 % of 500, 4 sigma of that.
    The truth is the error about its mean over the path: of errors alike at neighbours with the correlation r^|k| that
    is the variance times 1 minus the mean correlation of two different positions."""
    found = estimates(error_px, 0.05, neighbours=neighbours)
    lag = np.abs(np.subtract.outer(np.arange(POSITIONS), np.arange(POSITIONS)))
    alike = (float(neighbours) ** lag)[~np.eye(POSITIONS, dtype=bool)].mean()
    truth = error_px * np.sqrt(1.0 - alike)
    variance = np.array([one.variance_px2 for one in found]).ravel()
    assert variance.mean() == pytest.approx(truth**2, abs=4 * variance.std() / np.sqrt(variance.size))
    inside = [(one.low_px <= truth) & (truth <= one.high_px) for one in found]
    below = [truth <= one.upper_px for one in found]
    spread = np.sqrt(0.95 * 0.05 / variance.size)
    floor = 0.95 - 4 * spread - (0.03 if neighbours else 0.0)  # degrees of freedom are estimated from 13 free stars
    assert floor <= np.mean(inside) <= 0.95 + 4 * spread
    assert floor <= np.mean(below) <= 1.0


def test_axes_do_not_know_of_one_another():
    """Axes exchanged, one of them with an error that neighbours share: every number goes along, degrees too."""
    centroid = scene(np.random.default_rng(4), [0.02, 0.08], 0.05, neighbours=0.5)
    one, other = (
        high_frequency.position_error(at.mean(1), at.std(1, ddof=1), np.full(POSITIONS, FRAMES))
        for at in (centroid, centroid[..., ::-1])
    )
    assert one.degrees[0] != pytest.approx(one.degrees[1], rel=0.01)
    for name in ("variance_px2", "low_px", "high_px", "upper_px", "degrees"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name)[::-1], rtol=1e-6, err_msg=name)


def test_no_error_is_consistent_with_zero():
    """Without this error the interval begins at zero in 97 % of the cases; the limit is below the noise of a mean."""
    found = estimates(0.0, 0.05)
    assert np.mean([one.low_px == 0.0 for one in found]) > 0.95
    upper = np.array([one.upper_px for one in found])
    assert upper.min() > 0.0  # also where the estimate is far below zero
    assert np.median(upper) < 0.05 / np.sqrt(FRAMES)
    assert np.isnan(found[0].value_px).any() or found[0].variance_px2.min() > 0


def test_exchanged_positions_are_found():
    """Steps of 0.2 px along a diagonal by a stage of another scale, turned by 10 degrees; noise of 0.01 px."""
    rng = np.random.default_rng(8)
    commanded = 0.2 * np.outer(np.arange(12), [0.7, 0.7])
    turn = 0.97 * np.array([[0.985, -0.174], [0.174, 0.985]])
    measured = commanded @ turn.T + 0.01 * rng.standard_normal((12, 2))
    assert high_frequency.exchanged_positions(measured, commanded) is None
    measured[[3, 8]] = measured[[8, 3]]
    assert high_frequency.exchanged_positions(measured, commanded) == (3, 8)
    assert high_frequency.exchanged_positions(measured[:4], commanded[:4]) is None
    assert high_frequency.exchanged_positions(measured, commanded * np.nan) is None


def test_motion_that_all_stars_share_is_not_noise_of_a_star():
    """Frames whose line of sight walks by 1 px: the scatter is that of the stars' own 0.02 px, known to 1 %."""
    rng = np.random.default_rng(9)
    walk = rng.standard_normal((40, 10, 1, 2))
    sigma = high_frequency.sigma_without_common_motion_px(walk + 0.02 * rng.standard_normal((40, 10, W, 2)))
    assert sigma.shape == (10, W, 2)
    assert np.sqrt((sigma**2).mean()) == pytest.approx(0.02, rel=4.0 / np.sqrt(2 * 39 * 10 * W * 2))
