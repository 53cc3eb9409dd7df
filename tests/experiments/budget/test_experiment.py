"""The budget from end to end: what it writes, and whether predictions, frames and sums agree as they must."""

import json

import numpy as np
import pytest

from calib.accuracy.temporal import small_sample_factor
from experiments.budget.laboratory import build_laboratory
from experiments.budget.predict import coarse_terms, predict_terms
from experiments.budget.settings import Config, main
from experiments.harness.config import load_config

SMALL = [
    "target.rows=2",
    "target.columns=2",
    "steps.positions=3",
    "grid.rows=4",
    "grid.columns=5",
    "grid.surveys=40",
    "centroid=epsf",
    "compare=[]",
    "instrument.diffraction=rays",  # predictions among themselves; the runs below go by waves
]


@pytest.fixture(scope="module")
def small(engine):
    """Prediction of a small laboratory."""
    lab = build_laboratory(load_config(Config, settings=SMALL))
    return lab, predict_terms(lab, draws=60, step_draws=40)["epsf"]


@pytest.mark.slow
def test_prediction_knows_the_bound(small):
    """The ePSF fit is maximum likelihood with flux free: at 6000 e- it reaches the bound, never beats it."""
    lab, predicted = small
    te, bound = predicted.budget["TE"], predicted.bound_te_arcsec * small_sample_factor(lab.config.frames)
    assert np.all(te.arcsec > bound - 4 * te.uncertainty_arcsec)
    np.testing.assert_allclose(te.arcsec, bound, rtol=0.03, atol=4 * te.uncertainty_arcsec.max())


@pytest.mark.slow
def test_marking_errors_feed_the_polynomial(small):
    """Without marking errors a calibrated camera leaves the polynomial next to nothing to remove."""
    predicted = small[1]
    exact = build_laboratory(load_config(Config, settings=[*SMALL, "grid.marking_error_arcsec=0"]))
    other = predict_terms(exact, draws=60, step_draws=5)["epsf"]
    assert np.all(other.budget["LSFE-C1"].arcsec < 0.6 * predicted.budget["LSFE-C1"].arcsec)
    assert np.array_equal(other.budget["LSFE-C2"].arcsec, [0.0, 0.0])
    np.testing.assert_allclose(predicted.budget["LSFE-C2"].arcsec, 0.5)


@pytest.mark.slow
def test_coarse_prediction_follows_the_fine_one(small):
    lab, predicted = small
    coarse = coarse_terms(lab.config).budget
    for name in ("TE", "HSFE", "LSFE-C1", "total"):
        np.testing.assert_allclose(coarse[name].arcsec, predicted.budget[name].arcsec, rtol=0.25)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--set", "moved.element=L9"], "unknown element 'L9'"),
        (["--set", "instrument.detector=acc19_mosaic"], "acc18_mosaic"),
        (["--set", "attitude.counts=[1, 5]"], "at least 2"),
        (["--set", "source.signal_e=1e6"], "saturates"),
        (["--set", "instrument.defocus_mm=0.5"], "window_px"),
        (["--set", "target.pitch_px=900"], "does not fit"),
        (["--config", "acc19_tuned.toml"], "no such file"),
    ],
)
def test_bad_input_is_one_line(arguments, words, refused_by):
    assert words in refused_by("budget", *arguments)


MARKING_ARCSEC, POINTS, COEFFICIENTS, SURVEYS = 2.0, 20, 6, 40


TARGET = {"target__rows": 2, "target__columns": 2, "target__pitch_px": 45.1, "target__edge_px": 40}
GRID = {"grid__rows": 4, "grid__columns": 5, "grid__order": 2, "grid__edge_px": 40, "grid__reference": "nominal"}
FEW = {"frames": 8, "dark_frames": 20, "steps__places": 1, "steps__positions": 3}
TINY = {
    "centroid": "epsf",
    "compare": ["cog"],
    **TARGET,
    **GRID,
    **FEW,
    "grid__surveys": SURVEYS,
    "grid__marking_error_arcsec": MARKING_ARCSEC,
}


@pytest.fixture(scope="module")
def run(tiny_run):
    """All parts of a budget, of a target that is badly surveyed."""
    attitude = {"attitude__counts": [3, 12], "attitude__stars": 3, "attitude__trials": 200}
    return tiny_run("budget", **TINY, **attitude, detector__read_noise_e=10)


@pytest.mark.slow
def test_marking_error_is_what_was_put_in(run):
    """C2 is three times the marking error; k coefficients take sqrt((k - 1) / (W - 1)) of that into C1."""
    terms, share = run.results["terms"], np.sqrt((COEFFICIENTS - 1) / (POINTS - 1))
    for axis in "xy":
        assert terms["LSFE-C2"][axis]["predicted_arcsec_3sigma"] == pytest.approx(3 * MARKING_ARCSEC)
        surveyed = terms["LSFE-C2"][axis]["measured_arcsec_3sigma"]
        assert surveyed == pytest.approx(3 * MARKING_ARCSEC, rel=4.0 / np.sqrt(2.0 * POINTS * SURVEYS))
        for key in ("measured_arcsec_3sigma", "predicted_arcsec_3sigma"):
            limit = 4.0 / np.sqrt(2.0 * (COEFFICIENTS - 1) * SURVEYS) + 0.03  # of an RMS; 3 %: noise of the frames
            assert terms["LSFE-C1"][axis][key] == pytest.approx(3 * MARKING_ARCSEC * share, rel=limit)


@pytest.mark.slow
def test_prediction_alone_is_near_the_prediction_of_the_whole_run(small, tmp_path):
    """No measured number, no criterion; TE and C2 are the same, HSFE is that of one place."""
    line = [word for one in SMALL for word in ("--set", one)]
    assert main([*line, "--predict-only", "--out", str(tmp_path / "out")], own_process=False) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    terms, whole = summary["results"]["terms"], small[1].budget
    assert summary["criteria"] == []
    assert "measured" not in json.dumps(summary["results"])
    for name, tolerance in (("TE", 0.1), ("HSFE", 0.3), ("LSFE-C2", 1e-9)):
        found = [terms[name][axis]["predicted_arcsec_3sigma"] for axis in "xy"]
        np.testing.assert_allclose(found, whole[name].arcsec, rtol=tolerance)
    assert "no criterion was judged" in (tmp_path / "out" / "report.html").read_text()
