"""Changes, correlation and shared noise of drawn series: false alarms as stated, sizes as put in."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import described, judged
from experiments.harness.summary import Measured
from experiments.hsfe.own_frames import exchange_text
from experiments.reduce import checks, sequence
from experiments.reduce.poses import FIT, Fit
from experiments.reduce.sequence import lag_one, largest_change, shared_noise
from experiments.reduce.series import SeriesFrames

ALARM, RUNS = 0.02, 1000
MOST = RUNS * ALARM + 4 * np.sqrt(RUNS * ALARM)


@pytest.mark.parametrize("frames", [6, 30])
def test_white_noise_alarms_as_often_as_stated(frames):
    rng, names = np.random.default_rng(frames), [str(n) for n in range(frames)]
    tracks = rng.standard_normal((RUNS, frames))
    found = [largest_change(track, names, "s", "x", false_alarm=ALARM).found for track in tracks]
    assert 0 < sum(found) < MOST
    # limits of one that rises and of one that falls, with 40 000 correlations by hand, which white noise biases by -1/N
    rising, falling = (
        lag_one(track[:, None], "s", "x", independent=1, false_alarm=ALARM)
        for track in (np.arange(frames), (-1.0) ** np.arange(frames))
    )
    tracks = rng.standard_normal((40_000, frames))
    apart = tracks - tracks.mean(1, keepdims=True)
    value = (apart[:, 1:] * apart[:, :-1]).sum(1) / (apart**2).sum(1) + 1.0 / frames
    alarms = ((value > rising.limit) | (value < -falling.limit)).sum()
    assert alarms == pytest.approx(40_000 * ALARM, abs=4.0 * np.sqrt(40_000 * ALARM) + 0.05 * 40_000 * ALARM)


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


def test_noise_that_frames_share_alarms_no_more_often_than_stated(monkeypatch):
    """66 pairs of twelve frames with 121 pixels: the share of 100 that pass the limit of 20 % for all of them."""
    rng, usable, names = np.random.default_rng(3), np.ones((1, 11, 11), bool), list("abcdefghijkl")
    monkeypatch.setattr(sequence, "SHARED", 0.0)
    found = [
        shared_noise(rng.normal(1e4, 100.0, (12, 1, 11, 11)), usable, names, "s", false_alarm=0.2) for _ in range(100)
    ]
    passed = np.mean([one.value > one.limit for one in found])
    # the limit of a scatter that is measured itself, from 66 pairs, is a little wide
    assert 0.02 < passed < 0.2 + 4.0 * np.sqrt(0.2 * 0.8 / 100)


def test_common_motion_alarms_as_often_as_stated(monkeypatch):
    """Four frames of two points that do not move: 5 % of 4000 axes, within four standard deviations."""
    monkeypatch.setattr(checks, "FALSE_ALARM", 0.05)
    monkeypatch.setattr(checks, "MOTION_SHARE", 0.0)
    rng = np.random.default_rng(6)
    found = [one for _ in range(2000) for one in checks.common_motion(rng.standard_normal((4, 2, 2)), "s")]
    passed = np.mean([one.rms_px > one.limit_px for one in found])
    assert passed == pytest.approx(0.05, abs=4.0 * np.sqrt(0.05 * 0.95 / 4000))
    still = checks.common_motion(np.zeros((4, 2, 2)) + np.arange(4.0)[:, None, None], "s")
    assert still[0].rms_px == pytest.approx(np.sqrt(5.0 / 3.0))  # 0, 1, 2, 3


def test_scatter_over_the_noise_model_is_known_as_well_as_stated():
    """Two series of three and five frames, four points of unequal noise: 3000 ratios."""
    rng, noise = np.random.default_rng(7), np.array([1.0, 2.0, 0.5, 1.5])[:, None] * np.ones(2)

    def series(frames):
        seen = (noise * rng.standard_normal((frames, 4, 2))).std(0, ddof=1)
        return SimpleNamespace(
            frames=frames,
            effective_frames=frames,
            predicted_px=lambda _: noise,
            points=SimpleNamespace(sigma_px=lambda _: seen),
        )

    found = [checks._noise_ratio([series(3), series(5), SimpleNamespace(frames=1)], "cog") for _ in range(3000)]
    square = np.square([one.value for one in found])
    assert square.mean() == pytest.approx(1.0, abs=4.0 * square.std() / np.sqrt(3000))
    assert found[0].uncertainty == pytest.approx(0.5 * square.std(), rel=0.06)
    assert found[0].n == (3 + 5) * 4
    assert checks._noise_ratio([SimpleNamespace(frames=1)], "cog") is None
    correlated = series(5)
    correlated.effective_frames = 1.25
    one, other = (checks._noise_ratio([this], "cog").uncertainty for this in (correlated, series(5)))
    assert one == pytest.approx(2.0 * other)


def test_positions_in_the_wrong_order_are_named():
    commanded = 0.2 * np.outer(np.arange(12), [0.7, 0.7])
    said = exchange_text((3, 8), commanded, [f"step{n}" for n in range(12)])
    assert said == "step3 and step8 are interchanged: each lies at the commanded position of the other, 0.99 px away"


def test_common_motion_widens_the_error_of_a_scatter():
    """Half of the variance is common to five points: squared correlations of 1/4; a quarter of the frames counts."""
    rng = np.random.default_rng(4)
    place = {"alike": rng.standard_normal((2000, 1, 2)), "apart": np.zeros((2000, 1, 2))}
    place = {name: common + rng.standard_normal((2000, 5, 2)) for name, common in place.items()}
    series = SimpleNamespace(frames=2000, effective_frames=500.0, points=SimpleNamespace(position_px=place))
    assert SeriesFrames.widening(series, "alike") == pytest.approx(2.0 * np.sqrt(1.0 + 4.0 * 0.25), rel=0.05)
    assert SeriesFrames.widening(series, "apart") == pytest.approx(2.0)


@pytest.mark.parametrize(("ratio", "said"), [(0.5, "smaller than stated"), (1.0, ""), (1.5, "larger than stated")])
def test_a_calibration_by_poses_is_judged_both_ways(ratio, said):
    fit = Fit(misfit="m", flat=True, fit_ratio=Measured(value=ratio, uncertainty=0.07), coverage=1.0)
    data = described({"fit": FIT}, Quantities(), {"fit": fit}).dataset
    one = judged({"fit": FIT}, Outcome(config=None, result={"fit": fit}, data=data))[0]
    assert one.failed is bool(said)
    assert not said or said in one.advice
