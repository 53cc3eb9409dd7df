"""Both sides of the budget: terms over places and surveys, ratios, pulls, sums; by hand and drawn."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.accuracy.error_budget import ErrorTerm, combine
from experiments.budget import predict as predict_module
from experiments.budget.chromatic import ChromaticTerm, table1_of
from experiments.budget.experiment import (
    EVERY,
    TESTED,
    agreement,
    compared,
    of_prediction,
    parts,
    pulls,
    setup,
    tuned,
)
from experiments.budget.laboratory import build_laboratory, marking, places_px
from experiments.budget.measure import _over_surveys
from experiments.budget.settings import Config
from experiments.harness.config import load_config
from experiments.laboratory.settings.published import ACC18_ARCSEC

PIXEL_ARCSEC = 5.5
NAMES = ("TE", "HSFE", "LSFE-S", "LSFE-C1", "LSFE-C2")


def value(arcsec, uncertainty, n=0):
    return ErrorTerm(arcsec=np.array(arcsec, float), uncertainty_arcsec=np.array(uncertainty, float), n=n)


def chromatic(x, sigma, n=0):
    return ChromaticTerm(
        table1_px={"600-500": np.array([x, -0.02]), "800-600": np.array([0.01, 0.05])},
        sigma_px={"600-500": np.array([sigma, 0.001]), "800-600": np.array([0.001, 0.002])},
        rms_px={"600-500": np.array([0.3, 0.4]), "800-600": np.array([0.1, 0.2])},
        pixel_arcsec=PIXEL_ARCSEC,
        n=n,
    )


def side(scale=1.0, uncertainty=0.03, table=None, n=0):
    """Terms 0.5, 0.3, S, 0.2, 0.4 times a factor, in x; twice of it in y."""
    table = table or chromatic(0.06, 0.003, n)
    sizes = zip(NAMES, scale * np.array([0.5, 0.3, 0.0, 0.2, 0.4]), strict=True)
    term = {name: value([a, 2 * a], [uncertainty, uncertainty], n) for name, a in sizes}
    term["LSFE-S"] = table.value()
    others = ("single", "found", "left", "one_survey", "survey_scatter")
    same = {f"{part}_arcsec": k * np.ones(2) for k, part in enumerate(others)}
    return SimpleNamespace(
        budget=combine(term, stars=4),
        chromatic=table,
        causes_arcsec={"noise": np.array([0.1, 0.2])},
        bound_te_arcsec=np.array([0.4, 0.8]),
        marking_alone_arcsec=np.array([0.1, 0.1]),
        **same,
    )


def numbers(rows):
    return np.array([[[one.value, one.uncertainty] for one in row] for row in rows])


def test_largest_entry_of_table_1_is_the_term():
    table = chromatic(-0.06, 0.003, n=80)
    assert table.largest() == ["600-500", "800-600"]
    found = table.value()
    assert (found.arcsec, found.uncertainty_arcsec) == (
        pytest.approx(PIXEL_ARCSEC * np.array([0.06, 0.05])),
        pytest.approx(PIXEL_ARCSEC * np.array([0.003, 0.002])),
    )
    assert found.n == 80
    assert table.value(["800-600", "600-500"]).arcsec == pytest.approx(PIXEL_ARCSEC * np.array([0.01, 0.02]))
    assert chromatic(1e-8, 0.0).value(["600-500"] * 2).arcsec[0] == 0.0  # rounding of a trace
    first, second = table1_of(chromatic(-0.05, 0.0), table)
    assert (first.pair, first.measured_px[0].value, first.measured_px[0].uncertainty) == ("600-500", -0.06, 0.003)
    assert (first.predicted_px[0], first.measured_px[0].n, second.rms_px[1]) == (-0.05, 80, 0.2)


def test_ratios_of_both_sides():
    ours, theirs = side(1.2, 0.02), side(1.0, 0.03, n=100)
    found = compared(ours, theirs)
    ratio, index = numbers(found.ratio), {name: k for k, name in enumerate(EVERY)}
    assert ratio[index["TE"], 0] == pytest.approx([1.2, 1.2 * np.hypot(0.02 / 0.6, 0.03 / 0.5)])
    # the prediction's uncertainty of HSFE and C1 contains the measured one
    for name, measured_x in (("HSFE", 0.3), ("LSFE-C1", 0.2)):
        assert ratio[index[name], 0] == pytest.approx([1.2, 1.2 * 0.02 / (1.2 * measured_x)])
    assert ratio[index["total"], 0, 0] > 1.0
    assert found.measured_n[index["TE"]].tolist() == [100, 100]
    faint = compared(side(0.1, 0.02), side(1.0, 0.03))  # 0.05 arcsec against 5 x 0.03: nothing to divide
    assert np.isnan(numbers(faint.ratio)[index["TE"], 0, 0])
    alone = compared(ours)
    assert alone.measured_arcsec is None
    assert numbers(alone.predicted_arcsec)[index["HSFE"]] == pytest.approx(np.array([[0.36, 0.02], [0.72, 0.02]]))


def test_deviations_of_both_sides():
    ours, theirs = side(1.2, 0.02, chromatic(0.07, 0.004)), side(1.0, 0.03, chromatic(0.06, 0.003))
    assert pulls(ours, theirs, "TE") == pytest.approx(np.array([0.1, 0.2]) / np.hypot(0.02, 0.03))
    assert pulls(ours, theirs, "HSFE") == pytest.approx(np.array([0.06, 0.12]) / 0.02)
    entries = pulls(ours, theirs, "LSFE-S")
    assert entries.shape == (2, 2)
    assert entries[0, 0] == pytest.approx(0.01 / 0.005)
    assert entries[1] == pytest.approx([0.0, 0.0])
    found = agreement(ours, theirs)
    assert found.pull[TESTED.index("LSFE-S")] == pytest.approx([2.0, 0.0])
    assert found.pull[TESTED.index("TE")] == pytest.approx(np.array([0.1, 0.2]) / np.hypot(0.02, 0.03))
    assert found.whole[TESTED.index("HSFE")] == pytest.approx(np.array([0.36, 0.72]) / 0.02)
    assert found.whole[TESTED.index("LSFE-C2")].tolist() == [0.0, 0.0]
    a = np.linalg.norm([0.6, 0.36, 0.07 * PIXEL_ARCSEC])
    b = np.linalg.norm([0.5, 0.30, 0.06 * PIXEL_ARCSEC])
    assert found.together[0].value == pytest.approx(a / b)


def test_prediction_is_put_together_from_its_parts(monkeypatch):
    """Terms are 3 sigma in arcsec; the mean standard deviation of five frames is 0.94 of the error's."""
    table = chromatic(0.06, 0.003)
    temporal = SimpleNamespace(
        sampled_te_arcsec=lambda _: np.array([1.0, 2.0]),
        te_uncertainty_arcsec=lambda _: np.array([0.1, 0.2]),
        bound_te_arcsec=lambda: np.array([0.9, 1.8]),
    )
    steps = SimpleNamespace(
        cause_px=dict.fromkeys(("s_curve", "prnu", "pattern", "defects"), np.full(2, 0.01)),
        temporal_px=np.full(2, 0.003),
        dark_px=np.full(2, 0.004),
        roll_px=np.full(2, 0.02),
        step_rms_px=np.array([0.5, 0.6]) / (3.0 * PIXEL_ARCSEC),
        step_rms_scatter_px=np.zeros(2),
        position_rms_px=np.array([0.7, 0.8]),
        session_px2=np.zeros((0, 2)),
    )
    c1_px = np.array([[0.1, 0.2], [0.02, 0.03], [0.01, 0.04]])  # before the fit, after it, in the map
    for name, result in {
        "psfs": None,
        "sensor_maps": SimpleNamespace(defect=None),
        "target_place": None,
        "trace_target": None,
        "rendered_once": None,
        "predict_temporal": temporal,
        "_step_predictions": [{"cog": steps}],
        "predicted_terms": {"cog": table},
        "_distortion": {"cog": (c1_px, 0.1 * c1_px)},
        "_marking_alone_px": np.array([0.005, 0.006]),
        "marking": value([0.3, 0.3], [0.0, 0.0]),
    }.items():
        monkeypatch.setattr(predict_module, name, lambda *_, result=result, **__: result)
    lab = SimpleNamespace(
        instrument=SimpleNamespace(pixel_arcsec=PIXEL_ARCSEC, detector=None),
        bench=SimpleNamespace(methods=("cog",)),
        filtered=None,
        config=SimpleNamespace(seed=1, frames=5, attitude=SimpleNamespace(stars=16), steps=SimpleNamespace(places=2)),
    )
    (found,) = predict_module.predict_terms(lab).values()
    budget = found.budget
    assert budget["TE"].arcsec == pytest.approx([0.94, 1.88], rel=1e-4)
    assert budget["TE"].uncertainty_arcsec == pytest.approx([0.094, 0.188], rel=1e-4)
    assert (budget["HSFE"].arcsec[1], budget["LSFE-C2"].arcsec[0]) == pytest.approx((0.6, 0.3))
    assert found.causes_arcsec["averaged noise"] == pytest.approx([3.0 * PIXEL_ARCSEC * 0.005] * 2)
    assert found.single_arcsec == pytest.approx(3.0 * PIXEL_ARCSEC * np.array([0.7, 0.8]))
    assert budget["LSFE-C1"].arcsec == pytest.approx([0.165, 0.66])  # 3 x 5.5 arcsec
    assert budget["LSFE-C1"].uncertainty_arcsec == pytest.approx([0.0165, 0.066])
    assert (found.found_arcsec[0], found.left_arcsec[1]) == pytest.approx((1.65, 0.495))
    assert found.marking_alone_arcsec == pytest.approx([0.0825, 0.099])
    lsfe = np.hypot(PIXEL_ARCSEC * 0.06, 0.165 + 0.3)
    assert budget.attitude.arcsec[0] == pytest.approx(np.linalg.norm([0.94, 0.5, lsfe]) / 4.0, rel=1e-4)


