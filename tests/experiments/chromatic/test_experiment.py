"""The chromatic test from end to end: what it writes, and whether frames, truth and prediction agree as they must."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from calib.measure.stamps import stamps_from_windows
from experiments.chromatic.evaluate import evaluate
from experiments.chromatic.experiment import Config, main
from experiments.chromatic.measure import measure
from experiments.chromatic.model import band_pairs, bundle_prediction, shifts, table1
from experiments.laboratory.instrument import build_instrument
from experiments.laboratory.points import common_shift, pattern_effect
from experiments.laboratory.target import corner_directions
from optics.lens.perturb import decentre
from render.engine.random import Streams

ROOT = Path(__file__).parents[3]
SMALL = {
    "frames": 4,
    "dark_frames": 10,
    "target.rows": 2,
    "target.columns": 2,
    "stars.grid": 2,
    "stars.temperatures_k": "[3000, 5800, 30000]",
    "compare": '["cog"]',
}


def arguments(out, detector):
    settings = SMALL | {"instrument.detector": detector}
    pairs = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    return ["--out", str(out), "--seed", "5", *pairs]


@pytest.fixture(scope="module")
def outcome(tmp_path_factory, small_detector):
    """Exit code, folder and result of one small run through the command line."""
    folder = tmp_path_factory.mktemp("chromatic") / "out"
    kept = []
    with pytest.MonkeyPatch.context() as patch:
        from experiments.chromatic import evaluate as chromatic_evaluate

        original = chromatic_evaluate.results
        patch.setattr(chromatic_evaluate, "results", lambda result: kept.append(result) or original(result))
        status = main(arguments(folder, small_detector))
    return status, folder, kept[0]


@pytest.fixture(scope="module")
def summary(outcome):
    return json.loads((outcome[1] / "summary.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def result(outcome):
    return outcome[2]


def test_all_criteria_hold(outcome, summary):
    assert [one["name"] for one in summary["criteria"] if not one["passed"]] == []
    assert outcome[0] == 0


def test_summary_holds_what_was_agreed(summary):
    assert summary["experiment"] == "chromatic"
    assert summary["seed"] == summary["config"]["seed"] == 5
    results = summary["results"]
    for key in ("table1_px", "predicted_table1_px"):
        assert sorted(results[key]) == ["600-500", "800-600"]
        for entry in results[key].values():
            assert sorted(entry) == ["x", "y"]
            assert all(isinstance(value, float) for value in entry.values())
    for key in (
        "lsfe_s_arcsec_3sigma",
        "rms_shift_px",
        "residual_after_calibration_px",
        "stellar",
        "decentre_solution",
    ):
        assert results[key]
    assert sorted(results["truth_bias_px"]) == ["max", "rms"]
    assert 0 < results["truth_bias_px"]["rms"] < results["truth_bias_px"]["max"] < 0.1
    assert results["runtime_s"] > 0
    assert 100 < results["peak_memory_mb"] < 2000


def test_numbers_agree_across_the_files(outcome, summary):
    entries = Table.read(outcome[1] / "table1.ecsv", format="ascii.ecsv")
    centred = entries[entries["lens"] == "centred"]
    for row in centred:
        found = summary["results"]["table1_px"][row["bands"]][row["axis"].lower()]
        assert row["measured_px"] == found
        assert row["measured_px_error"] == summary["results"]["table1_sigma_px"][row["bands"]][row["axis"].lower()]
    assert centred["measured_px"].unit == "pix"


def test_eq_16_from_the_points_table(outcome, summary):
    """The table of single shifts must give Table 1 by plain arithmetic: mean of all points, halved."""
    points = Table.read(outcome[1] / "points.ecsv", format="ascii.ecsv")
    assert len(points) == 2 * 2 * 4 * 4  # lenses, pairs, positions, points
    for name, entry in summary["results"]["table1_px"].items():
        mine = points[(points["lens"] == "centred") & (points["bands"] == name)]
        for axis in "xy":
            assert np.mean(mine[f"measured_{axis}_px"]) / 2 == pytest.approx(entry[axis], abs=1e-12)
            rms = np.sqrt(np.mean(np.square(mine[f"measured_{axis}_px"])))
            assert rms == pytest.approx(summary["results"]["rms_shift_px"][name][axis])


def test_lsfe_is_the_largest_entry_in_arcseconds(summary):
    """ACC18: divided by 3, times 3 sigma, times 5.5 arcsec per pixel."""
    results = summary["results"]
    for axis in "xy":
        largest = max(abs(entry[axis]) for entry in results["table1_px"].values())
        assert results["lsfe_s_arcsec_3sigma"][axis]["value"] == pytest.approx(largest * 5.5, rel=2e-3)
    moved = results["decentre_solution"]["lsfe_s_arcsec_3sigma"]["x"]
    assert abs(moved["value"] - 0.66) < 4 * moved["uncertainty"]  # what ACC18 publishes for 0.12 px
    assert moved["uncertainty"] < 0.02


def test_report_stands_alone(outcome):
    text = (outcome[1] / "report.html").read_text(encoding="utf-8")
    loads = [one for one in re.findall(r"(?:src|href)=\"([^\"]*)\"", text) if not one.startswith(("data:", "#"))]
    assert loads == []
    assert "http" not in re.sub(r"xmlns(:\w+)?=\"[^\"]*\"", "", text)
    assert "<script" not in text
    assert "nan" not in re.sub(r"<svg.*?</svg>|data:[^\"]*", "", text, flags=re.DOTALL).lower().split()


def test_frame_is_a_readable_fits_image(outcome, result):
    (path,) = outcome[1].glob("*.fits")
    with fits.open(path) as file:
        image = np.asarray(file[0].data).astype(float)
    assert image.shape == (1536, 3072)
    for x, y in result.centred.measurement.photon_px[0, :, 1]:
        column, row = round(x), round(y)
        light = image[row - 3 : row + 4, column - 3 : column + 4] - np.median(image)
        # 6000 e- at 0.3 DN/e-; 49 pixels of 13 e- read noise are 91 e-, shot noise 77 e-: five of them
        assert light.sum() == pytest.approx(0.3 * 6000, abs=0.3 * 5 * np.hypot(91, 77))
        assert np.unravel_index(light.argmax(), light.shape) in [(i, j) for i in (2, 3, 4) for j in (2, 3, 4)]


def test_prediction_agrees_with_the_rendered_light(result):
    """Two traces (NumPy, compiled), two pupils, two sets of wavelengths: 1e-5 px of shifts of 0.03 px and more."""
    for evaluation in (result.centred, result.moved):
        for name, shift in evaluation.photon_shift_px.items():
            assert np.abs(shift).max() > 0.03
            assert np.abs(shift - evaluation.predicted_shift_px[name]).max() < 5e-5


def test_centred_lens_has_no_mean_shift_but_points_move(result):
    for name, shift in result.centred.photon_shift_px.items():
        assert table1(shift) == pytest.approx([0, 0], abs=1e-6)
        assert np.sqrt((shift**2).sum(-1).mean()) > 0.02, name


def test_moved_element_gives_the_published_mean_in_the_noiseless_light(result):
    assert result.moved.photon_table1_px["800-600"] == pytest.approx([0.12, 0.0], abs=1e-5)
    assert result.chosen.kind == "decentre"
    others = [abs(s.amount) for s in result.solutions if s.kind == "decentre" and np.isfinite(s.amount)]
    assert abs(result.chosen.amount) == min(others)


def test_uncertainty_covers_what_frames_and_points_allow(result):
    """Table 1 averages 16 points of 4 frames: sigma = single-frame noise sqrt(2) / 2 / sqrt(64), plus the pattern."""
    single = np.sqrt((result.centred.measurement.sigma_px["epsf"] ** 2).mean())
    for sigma in result.centred.table1_sigma_px.values():
        assert np.all(sigma > 0.7 * single / np.sqrt(2 * 64))
        assert np.all(sigma < 2.0 * single / np.sqrt(2 * 64))


def test_rendered_image_is_locked(result):
    with pytest.raises(ValueError, match="read-only"):
        result.centred.measurement.example.electrons[0, 0, 0] = 1.0


def testcommon_shift_is_what_most_detections_agree_on():
    rng = np.random.default_rng(1)
    offset = np.concatenate([rng.normal([31.0, -12.0], 0.5, (25, 2)), rng.uniform(-80, 80, (60, 2))])
    assert common_shift(offset) == pytest.approx([31.0, -12.0], abs=0.5)
    assert common_shift(np.full((3, 2), 500.0)) == pytest.approx([0, 0])


def quick_measure(bench, instrument, seed):
    return measure(bench, instrument, Streams(seed).child("test"), advance=lambda: None)


def with_sensor(instrument, sensor_seed, **changes):
    return replace(instrument, detector=replace(instrument.detector, sensor_seed=sensor_seed, **changes))


@pytest.fixture(scope="module")
def measured(engine, bench_of, small_camera):
    return quick_measure(bench_of(rows=1, columns=2, frames=2, dark_frames=2), small_camera, 1)


def test_inputs_unchanged(measured, bench_of, small_camera):
    bench = bench_of(rows=1, columns=2, frames=2, dark_frames=2)
    direction = corner_directions(bench.target, small_camera)
    before, mean = direction.copy(), measured.mean_px["epsf"].copy()
    bundle_prediction(bench, small_camera, direction)
    evaluate(bench, small_camera, measured, band_pairs((500.0, 600.0, 800.0), 1))
    assert np.array_equal(direction, before)
    assert np.array_equal(measured.mean_px["epsf"], mean)
    assert np.array_equal(measured.direction, direction)


@pytest.mark.slow
def test_same_seed_same_numbers_another_seed_others(engine, measured, bench_of, small_camera):
    bench = bench_of(rows=1, columns=2, frames=2, dark_frames=2)
    one = measured.mean_px["epsf"]
    same, other = (quick_measure(bench, small_camera, seed).mean_px["epsf"] for seed in (1, 2))
    assert np.array_equal(one, same)
    assert not np.any(one == other)
    assert np.abs(one - other).max() < 0.1


@pytest.mark.slow
def test_moved_image_is_found_again(engine, bench_of, small_camera):
    """The target is looked for where the lens puts it, up to 80 px away; its comatic spots are not given up."""
    bench = bench_of(frames=2, dark_frames=2)
    moved = build_instrument(small_camera.config, decentre(small_camera.camera.lens, "L2", -0.4, 0.1))
    measured = quick_measure(bench, moved, 3)
    expected = bundle_prediction(bench, moved, measured.direction)
    assert np.abs(measured.nominal_px - expected[:, :, 1]).max() > 40
    assert np.abs(measured.mean_px["epsf"] - expected).max() < 0.1


@pytest.mark.slow
def test_same_seed_same_summary(tmp_path, small_detector):
    texts = []
    for name, seed in (("a", "5"), ("b", "5"), ("c", "6")):
        assert main([*arguments(tmp_path / name, small_detector), "--seed", seed]) in (0, 1)
        text = (tmp_path / name / "summary.json").read_text(encoding="utf-8")
        texts.append(re.sub(r'"(runtime_s|peak_memory_mb)": [\d.]+', r'"\1": 0', text))
    assert texts[0] == texts[1]
    assert json.loads(texts[0])["results"]["table1_px"] != json.loads(texts[2])["results"]["table1_px"]
    assert (
        json.loads(texts[0])["results"]["predicted_table1_px"] == json.loads(texts[2])["results"]["predicted_table1_px"]
    )


@pytest.mark.slow
def test_command_of_the_readme(tmp_path):
    """A process of its own, as a user starts it, with the published settings of the quick run."""
    done = subprocess.run(
        [sys.executable, "-m", "experiments.chromatic", "--quick", "--out", str(tmp_path / "out")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "criteria hold" in done.stdout
    assert (tmp_path / "out" / "report.html").is_file()


RUNS = 40


@pytest.mark.slow
def test_uncertainties_of_table_1_are_as_stated(engine, bench_of, small_camera):
    """40 cameras (fixed patterns) and noise seeds: the entries scatter about the truth as their sigma says.

    Two pairs share the 600 nm band (correlation 1/2, so 1/4 between their squares) and the two axes are independent:
    the variance of the mean of 160 squared pulls is 2.5/160, and four standard deviations are allowed.
    """
    pairs = band_pairs((500.0, 600.0, 800.0), 1)
    bench = bench_of()
    pulls = []
    for seed in range(RUNS):
        camera = with_sensor(small_camera, 1000 + seed)
        found = evaluate(bench, camera, quick_measure(bench, camera, seed), pairs)
        pulls.append([(found.table1_px[n] - found.photon_table1_px[n]) / found.table1_sigma_px[n] for n, _, _ in pairs])
    pulls = np.array(pulls)
    spread = np.sqrt(2.5 / pulls.size)
    assert abs((pulls**2).mean() - 1) < 4 * spread
    # no bias: the mean of 40 independent pulls per entry, the largest of four
    assert np.abs(pulls.mean(0)).max() * np.sqrt(RUNS) < 4


SENSORS = 40


@pytest.mark.slow
def test_effect_of_the_fixed_pattern_is_predicted(engine, bench_of, small_camera):
    """The prediction draws response patterns; here 40 sensors are made, and their mean centroids scatter.

    16 points x 2 axes x 40 sensors, against 48 predicted patterns for each of those: the relative standard deviation of
    their variances is sqrt(2 / 1280) and sqrt(2 / 61440), together 4.0 %; four of them are allowed. The filters do not
    count, the pattern is common to them. The temporal part is taken off.
    """
    bench = bench_of(frames=40, dark_frames=100)
    place, temporal, predicted = [], [], []
    for seed in range(SENSORS):
        camera = with_sensor(small_camera, 2000 + seed, prnu=0.05)
        measured = quick_measure(bench, camera, seed)
        place.append(measured.mean_px["epsf"] - measured.photon_px)
        temporal.append((measured.sigma_px["epsf"] ** 2 / measured.frames_used[..., None]).mean())
        predicted.append((measured.pattern_px**2).mean((0, 1, 2)))
    found = np.var(place, axis=0, ddof=1).mean((0, 1)) - np.mean(temporal)  # (b, 2)
    spread = np.sqrt(2 / (32 * SENSORS) + 2 / (32 * 48 * SENSORS))
    assert found.mean() > 10 * np.mean(temporal)
    assert abs(found.mean() / np.mean(predicted) - 1) < 4 * spread


@pytest.mark.slow
def test_pattern_that_filters_share_cancels_in_part(engine, bench_of, small_camera):
    """A fixed pattern moves a point alike behind two filters, so a shift suffers less than sqrt(2) of one position."""
    measured = quick_measure(bench_of(), small_camera, 1)
    pattern = shifts(measured.pattern_px, band_pairs((500.0, 600.0, 800.0), 1))
    single = np.sqrt((measured.pattern_px**2).mean())
    for shift in pattern.values():
        assert np.sqrt((shift**2).mean()) < 1.2 * single


def testpattern_effect_on_a_centre_of_gravity(measured):
    """No PRNU and no dark noise: nothing moves. With PRNU: the closed form of a centre of gravity."""

    class Centre:
        def measure(self, stamps, noise):
            index = np.arange(stamps.electrons.shape[1])
            total = stamps.electrons.sum((1, 2))
            return SimpleNamespace(
                x_px=(stamps.electrons.sum(1) * index).sum(1) / total,
                y_px=(stamps.electrons.sum(2) * index).sum(1) / total,
            )

    stamps, noise = stamps_from_windows(measured.windows[0], background_e=0.0, start_px=measured.photon_px[0, :, 0])
    light = np.random.default_rng(2).uniform(10, 20, (2, 13, 13))
    still = pattern_effect(Centre(), stamps, noise, light, prnu=0.0, dark_e=0.0, rng=np.random.default_rng(3))
    assert np.all(still == 0)
    moved = pattern_effect(Centre(), stamps, noise, light, prnu=0.01, dark_e=0.0, rng=np.random.default_rng(3))
    # centroid of independent pixel errors: var = prnu^2 sum (x - c)^2 e^2 / (sum e)^2
    index = np.arange(13)
    total = light.sum((1, 2))
    centre = (light.sum(1) * index).sum(1) / total
    variance = 1e-4 * ((index - centre[:, None]) ** 2 * (light**2).sum(1)).sum(1) / total**2
    # 48 patterns x 2 points: the variance is known to sqrt(2 / 96) = 14 %; four of them
    assert (moved[..., 0] ** 2).mean() == pytest.approx(variance.mean(), rel=0.58)


def test_defaults_are_the_published_run():
    config = Config()
    assert (config.target.rows, config.target.columns, config.frames) == (5, 5, 30)
    assert config.filters.centres_nm == (500.0, 600.0, 800.0)
    assert (config.filters.reference_nm, config.filters.width_nm) == (600.0, 100.0)
    assert config.decentre.wanted_px == 0.12
