"""The budget from end to end: what it writes, and whether predictions, frames and sums agree as they must."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.budget import experiment, predict
from experiments.budget.predict import predict_terms
from experiments.budget.settings import BudgetConfig, main
from experiments.harness.config import load_config
from experiments.harness.progress import Progress
from experiments.laboratory import high_frequency_model
from experiments.laboratory.bench import epsf_session
from render.records import EffectivePsf

MARKING_ARCSEC, POINTS, COEFFICIENTS, SURVEYS = 2.0, 20, 6, 40
TINY = {
    "centroid": "cog",
    "compare": ["epsf_measured"],
    "filters.centres_nm": [600, 800],
    "target": {"rows": 2, "columns": 2, "pitch_px": 45.1, "edge_px": 40},
    "grid": {
        "rows": 4,
        "columns": 5,
        "order": 2,
        "edge_px": 40,
        "reference": "nominal",
        "surveys": SURVEYS,
        "marking_error_arcsec": MARKING_ARCSEC,
    },
    "frames": 6,
    "dark_frames": 8,
    "steps": {"places": 1, "positions": 3},
    "instrument.diffraction": "rays",
    "attitude": {"counts": [3, 12], "stars": 3, "trials": 200},
    "thermal.stability_k": 0,
}


@pytest.fixture(scope="module")
def run(engine, tiny_chip):
    """All parts of a budget but the temperature, on few pixels, of a target that is badly surveyed.

    PSFs from frames are built by their own tests; here a Gaussian stands for them.
    """
    line = np.exp(-0.5 * (np.arange(-40, 41) / 4 / 0.6) ** 2)
    built = SimpleNamespace(epsf=EffectivePsf(values=16.0 * np.outer(line, line) / line.sum() ** 2, oversampling=4))
    texts = [f"{key}={json.dumps(value)}" for key, value in TINY.items() if not isinstance(value, dict)]
    texts += [f"{k}.{n}={json.dumps(v)}" for k, of in TINY.items() if isinstance(of, dict) for n, v in of.items()]
    config = load_config(BudgetConfig, settings=[f"instrument.detector={tiny_chip}", *texts])
    few = ((predict, "STEP_NOISE_DRAWS", 12), (predict, "EPSF_REALISATIONS", 2), (high_frequency_model, "PATHS", 4))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(epsf_session, "build_epsf", lambda *_, **__: built)
        for module, name, count in few:
            patch.setattr(module, name, count)
        patch.setattr(experiment, "predict_terms", lambda lab: predict_terms(lab, draws=20, step_draws=20))
        sections = experiment.run(config, progress=Progress())
        return config, sections, experiment.predict(config, progress=Progress())


def numbers(column):
    """Values and uncertainties of a table of measured numbers."""
    return np.array([[[one.value, one.uncertainty] for one in row] for row in column])


def test_marking_error_is_what_was_put_in(run):
    """C2 is three times the marking error; k coefficients take sqrt((k - 1) / (W - 1)) of that into C1."""
    terms, free = run[1]["terms"], np.sqrt((COEFFICIENTS - 1) / (POINTS - 1))
    c1, c2 = (experiment.ALL_TERMS.index(name) for name in ("LSFE-C1", "LSFE-C2"))
    predicted, seen = numbers(terms.predicted_arcsec)[..., 0], numbers(terms.measured_arcsec)[..., 0]
    np.testing.assert_allclose(predicted[c2], 3 * MARKING_ARCSEC)
    np.testing.assert_allclose(seen[c2], 3 * MARKING_ARCSEC, rtol=4.0 / np.sqrt(2.0 * POINTS * SURVEYS))
    limit = 4.0 / np.sqrt(2.0 * (COEFFICIENTS - 1) * SURVEYS) + 0.03  # of an RMS; 3 %: noise of the frames
    np.testing.assert_allclose([predicted[c1], seen[c1]], 3 * MARKING_ARCSEC * free, rtol=limit)
    np.testing.assert_allclose(run[1]["parts"].c1_marking_errors_arcsec, 3 * MARKING_ARCSEC * free, rtol=0.02)


def test_temporal_term_and_sums_agree(run):
    """Means over four stars and six frames are known to 15 %; sums are those of eq. 31-32 on both sides."""
    _, sections, alone = run
    for side in ("predicted", "measured"):
        te, hsfe, s, c1, c2, lsfe, total, _ = numbers(getattr(sections["terms"], f"{side}_arcsec"))[..., 0]
        np.testing.assert_allclose(lsfe, np.hypot(s, c1 + c2))
        np.testing.assert_allclose(total, np.sqrt(te**2 + hsfe**2 + lsfe**2))
    ratio = numbers(sections["terms"].ratio)[experiment.ALL_TERMS.index("TE"), :, 0]
    np.testing.assert_allclose(ratio, 1.0, atol=0.6)
    first = numbers(alone["terms"].predicted_arcsec)[experiment.ALL_TERMS.index("TE"), :, 0]
    whole = numbers(sections["terms"].predicted_arcsec)[experiment.ALL_TERMS.index("TE"), :, 0]
    np.testing.assert_allclose(first, whole, rtol=0.15)


def test_sections_of_a_run_and_of_a_prediction_alone(run):
    config, sections, alone = run
    assert sections["setup"].no_thermal == "thermal.stability_k is 0"
    assert len(sections["methods"]) == len(sections["agreement"]) == 2
    assert [one.pair for one in sections["chromatic"]] == ["800-600"]
    assert [one.stars for one in sections["attitude_curve"]] == [3, 12]
    assert sections["tuned"] is sections["collimator"] is sections["terms"].published_arcsec is None
    assert (alone["methods"], alone["terms"].measured_arcsec) == (None, None)
    total = numbers(sections["terms"].predicted_arcsec)[experiment.ALL_TERMS.index("total"), :, 0]
    assert sections["rms"].total_rms_arcsec == pytest.approx(np.sqrt((total**2).mean()))
    coarse = predict.coarse_terms(config)
    for name in ("TE", "HSFE", "LSFE-C1", "total"):
        found = numbers(sections["terms"].predicted_arcsec)[experiment.ALL_TERMS.index(name), :, 0]
        np.testing.assert_allclose(coarse.budget[name].arcsec, found, rtol=0.25)
    assert coarse.causes_arcsec.keys() == {one.cause for one in alone["causes"]}


@pytest.mark.slow
def test_prediction_alone_has_no_measured_number_and_no_criterion(engine, tmp_path):
    few = ("target.rows=2", "target.columns=2", "steps.positions=3", "grid.rows=4", "grid.columns=5", "grid.surveys=40")
    settings = (*few, "centroid=epsf", "compare=[]", "instrument.diffraction=rays")
    line = [word for one in settings for word in ("--set", one)]
    assert main([*line, "--predict-only", "--out", str(tmp_path / "out")], own_process=False) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["criteria"] == []
    assert "measured" not in json.dumps(summary["results"])
    assert "no criterion was judged" in (tmp_path / "out" / "report.html").read_text()
