"""Whether frames confirm the prediction, where they were rendered."""

from __future__ import annotations

from dataclasses import replace

from experiments.harness.quantities import Outcome, shown_unit
from experiments.harness.summary import Criterion

__all__ = ["criteria"]


def criteria(outcome: Outcome) -> list[Criterion]:
    """Those of all points; none of a sweep by prediction alone."""
    axis = outcome.result.axes[0]
    return [
        replace(one, name=f"{axis.label} {point.at[0]:g} {shown_unit(axis.unit)}".rstrip() + f": {one.name}")
        for point in outcome.result.points
        for one in point.criteria
    ]
