"""The step test from the command line to its report: steps and roll that are known give their own figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments.harness.progress import Progress
from experiments.hsfe.experiment import experiment
from experiments.laboratory.step_statistics import common_removed, document_rms_px
from render.sensor import StarSensor

pytestmark = pytest.mark.slow  # a whole run

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


# What an equation may be mistaken for, and the criterion that has to notice it.


def every_second(mean_px):
    return np.sqrt((common_removed(mean_px[2:] - mean_px[:-2]) ** 2).mean((0, 1)))


def with_the_platform(mean_px):
    return np.sqrt((np.diff(mean_px, axis=0) ** 2).mean((0, 1)))


def without_the_mean_of_each_star(mean_px):
    step = np.diff(mean_px, axis=0)
    return np.sqrt(((step - step.mean(0)) ** 2).mean((0, 1)))


def degrees_of_freedom(mean_px):
    stars = mean_px.shape[1]
    return document_rms_px(mean_px) * np.sqrt(stars / (stars - 1.0))


@pytest.mark.parametrize(
    ("mutant", "noticed"),
    [
        pytest.param(lambda mean_px: 2.0 * document_rms_px(mean_px), "each for itself", id="doubled"),
        pytest.param(lambda mean_px: document_rms_px(mean_px) / np.sqrt(2.0), "each for itself", id="over sqrt(2)"),
        pytest.param(lambda mean_px: document_rms_px(mean_px)[::-1], "each for itself", id="x and y exchanged"),
        pytest.param(lambda mean_px: document_rms_px(mean_px) ** 2, "each for itself", id="variance"),
        pytest.param(every_second, "each for itself", id="steps of two positions"),
        pytest.param(with_the_platform, "printed equation", id="motion of the platform left in"),
        pytest.param(without_the_mean_of_each_star, "printed equation", id="mean over the wrong index"),
        pytest.param(degrees_of_freedom, "printed equation", id="divisor W - 1 for W"),
    ],
)
def test_a_wrong_equation_is_noticed(run, broken, failing, mutant, noticed):
    broken(document_rms_px, mutant)
    assert [name for name in failing("hsfe", run.result) if noticed in name]


@pytest.mark.parametrize("axis", [0, 1])
def test_a_shifted_centroid_is_noticed(run, failing, axis):
    measured = run.result.measured
    seen = measured.mean_px["all"]
    moved = {"all": {**seen, "cog": seen["cog"] + 0.3 * np.eye(2)[axis]}}
    result = replace(run.result, measured=replace(measured, mean_px={**measured.mean_px, **moved}))
    names = failing("hsfe", result)
    assert [name for name in names if name.startswith("cog: centroid minus noiseless light")]


def test_a_wrong_angle_of_a_pixel_is_noticed(run, failing, monkeypatch):
    right = run.result.instrument.pixel_arcsec
    monkeypatch.setattr(StarSensor, "pixel_arcsec", property(lambda self: 1.01 * right))
    assert "angle of a pixel over that of two traced bundles beside the axis" in failing("hsfe", run.result)


def test_no_false_alarm_in_eight_runs(run, failing, monkeypatch):
    """Criteria of this kind fail by chance once in a thousand times; there are two of them for each centroider.

    By rays, and without the study of the platform's geometry, which no criterion reads: noise is what differs."""
    monkeypatch.setattr("experiments.hsfe.result.geometry_study", lambda *_: run.result.geometry)
    instrument = run.result.config.instrument.model_copy(update={"diffraction": "rays"})
    for seed in range(8):
        config = run.result.config.model_copy(update={"seed": seed, "instrument": instrument})
        found = failing("hsfe", experiment.run(config, progress=Progress()))
        assert not [name for name in found if any(part in name for part in ("itself", "printed", "minus", "angle"))]
