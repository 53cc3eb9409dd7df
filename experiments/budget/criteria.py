"""What has to hold for a budget."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from experiments.budget.combine import TERMS
from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion

__all__ = ["criteria"]

TERM_LIMIT, TOTAL_LIMIT = 0.10, 0.05
ALARM = 0.01
"""Probability that a pull criterion fails although everything is right."""


def _limit(count: int) -> float:
    return float(norm.isf(ALARM / (2 * count)))


def criteria(outcome: Outcome) -> list[Criterion]:
    """Predicted over measured, term by term; sums; statistics of the tolerances; the document's arithmetic.

    A ratio is judged by 10 % (the total by 5 %), or by three of its own standard deviations where a run was made too
    small to tell 10 %. A term that does not stand out of its uncertainty has no ratio: its difference is judged.
    """
    found: list[Criterion] = []
    for name, limit in (*((term, TERM_LIMIT) for term in TERMS[:-1]), ("total", TOTAL_LIMIT)):
        for axis in "xy":
            ratio, spread = (float(read("ratio", term=name, axis=axis)) for read in (outcome.values, outcome.errors))
            if np.isfinite(ratio):
                own = max(limit, float(f"{3.0 * spread:.2g}"))
                found.append(
                    Criterion(name=f"{name} {axis}: predicted / measured, off 1 by", value=abs(ratio - 1.0), limit=own)
                )
    for name in TERMS[:-1]:
        pulls = outcome.result.pull(name)
        count = 2 * (outcome.data.sizes["pair"] if name == "LSFE-S" else 1)
        found.append(
            Criterion(
                name=f"{name}: predicted minus measured, x and y, largest",
                value=float(np.abs(pulls).max()),
                limit=round(_limit(count), 2),
                unit="sigma",
            )
        )
    return [*found, *_others(outcome)]


def _others(outcome: Outcome) -> list[Criterion]:
    tolerance = outcome.result.tolerances
    printed = outcome.values("published_arcsec", term="total") - outcome.values("by_equations_arcsec", term="total")
    apart = np.abs(tolerance.spread_arcsec / np.maximum(tolerance.linear_arcsec, 1e-12) - 1.0)
    found = [
        Criterion(
            name="built lenses: scatter of the chromatic entries against the sum of sensitivities, relative",
            value=float(apart.max()),
            limit=round(max(_limit(apart.size) * tolerance.spread_uncertainty, 0.05), 3),
        ),
        Criterion(
            name="document: total by eq. 31-32 from the printed terms against the printed total",
            value=float(np.abs(printed).max()),
            limit=0.005,
            unit="arcsec",
        ),
    ]
    within = outcome.config.published_within_fraction
    if within is None:
        return found
    for name in ("TE", "HSFE", "LSFE-S", "total"):
        for axis in "xy":
            at = {"term": name, "axis": axis}
            wanted = float(outcome.values("by_equations_arcsec", **at))
            seen, spread = (float(read("measured_arcsec", **at)) for read in (outcome.values, outcome.errors))
            found.append(
                Criterion(
                    name=f"{name} {axis}: measured / published, off 1 by",
                    value=abs(seen / wanted - 1.0),
                    limit=max(within, float(f"{3.0 * spread / wanted:.2g}")),
                )
            )
    return found
