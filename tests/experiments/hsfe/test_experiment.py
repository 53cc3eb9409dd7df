"""The step test from the command line to its report: steps and roll that are known give their own figures."""

from __future__ import annotations

import numpy as np
import pytest

PITCH_PX, STEP_PX, POSITIONS = 45.1, 0.25, 4


@pytest.fixture(scope="module")
def run(tiny_run):
    """A hexapod that steps exactly and rolls much, bright stars."""
    small = {"target__rows": 2, "target__columns": 3, "target__pitch_px": PITCH_PX, "target__edge_px": 40}
    path = {"steps__positions": POSITIONS, "steps__step_px": STEP_PX}
    hexapod = {"hexapod__step_error_arcsec": 0, "hexapod__roll_error_arcsec": 30}
    light = {"source__signal_e": 20000, "frames": 10, "dark_frames": 40}
    return tiny_run("hsfe", **small, **path, **hexapod, **light, compare=["epsf"], draws=20)


def test_the_run_is_complete(run):
    assert run.status == 0
    assert (run.folder / "report.html").stat().st_size > 50_000
    names = {"causes.ecsv", "hexapods.ecsv", "hsfe.ecsv", "residuals.ecsv", "results.nc", "summary.json"}
    assert names < {path.name for path in run.folder.iterdir()}


def test_the_image_moves_by_the_steps(run):
    seen = np.diff(run.result.measured.mean_px["all"]["epsf"].mean(1), axis=0)  # mean over the stars
    sigma = run.result.measured.sigma_px["epsf"].mean() * np.sqrt(2.0 / (6 * 10))
    np.testing.assert_allclose(seen, STEP_PX / np.sqrt(2.0), atol=4.0 * sigma + 0.01 * STEP_PX)  # 1 %: distortion


def test_roll_leaves_lever_times_angle(run):
    """Of steps that roll by r, the mean over the stars leaves r (y - mean y) in x and r (x - mean x) in y."""
    roll = np.diff(run.result.measured.path.true_rad[:, 2])
    lever = np.array([PITCH_PX / 2, PITCH_PX * np.sqrt(2.0 / 3.0)])  # RMS of two rows and of three columns
    expected = np.sqrt((roll**2).mean()) * lever
    left = run.results["motion_left_px"]
    np.testing.assert_allclose([left["x"], left["y"]], expected, rtol=0.01)
    scale = 3.0 * run.results["pixel_arcsec"]
    noise2 = 2.0 / 10 * (run.result.measured.sigma_px["epsf"] ** 2).mean((0, 1)) * (1.0 - 1.0 / 6)
    whole = np.sqrt(expected**2 + noise2)
    found = run.results["methods_arcsec_3sigma"]["epsf"]["document"]
    for axis, letter in enumerate("xy"):  # the cross term of roll and noise, over stars and steps; 3 %: PRNU
        limit = 4.0 * np.sqrt(noise2[axis] / (6 * (POSITIONS - 1))) / whole[axis] + 0.03
        assert found[letter]["value"] == pytest.approx(scale * whole[axis], rel=limit)
