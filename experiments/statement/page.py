"""The statement as a printable page in the layout of the reports."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from experiments.harness.document import render_document
from experiments.harness.provenance import collect
from experiments.harness.quantities import Outcome
from experiments.harness.tables import Table
from experiments.statement.clauses import CLAUSES, NOT_COVERED
from experiments.statement.study import Line, Statement


def tables(made: Statement) -> dict[str, Table]:
    """Tables of the page."""
    found = {
        "conditions": Table(
            columns=("condition", "value", "derivation"),
            rows=list(made.conditions),
            caption="Conditions of all numbers below.",
        ),
        "errors": _lines(made.errors, "Errors, in the order of their contributors."),
        "detection": _lines(made.detection, "Field of view, detection and update rate."),
        "missing": Table(
            columns=("clause", "why"),
            rows=[(title, why) for title, why, by in NOT_COVERED if not (by and made.flight)],
            caption="Clauses not covered.",
        ),
    }
    if made.requirements:
        found["compliance"] = Table(
            columns=("requirement", "required", "stated", "unit", "margin", "compliant"),
            rows=[
                (
                    one.label,
                    f"{'≥' if one.at_least else '≤'} {one.required:g}",
                    f"{one.predicted:.4g}",
                    one.unit,
                    one.margin,
                    "yes" if one.met else "no",
                )
                for one in made.requirements
            ],
            caption="Required and stated values.",
        )
    return found


def _lines(lines: Sequence[Line], caption: str) -> Table:
    """Grouped by clause, in the order of `CLAUSES`."""
    rows, last = [], ""
    for one in sorted(lines, key=lambda line: list(CLAUSES).index(line.clause)):
        clause = CLAUSES[one.clause]
        head = f"{clause.term} ({clause.where})" if one.clause != last else ""
        last = one.clause
        rows.append((head, one.what, one.value, one.statistic, one.conditions, one.derivation))
    heads = ("clause", "of", "value", "metric, level", "conditions", "derivation")
    return Table(columns=heads, rows=rows, caption=caption)


def page_of(made: Statement, sensor: str) -> str:
    """One self-contained HTML page."""

    def draw(name: str, *arguments: Any) -> Any:
        raise NotImplementedError(f"{name}{arguments}")  # the page has no figures

    return render_document(
        Path(__file__).with_name("report.md"),
        Outcome(config=None, result=made, data=xr.Dataset()),
        tables=tables(made),
        draw=draw,
        criteria=(),
        provenance=collect("statement", {"sensor": sensor, "seed": None}, variant=None, quick=False, times_s={}),
        folded=False,
    )
