"""The step test from the command line to its report: steps and roll that are known give their own figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments.harness.progress import Progress
from experiments.hsfe.experiment import run as measure
from experiments.laboratory.bench.point_laboratory import point_laboratory
from experiments.laboratory.devices.hexapod import Hexapod
from experiments.laboratory.high_frequency import StepPlan
from experiments.laboratory.settings.tables import HexapodConfig
from render.engine.random import Streams

slow = pytest.mark.slow  # a whole run

PITCH_PX, STEP_PX, POSITIONS, FRAMES = 45.1, 0.25, 4, 10


@pytest.fixture(scope="module")
def run(tiny_run):
    """A hexapod that steps exactly and rolls much, bright stars."""
    small = {"target__rows": 2, "target__columns": 3, "target__pitch_px": PITCH_PX, "target__edge_px": 40}
    path = {"steps__positions": POSITIONS, "steps__step_px": STEP_PX}
    hexapod = {"hexapod__step_error_arcsec": 0, "hexapod__roll_error_arcsec": 30}
    light = {"source__signal_e": 20000, "frames": FRAMES, "dark_frames": 40, "instrument__diffraction": "rays"}
    return tiny_run("hsfe", **small, **path, **hexapod, **light, compare=["epsf"], draws=20)


def left_by_roll_px(config):
    """RMS (2,) of r (y - mean y) and r (x - mean x) over the steps of a run."""
    _, instrument = point_laboratory(config, config.target)
    plan, hexapod = StepPlan(**config.steps.model_dump()), Hexapod(**config.hexapod.model_dump())
    path = plan.path(instrument, hexapod, Streams(config.seed).child("hsfe").generator("hexapod"))
    roll = np.diff(path.true_rad[:, 2])
    lever = np.array([PITCH_PX / 2, PITCH_PX * np.sqrt(2.0 / 3.0)])  # RMS of two rows and of three columns
    return np.sqrt((roll**2).mean()) * lever


@slow
def test_roll_leaves_lever_times_angle(run):
    """Of steps that roll by r, the mean over the stars leaves r (y - mean y) in x and r (x - mean x) in y."""
    assert run.status == 0
    for ratio in run.result["steps"][0].ratio:
        assert ratio.value == pytest.approx(1.0, abs=5.0 * ratio.uncertainty)
    expected = left_by_roll_px(run.config)
    left = run.results["motion_left_px"]
    np.testing.assert_allclose([left["x"], left["y"]], expected, rtol=0.01)
    seen = run.results["methods_arcsec_3sigma"]["epsf"]
    for axis, letter in enumerate("xy"):  # the cross term of roll and noise, over stars and steps; 3 %: PRNU
        noise = seen["temporal_in_document"][letter]
        whole = np.hypot(3.0 * run.results["pixel_arcsec"] * expected[axis], noise)
        limit = 4.0 * noise / np.sqrt(6 * (POSITIONS - 1)) / whole + 0.03
        assert seen["document"][letter]["value"] == pytest.approx(whole, rel=limit)


@slow
def test_the_verdicts_hold_for_other_seeds_and_notice_a_quarter(run, failing):
    """Noise is what differs. Nine verdicts of a false alarm of 1 in 1000 each."""
    steps = run.config.steps.model_copy(update={"positions": 6})
    changed = {"steps": steps, "hexapod": HexapodConfig(), "compare": ("gaussian", "epsf")}
    alarms = []
    for seed in range(2):
        config = run.config.model_copy(update={"seed": seed, **changed})
        result = measure(config, progress=Progress())
        alarms.append(failing("hsfe", result, config))
    assert not any(alarms), alarms

    for factor in (0.75, 1.25):
        wrong = [replace(one, ratio=[replace(r, value=factor * r.value) for r in one.ratio]) for one in result["steps"]]
        failed = " ".join(failing("hsfe", {**result, "steps": wrong}, config))
        assert "HSFE of ACC18 over its prediction" in failed
