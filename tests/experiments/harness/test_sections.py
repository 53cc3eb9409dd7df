"""Sections and verdicts: what follows from a record, what a verdict allows, and that every name is described."""

from dataclasses import dataclass
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.harness.pivot import pivot
from experiments.harness.quantities import Outcome, Quantities, to_results
from experiments.harness.registry import declaration_of, found
from experiments.harness.sections import (
    Section,
    above,
    agree,
    below,
    col,
    described,
    ratio_near,
    tabulated,
    two_sided_limit,
)
from optics.errors import DomainError


def outcome_of(ratio: float, error: float, within: float = 0.05) -> Outcome:
    """A ratio per axis, and what it may be off."""
    q = Quantities()
    q.axis("axis", ["x", "y"])
    q.add("ratio", [1.0, ratio], "Ratio", dims="axis", error=[error, error])
    q.add("allowed", within)
    return Outcome(config=SimpleNamespace(), result={}, data=q.dataset)


@pytest.mark.parametrize(
    ("ratio", "error", "holds"), [(1.05, 0.01, True), (1.09, 0.01, False), (0.91, 0.01, False), (1.09, 0.03, True)]
)
def test_a_ratio_may_be_off_by_a_part_and_its_noise(ratio, error, holds):
    assert two_sided_limit(2) == pytest.approx(2.807, abs=1e-3)  # 1 % over two normal deviates
    (judged,) = ratio_near("ratio", within=0.05)(outcome_of(ratio, error))
    assert judged.limit == pytest.approx(0.05 + 2.807 * error, abs=1e-4)
    assert judged.passed is holds


@pytest.mark.parametrize("slack", [0.06, "allowed"])
def test_a_prediction_may_be_off_by_three_standard_deviations(slack):
    (judged,) = agree("ratio", 1.0, slack=slack)(outcome_of(1.1, 0.01, within=0.06))
    assert judged.value == pytest.approx(0.1 / np.hypot(0.01, 0.02))
    assert judged.limit == pytest.approx(2.807, abs=1e-3)


def test_a_run_too_small_to_tell_is_not_judged():
    assert ratio_near("ratio", within=0.05, most=0.25)(outcome_of(1.0, 0.2)) == []
    assert ratio_near("missing", within=0.05)(outcome_of(1.0, 0.2)) == []
    (judged,) = ratio_near("ratio", within=0.05)(outcome_of(np.nan, 0.01))
    assert not judged.passed


# --- Every experiment that is declared in sections


@pytest.mark.parametrize("name", found())
def test_sections_name_quantities_that_are_described(name):
    """Names in figures, verdicts, columns are strings that only a run would check."""
    declared = import_module(declaration_of(f"experiments.{name}")).experiment
    sections = declared.parts(None)
    known = {section.prefix + field for section in sections.values() for field in section.columns_of()}
    for key, section in sections.items():
        fields = section.columns_of()
        assert not section.along or section.along in section.record.__dataclass_fields__, key
        assert {one for one in section.columns.split() if one not in fields} <= known, key
        assert set(section.json) <= set(fields), key
        drawn = {one for figure in section.figures.values() for one in getattr(figure, "names", ())}
        judged = {one for verdict in section.verdicts for one in verdict.names}
        assert drawn | judged <= known, key


def test_records_become_quantities_tables_and_json():
    @dataclass(frozen=True, kw_only=True)
    class Level:
        signal_e: float = col("Signal", "e-", ".0f")
        error_arcsec: list = col("Error", "arcsec", dims="axis", json="found.error")
        hidden_px: float | None = col("Hidden", "px", shown=False, default=None)

    levels = Section(record=Level, dim="level", along="signal_e", place="levels[level]", table="levels", across="axis")
    q = Quantities()
    q.axis("axis", ["x", "y"], "Axis")
    rows = [Level(signal_e=s, error_arcsec=[s / 100, s / 50], hidden_px=s / 10) for s in (100.0, 400.0)]
    outcome = Outcome(
        config=None, result={"levels": rows}, data=described({"levels": levels}, q, {"levels": rows}).dataset
    )
    assert to_results(outcome.data)["levels"][1] == {
        "signal_e": 400.0,
        "found": {"error": {"x": 4.0, "y": 8.0}},
        "hidden_px": 40.0,
    }
    shown, whole = (
        pivot(outcome.data, tabulated({"levels": levels}, outcome, every=e)["levels"]) for e in (False, True)
    )
    assert [one.key for one in shown.heads] == ["signal_e", "error_arcsec_x", "error_arcsec_y"]
    assert [one.key for one in whole.heads][3:] == ["hidden_px"]
    assert whole.rows[1] == (400.0, 4.0, 8.0, 40.0)
    with pytest.raises(DomainError, match="no section is declared for lost"):
        described({"levels": levels}, Quantities(), {"lost": rows})


def test_deviations_count_in_the_uncertainties_of_both():
    q = Quantities()
    q.axis("axis", ["x", "y"])
    q.add("seen", [1.0, 2.0], dims="axis", error=[0.3, 0.1])
    q.add("meant", [1.5, 2.1], dims="axis", error=[0.4, 0.0])
    outcome = Outcome(config=None, result={}, data=q.dataset)
    (both,) = agree("seen", "meant")(outcome)
    assert both.value == pytest.approx(1.0)  # 0.5 / hypot(0.3, 0.4), 0.1 / 0.1
    x, y = agree("seen", 2.0, each="axis", slack=0.3)(outcome)
    assert (x.value, y.value) == (pytest.approx(1.0 / np.hypot(0.3, 0.2)), 0.0)
    (top,) = below("seen", 1.5)(outcome)
    assert (top.value, top.limit, top.passed) == (2.0, 1.5, False)
    (low,) = above("seen", "meant")(outcome)
    assert (low.value, low.limit, low.passed) == (1.0, 1.5, False)


def test_false_alarms_are_as_frequent_as_stated():
    rng, failed, runs = np.random.default_rng(1), 0, 4000
    for _ in range(runs):
        q = Quantities()
        q.add("value", rng.standard_normal(8), dims="sample", error=np.ones(8))
        failed += not agree("value", 0.0, false_alarm=0.05)(Outcome(config=None, result={}, data=q.dataset))[0].passed
    assert failed / runs == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / runs))
