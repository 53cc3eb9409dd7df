"""What has to hold for a temporal-error test to count as passed; limits leave a chance of one in a hundred each."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion
from experiments.laboratory.temporal_error import small_sample_factor

__all__ = ["criteria"]


def criteria(outcome: Outcome) -> list[Criterion]:
    """Measured against predicted at every level and at the signal of the source; the ePSF fit against its bound."""
    found = []
    for method in outcome.config.methods:
        pulls = (outcome.values("level_ratio", method=method) - 1.0) / outcome.errors("level_ratio", method=method)
        found.append(
            Criterion(
                name=f"{method}: measured against predicted over all levels, largest deviation",
                value=float(np.abs(pulls).max()),
                limit=float(norm.isf(0.01 / (2 * pulls.size))),
                unit="sigma",
            )
        )
    first = outcome.config.methods[0]
    for axis in "xy":
        one = outcome.value("ratio", method=first, axis=axis)
        found.append(
            Criterion(
                name=f"{first}, {axis}: measured over predicted at the signal of the source",
                value=one.value,
                about=1.0,
                limit=max(0.1, 3.0 * (one.uncertainty or 0.0)),
            )
        )
    if "epsf" in outcome.config.methods:
        c4 = small_sample_factor(outcome.result.measured.frames)
        best = outcome.values("level_dark_arcsec", method="epsf") / (c4 * outcome.values("level_bound_arcsec"))
        spread = float(outcome.errors("level_ratio", method="epsf", axis="x").max())
        found.append(
            Criterion(
                name="ePSF fit over the Cramer-Rao bound, mean over levels and axes",
                value=float(best.mean()),
                about=1.0,
                limit=float(0.02 + 3.0 * spread / np.sqrt(best.size)),
            )
        )
    return found
