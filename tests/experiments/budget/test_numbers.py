"""Both sides of the budget: terms over places and surveys, ratios, pulls, sums; by hand and drawn."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.accuracy.error_budget import ErrorTerm, combine
from experiments.budget.chromatic import ChromaticTerm, tabulate_table1
from experiments.budget.experiment import (
    COMPARED_TERMS,
    describe_conditions,
    deviations,
    judge_agreement,
    match_published,
)
from experiments.budget.laboratory import build_laboratory, field_positions_px, target_survey_term
from experiments.budget.settings import BudgetConfig
from experiments.harness.config import load_config
from experiments.laboratory.settings.published import ACC18_ARCSEC

PIXEL_ARCSEC = 5.5
NAMES = ("TE", "HSFE", "LSFE-S", "LSFE-C1", "LSFE-C2")


def chromatic(x, sigma, n=0):
    return ChromaticTerm(
        pairs=("600-500", "800-600"),
        table1_px=np.array([[x, -0.02], [0.01, 0.05]]),
        sigma_px=np.array([[sigma, 0.001], [0.001, 0.002]]),
        rms_px=np.array([[0.3, 0.4], [0.1, 0.2]]),
        pixel_arcsec=PIXEL_ARCSEC,
        n=n,
    )


def side(scale=1.0, uncertainty=0.03, table=None, n=0):
    """Terms 0.5, 0.3, S, 0.2, 0.4 times a factor, in x; twice of it in y."""
    table = table or chromatic(0.06, 0.003, n)
    sizes = zip(NAMES, scale * np.array([0.5, 0.3, 0.0, 0.2, 0.4]), strict=True)
    term = {
        name: ErrorTerm(arcsec=np.array([size, 2 * size]), uncertainty_arcsec=np.full(2, uncertainty), n=n)
        for name, size in sizes
    }
    term["LSFE-S"] = table.error_term()
    return SimpleNamespace(budget=combine(term, stars=4), chromatic=table)


def test_largest_entry_of_table_1_is_the_term():
    table = chromatic(-0.06, 0.003, n=80)
    term = table.error_term()
    assert term.arcsec == pytest.approx(PIXEL_ARCSEC * np.array([0.06, 0.05]))
    assert term.uncertainty_arcsec == pytest.approx(PIXEL_ARCSEC * np.array([0.003, 0.002]))
    assert term.n == 80
    assert not replace(table, table1_px=np.full((2, 2), 1e-8)).error_term().arcsec.any()  # rounding of a trace
    first, second = tabulate_table1(chromatic(-0.05, 0.0), table)
    assert (first.pair, first.measured_px[0].value, first.measured_px[0].uncertainty) == ("600-500", -0.06, 0.003)
    assert (first.predicted_px[0], first.measured_px[0].n, second.rms_px[1]) == (-0.05, 80, 0.2)


def test_deviations_of_both_sides():
    ours, theirs = side(1.2, 0.02, chromatic(0.07, 0.004)), side(1.0, 0.03, chromatic(0.06, 0.003))
    entries = deviations(ours, theirs, "LSFE-S")
    assert entries[0, 0] == pytest.approx(0.01 / 0.005)
    assert entries[1] == pytest.approx([0.0, 0.0])
    comparison = judge_agreement(ours, theirs)
    deviation_sigma = dict(zip(COMPARED_TERMS, comparison.deviation_sigma, strict=True))
    assert deviation_sigma["LSFE-S"] == pytest.approx([2.0, 0.0])
    assert deviation_sigma["TE"] == pytest.approx(np.array([0.1, 0.2]) / np.hypot(0.02, 0.03))
    assert comparison.term_over_sigma[COMPARED_TERMS.index("HSFE")] == pytest.approx(np.array([0.36, 0.72]) / 0.02)
    assert comparison.term_over_sigma[COMPARED_TERMS.index("LSFE-C2")].tolist() == [0.0, 0.0]
    assert comparison.frame_terms_ratio[0].value == pytest.approx(
        np.linalg.norm([0.6, 0.36, 0.07 * PIXEL_ARCSEC]) / np.linalg.norm([0.5, 0.30, 0.06 * PIXEL_ARCSEC])
    )


def test_a_tuned_budget_is_judged_by_the_published_one():
    measured = side(1.0, 0.03)
    assert match_published(load_config(BudgetConfig), measured) is None
    match = match_published(load_config(BudgetConfig, settings=["published_within_fraction=0.1"]), measured)
    assert match.over_published[0][0].value == pytest.approx(0.5 / ACC18_ARCSEC["TE"][0])


def test_laboratory_of_the_settings():
    settings = ["steps.step_px=0.2", "steps.places=3", "grid.marking_error_arcsec=0.4", "hexapod.roll_error_arcsec=9"]
    lab = build_laboratory(load_config(BudgetConfig, settings=[*settings, "grid.reference=nominal", "grid.order=2"]))
    assert target_survey_term(lab).arcsec == pytest.approx([1.2, 1.2])
    assert len(field_positions_px(lab)) == 3
    assert describe_conditions(lab).frame_to_frame_arcsec is None  # a collimator at rest
    assert describe_conditions(lab).pixel_arcsec == pytest.approx(5.5, abs=0.1)
