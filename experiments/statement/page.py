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
from experiments.statement.study import Statement, StatementLine


def tables(statement: Statement) -> dict[str, Table]:
    """Tables of the page."""
    result = {
        "conditions": Table(
            columns=("condition", "value", "derivation"),
            rows=list(statement.conditions),
            caption="Conditions of all numbers below.",
        ),
        "errors": _lines(statement.errors, "Errors, in the order of their contributors."),
        "detection": _lines(statement.detection, "Field of view, detection and update rate."),
        "missing": Table(
            columns=("clause", "why"),
            rows=[
                (title, reason) for title, reason, covered_by in NOT_COVERED if not (covered_by and statement.flight)
            ],
            caption="Clauses not covered.",
        ),
    }
    if statement.requirements:
        result["compliance"] = Table(
            columns=("requirement", "required", "stated", "unit", "margin", "compliant"),
            rows=[
                (
                    requirement.label,
                    f"{'≥' if requirement.at_least else '≤'} {requirement.required:g}",
                    f"{requirement.predicted:.4g}",
                    requirement.unit,
                    requirement.margin,
                    "yes" if requirement.met else "no",
                )
                for requirement in statement.requirements
            ],
            caption="Required and stated values.",
        )
    return result


def _lines(lines: Sequence[StatementLine], caption: str) -> Table:
    """Grouped by clause, in the order of `CLAUSES`."""
    rows, previous = [], ""
    for line in sorted(lines, key=lambda line: list(CLAUSES).index(line.clause)):
        clause = CLAUSES[line.clause]
        head = f"{clause.term} ({clause.clauses})" if line.clause != previous else ""
        previous = line.clause
        rows.append((head, line.quantity, line.value, line.statistic, line.conditions, line.derivation))
    heads = ("clause", "of", "value", "metric, level", "conditions", "derivation")
    return Table(columns=heads, rows=rows, caption=caption)


def page_of(statement: Statement, sensor: str) -> str:
    """One self-contained HTML page."""

    def draw(name: str, *arguments: Any) -> Any:
        raise NotImplementedError(f"{name}{arguments}")  # the page has no figures

    return render_document(
        Path(__file__).with_name("report.md"),
        Outcome(config=None, result=statement, data=xr.Dataset()),
        tables=tables(statement),
        draw=draw,
        criteria=(),
        provenance=collect("statement", {"sensor": sensor, "seed": None}, variant=None, quick=False, times_s={}),
        folded=False,
    )