def test_numbers_of_surveys():
    lab = SimpleNamespace(
        instrument=SimpleNamespace(pixel_arcsec=PIXEL_ARCSEC),
        config=SimpleNamespace(grid=SimpleNamespace(reference="aligned")),
    )
    each = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]) * np.array([1.0, 3.0])[:, None, None]
    every, rms, spread = _over_surveys(lab, SimpleNamespace(over_surveys=lambda *_: each), "cog")
    scale = 3.0 * PIXEL_ARCSEC
    assert every[0, 2, 1] == pytest.approx(6.0 * scale)
    assert rms[0, 0] == pytest.approx(np.sqrt(5.0) * scale)
    assert spread[0, 0] == pytest.approx(np.sqrt(2.0) * scale)


def test_sections_of_a_prediction_alone_and_with_frames():
    config = load_config(Config, settings=["compare=[]", "centroid=epsf"])
    ours, theirs = {"epsf": side(1.2, 0.02)}, {"epsf": side(1.0, 0.03)}
    alone, both = of_prediction(config, ours), of_prediction(config, ours, theirs)
    assert alone["methods"] is None
    assert len(both["methods"]) == 1
    total = ours["epsf"].budget.total.arcsec
    assert both["chief"].total_rms_arcsec == pytest.approx(np.sqrt((total**2).mean()))
    assert both["chief"].te_rms_arcsec == pytest.approx(0.6 * np.sqrt(2.5))
    assert np.shape(alone["terms"].published_arcsec) == (len(EVERY), 2)  # the published sensor by default
    other = of_prediction(
        load_config(Config, settings=["compare=[]", "centroid=epsf", "instrument.lens=star_tracker_26mm"]), ours
    )
    assert other["terms"].published_arcsec is None
    assert [one.name for one in alone["causes"]] == ["noise"]
    assert tuned(config, theirs["epsf"]) is None
    aimed = tuned(load_config(Config, settings=["published_within_fraction=0.1"]), theirs["epsf"])
    assert aimed.over_published[0][0].value == pytest.approx(0.5 / ACC18_ARCSEC["TE"][0])
    numbers_of = parts(ours["epsf"], theirs["epsf"])
    assert numbers_of.measured_left_arcsec.tolist() == [2.0, 2.0]
    assert numbers_of.one_survey_arcsec.tolist() == [3.0, 3.0]


def test_laboratory_of_the_settings():
    settings = ["steps.step_px=0.2", "steps.places=3", "grid.marking_error_arcsec=0.4", "hexapod.roll_error_arcsec=9"]
    lab = build_laboratory(load_config(Config, settings=[*settings, "grid.reference=nominal", "grid.order=2"]))
    # k = 6 terms take sqrt((k - 1) / (W - 1)) of the marking errors of W points
    points = lab.config.grid.rows * lab.config.grid.columns
    alone = 0.4 / lab.instrument.pixel_arcsec * np.sqrt(5.0 / (points - 1.0))
    assert predict_module._marking_alone_px(lab) == pytest.approx([alone] * 2, rel=0.01)
    assert marking(lab).arcsec == pytest.approx([1.2, 1.2])
    assert len(places_px(lab)) == 3
    named = setup(lab)
    assert named.between_arcsec is None or named.between_arcsec >= 0.0
    assert named.signal_e == lab.signal.signal_e
    assert named.pixel_arcsec == pytest.approx(5.5, abs=0.1)
