"""Sections and verdicts: what follows from a record, what a verdict allows, and that every name is described."""

import re
from collections import Counter
from dataclasses import dataclass
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.harness.pivot import pivot
from experiments.harness.quantities import Outcome, Quantities, to_results
from experiments.harness.registry import declaration_of, experiment_names
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


def ratios(values, error: float) -> Outcome:
    """Independent ratios of the same standard deviation."""
    q = Quantities()
    q.add("ratio", values, "Ratio", dims="sample", error=np.full(len(values), error))
    return Outcome(config=SimpleNamespace(), result={}, data=q.dataset)


@pytest.mark.parametrize(
    ("ratio", "error", "holds"), [(1.05, 0.01, True), (1.09, 0.01, False), (0.91, 0.01, False), (1.09, 0.03, True)]
)
def test_a_ratio_may_be_off_by_a_part_and_its_noise(ratio, error, holds):
    assert two_sided_limit(2, 0.01) == pytest.approx(2.807, abs=1e-3)  # 1 % over two normal deviates
    (judged,) = ratio_near("ratio", within=0.05, false_alarm=0.01)(outcome_of(ratio, error))
    assert judged.limit == pytest.approx(0.05 + 2.807 * error, abs=1e-4)
    assert judged.passed is holds


@pytest.mark.parametrize("slack", [0.06, "allowed"])
def test_a_prediction_may_be_off_by_three_standard_deviations(slack):
    (judged,) = agree("ratio", 1.0, slack=slack, false_alarm=0.01)(outcome_of(1.1, 0.01, within=0.06))
    assert judged.value == pytest.approx(0.1 / np.hypot(0.01, 0.02))
    assert judged.limit == pytest.approx(2.807, abs=1e-3)


VERDICTS = (
    agree("ratio", 1.0, false_alarm=0.05),
    ratio_near("ratio", within=0.0, false_alarm=0.05),
    ratio_near("ratio", within=0.0, mean=True, false_alarm=0.05),
)


@pytest.mark.parametrize("verdict", VERDICTS, ids=("agree", "near", "mean"))
def test_a_sample_too_small_to_notice_a_quarter_is_shown_and_not_judged(verdict):
    assert ratio_near("missing", within=0.05)(outcome_of(1.0, 0.2)) == []
    (small,) = verdict(outcome_of(1.1, 0.2))
    assert small.passed is None
    assert not small.failed
    (worse,) = verdict(outcome_of(9.0, 0.2))  # beyond even that limit
    assert worse.failed
    assert verdict(ratios([np.nan, np.nan], 0.01))[0].failed


@pytest.mark.parametrize("verdict", VERDICTS, ids=("agree", "near", "mean"))
def test_verdicts_fail_as_often_as_they_state(verdict):
    """Right numbers at the stated false alarm, and all off by what the verdict says it notices in half of all runs."""
    rng, error, runs = np.random.default_rng(1), 0.06, 100
    failed = {"right": 0, "off": 0}
    chances = []
    for _ in range(runs):
        noise = error * rng.standard_normal(8)
        (right,) = verdict(ratios(1.0 + noise, error))
        failed["right"] += right.failed
        failed["off"] += verdict(ratios(1.0 + right.notices + noise, error))[0].failed
        chances.append(right.chance)
    assert right.notices < 0.25
    assert failed["right"] / runs == pytest.approx(right.false_alarm, abs=4 * np.sqrt(0.05 / runs))
    assert failed["off"] / runs == pytest.approx(0.5, abs=4 * np.sqrt(0.25 / runs))
    assert np.mean(np.array(chances) < 0.1) == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / runs))


def test_what_an_error_is_a_part_of():
    ratio = ratios([1.0], 0.1)
    (plain,) = agree("ratio", 1.0)(ratio)
    assert plain.notices == pytest.approx(0.1 * plain.limit, rel=1e-6)
    for verdict in (agree("ratio", 1.0, square=True), ratio_near("ratio", within=0.0, square=True)):
        assert (1.0 + verdict(ratio)[0].notices) ** 2 == pytest.approx(1.0 + plain.notices)
    (bias,) = agree("ratio", 0.0, of=8.0, error=0.2)(ratio)
    assert bias.notices == pytest.approx(bias.limit * np.hypot(0.1, 0.2) / 8.0, rel=1e-6)
    assert agree("ratio", 0.0)(ratio)[0].notices is None
    assert [below("ratio", limit, whole=4.0)(ratio)[0].passed for limit in (7.5, 4.0, 0.5)] == [None, True, False]


# --- Every experiment that is declared in sections


@pytest.mark.parametrize("name", experiment_names())
def test_sections_name_quantities_that_are_described(name):
    """Names in figures, verdicts, columns are strings that only a run would check."""
    declared = import_module(declaration_of(f"experiments.{name}")).experiment
    sections = declared.parts(None)
    of_section = {key: set(section.columns_of()) for key, section in sections.items()}
    qualified = {f"{key}.{field}" for key, fields in of_section.items() for field in fields}
    count = Counter(field for fields in of_section.values() for field in fields)
    alone = {field for field, sections_with in count.items() if sections_with == 1}
    for key, section in sections.items():
        known = of_section[key] | alone | qualified
        assert not section.along or section.along in section.record.__dataclass_fields__, key
        assert set(section.columns.split()) <= known, key
        drawn = {one for figure in section.figures.values() for one in getattr(figure, "names", ())}
        judged = {one for verdict in section.verdicts for one in verdict.names}
        assert drawn | judged <= known, key


QUERY = re.compile(r"""(?:value|values|errors|quantity|heading|dims)\("([\w.]+)"|"([\w.]+)" (?:not )?in outcome""")


@pytest.mark.parametrize("name", experiment_names())
def test_reports_name_quantities_that_are_described(name):
    declared = import_module(declaration_of(f"experiments.{name}")).experiment
    fields = [(key, field) for key, section in declared.parts(None).items() for field in section.columns_of()]
    count = Counter(field for _, field in fields)
    known = {f"{key}.{field}" for key, field in fields} | {field for field, sections in count.items() if sections == 1}
    named = {first or second for first, second in QUERY.findall(declared.template.read_text(encoding="utf-8"))}
    assert {one for one in named if not one.endswith(".")} <= known


def test_records_become_quantities_tables_and_json():
    @dataclass(frozen=True, kw_only=True)
    class Level:
        signal_e: float = col("Signal", "e-", ".0f")
        error_arcsec: list = col("Error", "arcsec", dims="axis")
        hidden_px: float | None = col("Hidden", "px", shown=False, default=None)

    levels = Section(record=Level, dim="level", along="signal_e", table="levels", across="axis")
    q = Quantities()
    q.axis("axis", ["x", "y"], "Axis")
    rows = [Level(signal_e=s, error_arcsec=[s / 100, s / 50], hidden_px=s / 10) for s in (100.0, 400.0)]
    outcome = Outcome(
        config=None, result={"levels": rows}, data=described({"levels": levels}, q, {"levels": rows}).dataset
    )
    levels_of_summary = to_results(outcome.data)["levels"]
    assert [levels_of_summary[field]["value"][1] for field in ("signal_e", "hidden_px")] == [400.0, 40.0]
    assert levels_of_summary["error_arcsec"]["value"][1] == {"x": 4.0, "y": 8.0}
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
