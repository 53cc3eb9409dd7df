"""The attitude-correlated-frames experiment on a small scale: what it finds, that its numbers agree, what it writes."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.acf import inference as acf_inference
from experiments.acf import plan as acf_plan
from experiments.acf.evaluate import Pulls, comparison, fig3, fig4, gains, pulls
from experiments.acf.experiment import Config, main, run, summary, tables
from experiments.acf.figures import density_of
from experiments.acf.inference import infer
from experiments.acf.judge import own_misses
from experiments.acf.pixels import camera_text, pixel_results
from experiments.acf.plan import make_plan
from experiments.acf.published import TABLE2_CALIBRATED, TABLE2_ROUNDING, TABLE2_START, TABLE2_TRUE
from experiments.acf.settings import RenderedConfig, SkyConfig, SweepConfig
from experiments.acf.tasks import Point, Task, work
from experiments.harness.progress import Progress

ROOT = Path(__file__).parents[3]
SMALL = Config(
    frames=16,
    runs=4,
    noise_px=(0.1, 0.4),
    bias_deg_per_h=(0.1,),
    angle_random_walk_deg_per_sqrt_h=(0.01,),
    counts=(8, 16),
    sky=SkyConfig(stars_per_frame=12.0),
    sweep=SweepConfig(stars=(4, 12), gyro_factor=(0.0, 20.0), skies=4),
    rendered=RenderedConfig(which="none"),
)


@pytest.fixture(scope="module")
def inference():
    return infer(points=11)


@pytest.fixture(scope="module")
def result(inference):
    """A small run in this process; the workers have a test of their own."""

    def in_process(task_of, tasks, *, workers, done):
        del workers
        found = []
        for index, task in enumerate(tasks):
            found.append(task_of(task))
            done(index)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(acf_plan, "run_tasks", in_process)
        patch.setattr(acf_inference, "infer", lambda: inference)
        return run(SMALL, progress=Progress())


@pytest.fixture(scope="module")
def found(result):
    return json.loads(json.dumps(json_of(summary(result)[0])))


def json_of(value):
    from experiments.harness.summary import to_json

    return to_json(value)


def test_summary_holds_what_was_agreed(found):
    assert {"table2", "fig3a", "fig3b", "fig4_rms_px", "fig5", "gain_sweep", "rendered", "runtime_s"} <= set(found)
    assert len(found["table2"]) == 14
    for entry in found["table2"].values():
        assert {"published", "mean", "std", "bound"} <= set(entry)
    assert np.shape(found["fig3a"]["rms_px"]) == (2, 2)  # noise, (perfect, bias)
    assert np.shape(found["gain_sweep"]["acc_bound"]) == (2, 2)  # stars, factor
    assert all(np.isfinite(found["fig4_rms_px"][axis]) for axis in "xy")
    assert set(found["not_converged"]["figures"]) == {"acc", "linked", "free", "iac", "iac_full"}


def test_nothing_fails_to_converge_from_the_poor_start(found):
    assert sum(one["failed"] for one in found["not_converged"]["figures"].values()) == 0


def test_more_noise_more_error(result):
    assert all(low.value < high.value for low, high in zip(*fig3(result), strict=True))
    for one in comparison(result).values():
        assert one.sight_arcsec[1] > 2.5 * one.sight_arcsec[0]


def test_full_weights_are_free_attitudes(result):
    """2 n - 3 measurements of a frame either way; they differ by the terms that a linear weight leaves out."""
    every = comparison(result)
    assert every["iac_full"].camera == pytest.approx(every["free"].camera, rel=0.02)


def test_the_gyro_of_stated_noise_is_acc_when_the_gyro_is_perfect(result):
    found = gains(result)
    assert found.linked[:, 0] == pytest.approx(found.acc[:, 0], rel=1e-3)
    assert found.linked_bound[:, 0] == pytest.approx(found.acc_bound[:, 0], rel=1e-9)
    assert np.all(found.acc_bound[:, 1] < 1.0)  # twenty times the noise, trusted: harm
    assert np.all(found.linked_bound >= 1.0)


def test_errors_are_as_large_as_predicted(result):
    """8 runs of 14 unknowns: chi^2 of at most 112, and strongly correlated; a factor of two is allowed."""
    found = pulls(result)
    assert found.own.shape == (8, 14)
    for which in ("carried", "linked"):
        assert 0.5 < np.sqrt((getattr(found, which) ** 2).mean()) < 1.6
    small = fig4(result)
    assert abs(small.runs.deviation) < 4.0
    assert small.rms_px == pytest.approx(small.expected_px, rel=0.5)


def test_criteria_are_finite(result):
    criteria = summary(result)[1]
    assert len(criteria) == 13
    assert all(np.isfinite(one.value) for one in criteria)
    assert len({one.name for one in criteria}) == 13


def test_tables(result):
    made = tables(result)
    assert {"table2", "fig4", "fig3", "fig5", "methods", "pulls", "gain"} <= set(made)
    published = [row[2] for row in made["table2"].rows]
    assert published[:3] == pytest.approx([-0.19, -0.51, 0.0002], rel=1e-6)
    assert published[8:] == pytest.approx([26.64, -13.68, 3.6, 6.84, -18.0, 0.36], rel=1e-3)  # arcsec, as printed


def test_runs_do_not_depend_on_how_they_are_cut_into_tasks():
    point = Point(name="cut", noise_px=0.2, gyro=((0.03, 0.005),), methods=("acc", "free"), own_sky=True, stars=8)
    whole = work(Task(config=SMALL, point=point, first=0, last=3))
    first, rest = (work(Task(config=SMALL, point=point, first=a, last=b)) for a, b in ((0, 1), (1, 3)))
    assert set(whole) == set(first)
    for key, values in whole.items():
        assert np.array_equal(values, np.concatenate([first[key], rest[key]])), key


def test_points_have_streams_of_their_own():
    names = [point.name for point in make_plan(SMALL, inferred_um=6.4, inferred_stars=16).points]
    assert len(set(names)) == len(names)


def test_the_printed_table_tells_the_pixel(inference):
    """Where the printed errors of y0 [px] and phi1 [arcsec] cancel: 26.64 arcsec x 25.6 mm / 0.51 px = 6.48 um."""
    found = inference
    assert np.deg2rad(26.64 / 3600) * 25.6 / 0.51 * 1e3 == pytest.approx(found.best_um, abs=3 * found.sigma_um)
    assert found.sigma_um < 0.4
    assert found.chi2 < 30.0 < found.chi2_assumed
    assert found.low_stars < found.best_stars < found.high_stars


@pytest.mark.slow
def test_pixel_and_stars_of_simulated_tables_are_found_again():
    """Eight runs with 8 um pixels and 20 stars per frame, printed with the document's digits.

    Pulls of the pixel: mean within 4 / sqrt(8); their RMS within a factor of two. The true number of stars lies in the
    68 % range of most of them, and chi^2 of 11 averages to 11 within 4 sqrt(22 / 8).
    """
    point = Point(name="again", noise_px=0.1, gyro=((0.03, 0.005),), methods=("acc",), stars=20, pixel_um=8.0)
    runs = work(Task(config=Config(), point=point, first=0, last=8))["acc@0.error"]
    runs[:, 8:] = np.degrees(runs[:, 8:])
    pulls, inside, chi2 = [], [], []
    for error in runs:
        printed = np.round((TABLE2_TRUE + error) / TABLE2_ROUNDING) * TABLE2_ROUNDING
        found = infer(points=15, printed=printed)
        pulls.append((found.best_um - 8.0) / found.sigma_um)
        inside.append(found.low_stars < 20 < found.high_stars)
        chi2.append(found.chi2)
    assert abs(np.mean(pulls)) < 4 / np.sqrt(8)
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 2.0
    assert sum(inside) >= 3
    assert np.mean(chi2) == pytest.approx(11, abs=4 * np.sqrt(22 / 8))


def test_defaults_are_the_published_run():
    config = Config()
    camera = config.camera
    assert (config.frames, config.frame_rate_hz, config.runs) == (60, 1.0, 100)
    assert (camera.focal_length_mm, camera.x0_px, camera.y0_px) == (25.6, 10.0, -10.0)
    assert config.noise_px == pytest.approx(np.arange(1, 11) * 0.05)
    gyro = config.gyro
    assert (gyro.rate_hz, gyro.angular_speed_deg_per_s, gyro.bias_deg_per_h) == (100.0, 0.5, 0.03)
    assert gyro.angle_random_walk_deg_per_sqrt_h == 0.005
    assert (TABLE2_START[2], config.start.focal_length_mm) == (20.0, 20.0)
    # printed error of phi1: 26.64 arcsec
    assert 3600 * (TABLE2_CALIBRATED - TABLE2_TRUE)[8] == pytest.approx(26.64, abs=0.01)


@pytest.mark.slow
def test_quick_run_writes_a_report(tmp_path):
    folder = tmp_path / "out"
    assert main(["--quick", "--out", str(folder)]) in (0, 1)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("<figure") >= 14
    assert "nan" not in re.sub(r"<svg.*?</svg>|data:image[^\"]*", "", page, flags=re.DOTALL).lower().split()
    written = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert written["experiment"] == "acf"
    assert {one["name"].split(":")[0] for one in written["criteria"]} >= {"Fig. 4", "Table 2"}


@pytest.mark.slow
def test_rendered_frames_are_part_of_the_result(tmp_path):
    """Few frames of the wide camera: the map error stands beside its prediction, in the summary and the report."""
    few = ["--set", "rendered.which=wide", "--set", "rendered.frames=5", "--set", "runs=4", "--set", "sweep.skies=4"]
    assert main(["--quick", *few, "--out", str(tmp_path / "out")]) in (0, 1)
    written = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    wide = written["results"]["rendered"]["wide"]
    assert wide["frames"] == 5
    assert 0.0 < wide["map_error_arcsec"]["rms"] <= wide["map_error_arcsec"]["max"] < 60.0
    assert 0.0 < wide["map_error_arcsec"]["predicted"] < 60.0
    assert any(one["name"].startswith("25.6 mm lens") for one in written["criteria"])
    assert "On pixels" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_values_of_the_rendered_cameras_come_from_skycal():
    def judged(rms, largest, predicted):
        return SimpleNamespace(rms_arcsec=rms, max_arcsec=largest, predicted_arcsec=predicted)

    maps = {("measured", "free"): judged(1.5, 4.0, 1.25), ("measured", "linked"): judged(0.5, 2.0, 0.75)}
    parts = {"mismatch": 0.25, "chromatic": 1.0, "noise": 0.75, "psf": 0.125}
    camera = SimpleNamespace(
        title="25.6 mm lens",
        scene=SimpleNamespace(
            instrument=SimpleNamespace(camera=SimpleNamespace(lens=SimpleNamespace(name="a lens"))),
            field_deg=22.5,
            frames=60,
        ),
        stars_per_frame=30.5,
        total=maps["measured", "free"],
        of=lambda data, *, method="free": maps[data, method],
        evaluation=SimpleNamespace(part_rms_arcsec=parts),
    )
    assert pixel_results(SimpleNamespace(rendered=None)) is None
    assert pixel_results(SimpleNamespace(rendered=SimpleNamespace(cameras={"wide": camera}))) == {
        "wide": {
            "lens": "a lens",
            "field_deg": 22.5,
            "frames": 60,
            "stars_per_frame": 30.5,
            "map_error_arcsec": {"rms": 1.5, "max": 4.0, "predicted": 1.25},
            "map_error_with_gyro_arcsec": {"rms": 0.5, "max": 2.0, "predicted": 0.75},
            "parts_arcsec": parts,
        }
    }
    words = camera_text(camera)
    assert "off by 1.50″ RMS, predicted 1.25″" in words
    assert words.endswith("star colours 1″, noise and pixels 0.75″, camera model 0.25″, PSF of one colour 0.12″.")


@pytest.mark.slow
def test_workers_change_no_number():
    """The same bits from one process as from three."""
    found = []
    for workers in (1, 3):
        result = run(SMALL.model_copy(update={"workers": workers}), progress=Progress())
        found.append(result.outcome)
    assert set(found[0]) == set(found[1])
    for name, outcome in found[0].items():
        for key, values in outcome.values.items():
            assert np.array_equal(values, found[1][name].values[key], equal_nan=True), (name, key)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc to see when the program is up")
def test_interruption_leaves_nothing_behind(tmp_path):
    """While the workers calibrate; the interrupt goes to all processes, as from a terminal."""
    process = subprocess.Popen(
        [sys.executable, "-m", "experiments.acf", "--out", str(tmp_path / "deep" / "out")],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    deadline = time.monotonic() + 60
    while not (children.exists() and children.read_text().split()) and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(1.0)
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said[1].strip() == "interrupted; nothing was written"
    assert list(tmp_path.iterdir()) == []


def test_unknowns_that_miss_their_own_covariance_are_named():
    """Pulls of RMS 1 but for the roll angles, whose error ACC's covariance lacks."""
    even = np.ones((4000, 14))
    own = even * np.where(np.isin(np.arange(14), (10, 13)), [1.5], [1.05])
    found = Pulls(own=own, carried=even, linked=even)
    assert own_misses(found) == pytest.approx({"phi3": 1.5, "theta3": 1.5})
    assert own_misses(Pulls(own=own[:18], carried=even[:18], linked=even[:18])) == {}  # chance allows 0.58


@pytest.mark.filterwarnings("error")
def test_density_of_nothing_is_zero():
    edges = np.array([0.0, 1.0, 3.0])
    np.testing.assert_array_equal(density_of(np.array([5.0, 7.0]), edges), [0.0, 0.0])
    np.testing.assert_allclose(density_of(np.array([0.5, 2.0, 2.5, 9.0]), edges), [1 / 3, 1 / 3])
