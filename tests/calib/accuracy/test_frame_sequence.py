"""Jumps, drifts, correlation and scatter over frames: sizes, errors and false alarms as stated."""

from __future__ import annotations

import numpy as np
import pytest

from calib.accuracy.frame_sequence import common_part, effective_frames, lag_one, largest_change, scatter_ratio

ALARM, RUNS = 0.02, 1000


@pytest.mark.parametrize("frames", [6, 30])
def test_white_noise_alarms_as_often_as_stated(frames):
    rng = np.random.default_rng(frames)
    found = [largest_change(track, false_alarm=ALARM) for track in rng.standard_normal((RUNS, frames))]
    assert 0 < sum(abs(change.size) > change.limit for change in found) < RUNS * ALARM + 4 * np.sqrt(RUNS * ALARM)
    # limits of one that rises and of one that falls, with 40 000 correlations by hand, which white noise biases by -1/N
    rising, falling = (
        lag_one(track[:, None], independent=1, false_alarm=ALARM)
        for track in (np.arange(frames), (-1.0) ** np.arange(frames))
    )
    tracks = rng.standard_normal((40_000, frames))
    deviation = tracks - tracks.mean(1, keepdims=True)
    value = (deviation[:, 1:] * deviation[:, :-1]).sum(1) / (deviation**2).sum(1) + 1.0 / frames
    alarms = ((value > rising.limit) | (value < -falling.limit)).sum()
    assert alarms == pytest.approx(40_000 * ALARM, abs=4.0 * np.sqrt(40_000 * ALARM) + 0.05 * 40_000 * ALARM)


def test_the_size_of_a_change_is_within_its_error():
    rng, frames, pulls = np.random.default_rng(5), 30, []
    for kind, frame, shape in (
        ("step", 11, np.arange(frames) >= 11),
        ("frame", 4, np.arange(frames) == 4),
        ("frame", 0, np.arange(frames) == 0),
        ("drift", 29, np.linspace(0, 1, frames)),
    ):
        for _ in range(50):
            change = largest_change(8.0 * shape + rng.standard_normal(frames), false_alarm=1e-3)
            assert abs(change.size) > change.limit
            if (kind, frame) == (change.kind, change.frame):
                pulls.append((change.size - 8.0) / change.error)
    assert len(pulls) > 180
    assert np.mean(np.square(pulls)) == pytest.approx(28 / 26, abs=4 * np.sqrt(2.3 / len(pulls)))  # Student's t, 28


def test_too_few_frames_and_frames_that_do_not_change_tell_nothing():
    assert largest_change(np.arange(3.0), false_alarm=ALARM) is None
    assert largest_change(np.ones(9), false_alarm=ALARM) is None
    assert lag_one(np.ones((9, 1)), independent=1, false_alarm=ALARM) is None
    assert lag_one(np.arange(5.0)[:, None], independent=1, false_alarm=ALARM) is None


def test_a_mean_of_correlated_frames_is_as_good_as_of_the_effective_ones():
    """Frames correlated by 0.6: 4000 means of 200."""
    rng, rho = np.random.default_rng(3), 0.6
    track = rng.standard_normal((4000, 200))
    for k in range(1, 200):
        track[:, k] = rho * track[:, k - 1] + np.sqrt(1.0 - rho**2) * track[:, k]
    variance = track.mean(1).var()
    assert 1.0 / effective_frames(200, rho) == pytest.approx(variance, rel=4.0 * np.sqrt(2 / 4000) + 0.01)
    assert effective_frames(200, -0.3) == 200
    assert effective_frames(3, 0.99) == 1.0


def test_points_that_have_half_of_their_variance_in_common_have_squared_correlations_of_a_quarter():
    rng = np.random.default_rng(4)
    common, noise = rng.standard_normal((2000, 1, 2)), rng.standard_normal((2000, 5, 2))
    assert common_part(common + noise) == pytest.approx(0.25, abs=0.05)
    assert common_part(noise) == 0.0
    assert common_part(noise[:, :1]) == 0.0


def test_scatter_over_its_prediction_is_known_as_well_as_stated():
    """Samples of three and five frames of eight unequal normal numbers: 3000 ratios."""
    rng = np.random.default_rng(7)
    sigma, degrees = np.tile([1.0, 2.0, 0.5, 1.5], 4), np.repeat([2.0, 4.0], 8)
    variance = sigma**2 * rng.chisquare(degrees, (3000, 16)) / degrees
    found = [scatter_ratio(sample, sigma**2, degrees=degrees) for sample in variance]
    square = np.square([ratio for ratio, _ in found])
    assert square.mean() == pytest.approx(1.0, abs=4.0 * square.std() / np.sqrt(3000))
    assert found[0][1] == pytest.approx(0.5 * square.std(), rel=0.06)
    correlated = scatter_ratio(variance[0], sigma**2, degrees=degrees, effective_fraction=0.25)
    assert correlated[1] == pytest.approx(2.0 * found[0][1])
