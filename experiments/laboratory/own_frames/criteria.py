"""What has to hold for frames from outside: they are usable; the numbers themselves are not judged."""

from __future__ import annotations

from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion

__all__ = ["criteria"]


def criteria(outcome: Outcome) -> list[Criterion]:
    """The share of the frames that gave a position."""
    return [
        Criterion(
            name="frames that gave a position, smallest share over points and centroiders",
            value=float(outcome.values("usable_fraction").min()),
            limit=0.9,
            relation=">=",
        )
    ]
