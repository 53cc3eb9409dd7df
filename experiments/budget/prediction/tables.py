"""Tables of the predicted budget."""

from __future__ import annotations

from experiments.budget.tables import sweep_table
from experiments.harness.pivot import Pivot
from experiments.harness.quantities import Outcome
from experiments.harness.tables import Table

__all__ = ["tables"]


def tables(outcome: Outcome) -> dict[str, Table | Pivot]:
    """Every table by name."""
    made: dict[str, Table | Pivot] = {
        "budget": Pivot(
            rows="term",
            across="axis",
            columns="predicted_arcsec",
            caption="The budget, 3 sigma, predicted; uncertainties are one standard deviation.",
        ),
        "causes": Pivot(rows="cause", across="axis", columns="cause_arcsec", caption="HSFE by cause, 3 sigma."),
    }
    if outcome.result.sweep is not None:
        made["sweep"] = sweep_table(outcome)
    return made
