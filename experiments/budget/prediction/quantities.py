"""The numbers of the predicted budget: those of the whole report that need no frames, by the same names."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.budget.combine import ECSS, SUMS, TERMS
from experiments.budget.quantities import ANGLE, LABELS, OF_TERMS, describe_sweep, of_budget
from experiments.harness.quantities import Quantities
from experiments.laboratory.signal import add_signal

if TYPE_CHECKING:
    from experiments.budget.prediction.experiment import Prediction

__all__ = ["describe"]


def describe(result: Prediction) -> Quantities:
    """Terms and sums, causes of the pixel term, the sweep."""
    q = Quantities()
    every = (*TERMS, *SUMS)
    names = {name: LABELS.get(name, name) for name in every}
    names["attitude"] = f"attitude, total / √{result.config.attitude.stars}"
    q.axis("term", list(names), "Term", names=names)
    q.axis("axis", ["x", "y"], "Axis")
    q.add("ecss", [ECSS[name] for name in names], "ECSS-E-ST-60-20C", dims="term")
    add_signal(q, result.lab.signal)
    budget = result.predicted.budget
    q.add(
        "predicted_arcsec",
        of_budget(budget),
        "Predicted",
        **OF_TERMS,
        error=of_budget(budget, "uncertainty_arcsec"),
        json="terms[term][axis].predicted_arcsec_3sigma",
        json_error="terms[term][axis].predicted_uncertainty",
    )
    causes = result.predicted.causes_arcsec
    q.axis("cause", list(causes), "Cause")
    q.add("cause_arcsec", np.array(list(causes.values())), "3σ", **ANGLE, dims="cause axis", format=".3f",
          json="parts.hsfe_causes_predicted")  # fmt: skip
    if result.sweep is not None:
        describe_sweep(q, result.sweep)
    return q
