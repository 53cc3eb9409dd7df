"""Changes, correlation and shared noise of drawn series: false alarms as stated, sizes as put in."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.hsfe.own_frames import misplaced
from experiments.laboratory.temporal_error import scatter_interval, small_sample_factor
from experiments.reduce.sequence import lag_one, largest_change, shared_noise

ALARM, RUNS = 0.02, 1000
MOST = RUNS * ALARM + 4 * np.sqrt(RUNS * ALARM)


@pytest.mark.parametrize("frames", [6, 30])
def test_white_noise_alarms_as_often_as_stated(frames):
    rng, names = np.random.default_rng(frames), [str(n) for n in range(frames)]
    tracks = rng.standard_normal((RUNS, frames))
    found = [largest_change(track, names, "s", "x", false_alarm=ALARM).found for track in tracks]
    assert 0 < sum(found) < MOST
    lags = [lag_one(track[:, None], "s", "x", independent=1, false_alarm=ALARM) for track in tracks]
    assert RUNS * ALARM / 3 < sum(abs(one.value) > one.limit for one in lags) < MOST


def test_changes_are_named_and_their_size_is_within_its_error():
    rng, frames, pulls = np.random.default_rng(5), 30, []
    names = [str(n) for n in range(frames)]
    for kind, shape in (
        ("step", np.arange(frames) >= 11),
        ("frame", np.arange(frames) == 4),
        ("frame", np.arange(frames) == 0),
        ("drift", np.linspace(0, 1, frames)),
    ):
        for _ in range(50):
            one = largest_change(8.0 * shape + rng.standard_normal(frames), names, "s", "x", false_alarm=1e-3)
            assert one.found
            if kind == one.kind:
                pulls.append((one.size - 8.0) / one.error)
    assert len(pulls) > 190
    assert np.mean(np.square(pulls)) == pytest.approx(28 / 26, abs=4 * np.sqrt(2.3 / len(pulls)))  # Student's t, 28


def test_frames_of_independent_noise_share_none_and_a_copy_with_noise_shares_most():
    rng = np.random.default_rng(2)
    usable, names = np.ones((4, 11, 11), bool), [str(n) for n in range(12)]
    for _ in range(20):
        dn = np.rint(100 + 3 * rng.standard_normal((12, 4, 11, 11)))
        assert (one := shared_noise(dn, usable, names, "s", false_alarm=1e-3)).value < one.limit
    dn[7] = np.rint(dn[2] + 1.5 * rng.standard_normal(dn[2].shape))  # correlation 1 / sqrt(1.25)
    one = shared_noise(dn, usable, names, "s", false_alarm=1e-3)
    assert one.frames == ("2", "7")
    assert one.value == pytest.approx(1 / np.sqrt(1.25), abs=0.1)


@pytest.mark.parametrize(("frames", "stars"), [(2, 1), (3, 5), (30, 9)])
def test_intervals_of_a_scatter_cover_it(frames, stars):
    """Mean of the stars' standard deviations, as of ACC18 eq. 2; exact for a single star."""
    rng, runs = np.random.default_rng(frames), 500
    true = rng.uniform(0.5, 1.5, stars)
    s = (true * rng.standard_normal((runs, frames, stars))).std(1, ddof=1)
    c4 = small_sample_factor(frames)
    error = np.sqrt((s**2).sum(1)) / stars * np.sqrt(1 - c4**2) / c4
    low, high = scatter_interval(s.mean(1) / c4, error / s.mean(1))
    covered = np.mean((low <= true.mean()) & (true.mean() <= high))
    assert 0.95 - 4 * np.sqrt(0.05 * 0.95 / runs) < covered
    if stars == 1:
        assert covered < 0.95 + 4 * np.sqrt(0.05 * 0.95 / runs)


def test_positions_in_the_wrong_order_are_named():
    """Steps of 0.2 px along a diagonal by a stage of another scale, turned by 10 degrees; noise of 0.01 px."""
    rng, names = np.random.default_rng(8), [f"step{n}" for n in range(12)]
    commanded = 0.2 * np.outer(np.arange(12), [0.7, 0.7])
    turn = 0.97 * np.array([[0.985, -0.174], [0.174, 0.985]])
    seen = commanded @ turn.T + 0.01 * rng.standard_normal((12, 2))
    assert misplaced(seen, commanded, names) == []
    seen[[3, 8]] = seen[[8, 3]]
    (said,) = misplaced(seen, commanded, names)
    assert said == "step3 and step8 stand each where the other was commanded, 0.99 px away"
