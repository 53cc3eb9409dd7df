"""The budget from end to end: what it writes, and whether predictions, frames and sums agree as they must."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from experiments.budget.combine import TERMS
from experiments.budget.experiment import main
from experiments.budget.laboratory import build_laboratory
from experiments.budget.settings import Config
from experiments.budget.sweep import coarse_budget, widened
from experiments.budget.terms import Psfs, predict_terms
from experiments.budget.tolerances import tolerance_study
from experiments.harness.config import load_config
from render.engine.random import Streams

ROOT = Path(__file__).parents[3]
SMALL = ["target.rows=2", "target.columns=2", "steps.positions=3", "grid.rows=4", "grid.columns=5", "grid.surveys=40"]


@pytest.fixture(scope="module")
def small(engine):
    """Prediction of a small laboratory."""
    lab = build_laboratory(load_config(Config, settings=SMALL))
    psfs = Psfs()
    return lab, psfs, predict_terms(lab, psfs=psfs, draws=60, step_draws=40)


def test_prediction_knows_the_bound(small):
    """The ePSF fit is maximum likelihood with flux free: at 6000 e- it reaches the bound, never beats it."""
    _, _, predicted = small
    te = predicted.budget["TE"]
    assert np.all(te.arcsec > predicted.bound_te_arcsec - 4 * te.uncertainty_arcsec)
    np.testing.assert_allclose(te.arcsec, predicted.bound_te_arcsec, rtol=0.03, atol=4 * te.uncertainty_arcsec.max())


def test_centred_lens_has_no_chromatic_term(small):
    _, _, predicted = small
    assert np.array_equal(predicted.budget["LSFE-S"].arcsec, [0.0, 0.0])
    assert max(float(v.max()) for v in predicted.chromatic.rms_px.values()) > 0.05  # though every point moves


@pytest.mark.slow
def test_marking_errors_feed_the_polynomial(small):
    """Without marking errors a calibrated camera leaves the polynomial next to nothing to remove."""
    _, psfs, predicted = small
    exact = build_laboratory(load_config(Config, settings=[*SMALL, "grid.marking_error_arcsec=0"]))
    other = predict_terms(exact, psfs=psfs, draws=60, step_draws=5)
    assert np.all(other.budget["LSFE-C1"].arcsec < 0.6 * predicted.budget["LSFE-C1"].arcsec)
    assert np.array_equal(other.budget["LSFE-C2"].arcsec, [0.0, 0.0])
    np.testing.assert_allclose(predicted.budget["LSFE-C2"].arcsec, 0.5)


def test_coarse_prediction_follows_the_fine_one(small):
    lab, psfs, predicted = small
    coarse = coarse_budget(lab.config, psfs)
    for name in ("TE", "HSFE", "LSFE-C1", "total"):
        np.testing.assert_allclose(coarse[name].arcsec, predicted.budget[name].arcsec, rtol=0.25)


@pytest.mark.slow
def test_more_light_less_noise(small):
    _, psfs, _ = small
    noisy, quiet = (
        coarse_budget(load_config(Config, settings=[*SMALL, f"detector.read_noise_e={r}"]), psfs) for r in (26.0, 2.0)
    )
    assert np.all(noisy["TE"].arcsec > 1.3 * quiet["TE"].arcsec)
    assert np.array_equal(noisy["LSFE-S"].arcsec, quiet["LSFE-S"].arcsec)


def test_window_grows_with_the_spot():
    config = load_config(Config, settings=["instrument.defocus_mm=0.2"])
    assert widened(config).window_px >= 17
    assert widened(Config()) == Config()


@pytest.mark.slow
def test_built_lenses_scatter_as_their_sensitivities_add_up(engine):
    settings = ["tolerances.draws=60", "target.rows=2", "target.columns=2", "tolerances.decentre_um=5"]
    lab = build_laboratory(load_config(Config, settings=settings))
    study = tolerance_study(lab, Streams(2))
    assert study.lost == 0
    np.testing.assert_allclose(study.spread_arcsec, study.linear_arcsec, rtol=4 * study.spread_uncertainty)
    assert np.abs(study.signed_arcsec.mean(0)).max() < 4 * study.linear_arcsec.max() / np.sqrt(60)
    # a cubic polynomial of its own follows what decentres do to the map; the design's map does not
    assert study.distortion_arcsec.max() < 0.3 * np.median(study.uncalibrated_arcsec)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--sweep", "defocs_mm=-0.2:0.2:9"], "did you mean defocus_mm"),
        (["--sweep", "defocus_mm=0.1:0.1:9"], "is empty"),
        (["--sweep", "defocus_mm=nan:0.1:9"], "finite"),
        (["--set", "detector.read_noize_e=5"], "did you mean 'read_noise_e'"),
        (["--set", "detector.prnu=nan"], "finite"),
        (["--set", "moved.element=L9"], "unknown element 'L9'"),
        (["--set", "instrument.detector=acc19_mosaic"], "acc18_mosaic"),
        (["--set", "attitude.counts=[1, 5]"], "at least 2 stars"),
        (["--set", "source.signal_e=1e6"], "saturates"),
        (["--set", "instrument.defocus_mm=0.5"], "window_px"),
        (["--set", "target.pitch_px=900"], "does not fit"),
        (["--set", "window_px=12"], "odd"),
        (["--config", "acc19_tuned.toml"], "no such file"),
    ],
)
def test_bad_input_is_one_line(arguments, words, tmp_path, capsys):
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert words in said
    assert said.startswith("error: ")
    assert "\n" not in said
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_quick_run_from_end_to_end(tmp_path):
    out = tmp_path / "out"
    # fmt: off
    call = [sys.executable, "-m", "experiments.budget", "--quick", "--seed", "3", "--out", str(out),
            "--set", "detector.read_noise_e=10", "--sweep", "signal_e=3000:9000:3"]
    # fmt: on
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    content = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in content["criteria"] if not one["passed"]] == []
    results = content["results"]
    assert list(results["terms"]) == [*TERMS, "LSFE", "total", "attitude"]
    for key in ("predicted_arcsec_3sigma", "measured_arcsec_3sigma", "measured_uncertainty"):
        assert all(one[axis][key] >= 0 for one in results["terms"].values() for axis in "xy")
    assert results["terms"]["TE"]["x"]["published_arcsec_3sigma"] == 1.14
    assert [results["terms"]["LSFE-S"][axis]["ratio"] for axis in "xy"] == [None, None]
    assert results["changed_settings"]["detector.read_noise_e"] == {"default": None, "here": 10.0}
    assert results["sweep"]["key"] == "source.signal_e"
    te = [one["TE"]["x"] for one in results["sweep"]["predicted"]]
    assert te[0] > te[1] > te[2]
    table = Table.read(out / "budget.ecsv", format="ascii.ecsv")
    assert len(table) == 2 * (len(TERMS) + 3)
    for axis in "xy":
        *parts, _, total, _ = (one[axis]["measured_arcsec_3sigma"] for one in results["terms"].values())
        expected = parts[0] ** 2 + parts[1] ** 2 + parts[2] ** 2 + (parts[3] + parts[4]) ** 2
        assert total**2 == pytest.approx(expected)
    assert "Error budget" in (out / "report.html").read_text(encoding="utf-8")
