"""What has to hold for a budget."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from experiments.budget.combine import FRAME_TERMS
from experiments.budget.result import TermPair
from experiments.budget.thermal import ThermalTerm
from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion, farthest_from_one
from experiments.laboratory.collimator_effects import chromatic_criteria

__all__ = ["criteria"]

RATIO_LIMIT, RATIO_LIMIT_MOST = 0.10, 0.25
"""Predicted over measured may be off one by the first, or by its sampling error up to the second."""
PARAXIAL_PPM_PER_K = 2.0
"""Mean of all light against the chief ray: what coma may add as the focus changes. For the built-in lens aluminium in
place of titanium is 8."""
ALARM = 0.05
"""Probability that any of the comparisons in standard deviations fails although everything is right."""


def _limit(count: int, alarm: float = 0.01) -> float:
    """Largest of so many normal deviations that is exceeded with this probability."""
    return float(norm.isf(alarm / (2 * count)))


def criteria(outcome: Outcome) -> list[Criterion]:
    """Predicted against measured, term by term and centroider by centroider; tolerances; the document's arithmetic.

    Terms are compared in standard deviations that hold what is frozen into one chip; what frames can contradict, alone
    and together, and the total as ratios too (`_ratios`).
    """
    result, found = outcome.result, []
    tested, methods = outcome.data["tested"].values.tolist(), result.config.methods
    for method in methods:
        for name in tested:
            pulls = result.pair(method).pulls(name)
            found.append(
                Criterion(
                    name=f"{name}, {method}: predicted minus measured, largest",
                    value=float(np.abs(pulls).max()),
                    limit=round(_limit(pulls.size, ALARM / (len(methods) * len(tested))), 2),
                    unit="sigma",
                )
            )
    found += [one for method in methods for one in _ratios(result.pair(method), method, len(methods))]
    if result.collimator is not None:
        found += chromatic_criteria(result.collimator)
    return [*found, *_target(outcome), *_thermal(outcome), *_others(outcome)]


def _ratios(pair: TermPair, method: str, methods: int) -> list[Criterion]:
    """Predicted over measured: within 10 %, or its own sampling error where a run is too small to tell 10 %.

    No criterion where a term does not stand out, or the run is too small to tell 25 %: such a limit would hold for
    anything.
    """
    ratio = {name: pair.ratio(name) for name in (*FRAME_TERMS, "total")}
    ratio["TE, HSFE and S together"] = pair.together()
    deviations, found = _limit(2 * methods * len(ratio), ALARM), []
    for name, (value, spread) in ratio.items():
        limit = max(RATIO_LIMIT, float(f"{deviations * spread.max():.2g}"))
        if np.isfinite(value).all() and limit <= RATIO_LIMIT_MOST:
            label = f"{name}, {method}: predicted / measured"
            found.append(Criterion(name=label, value=farthest_from_one(value), about=1.0, limit=limit))
    return found


def _thermal(outcome: Outcome) -> list[Criterion]:
    """The image grows with temperature as traced, and as the paraxial chief ray says."""
    term = outcome.result.thermal
    if not isinstance(term, ThermalTerm):
        return []
    pulls = (term.measured_scale_ppm_per_k - term.scale_ppm_per_k) / term.scale_sigma_ppm_per_k
    return [
        Criterion(
            name="LSFE-T: scale against temperature, frames minus ray trace, largest",
            value=float(np.abs(pulls).max()),
            limit=round(_limit(2), 2),
            unit="sigma",
        ),
        Criterion(
            name="LSFE-T: scale against temperature, ray trace minus paraxial chief ray, largest",
            value=float(np.abs(term.scale_ppm_per_k - term.paraxial_ppm_per_k).max()),
            limit=PARAXIAL_PPM_PER_K,
            unit="1e-6/K",
        ),
    ]


def _target(outcome: Outcome) -> list[Criterion]:
    """The surveys have the marking error that the budget takes for C2."""
    grid = outcome.config.grid
    if not grid.marking_error_arcsec:
        return []
    marked, surveyed = outcome.values("measured_arcsec", term="LSFE-C2"), outcome.values("surveyed_arcsec")
    samples = grid.surveys * grid.rows * grid.columns
    return [
        Criterion(
            name="scatter of the surveyed places about the true ones over C2",
            value=farthest_from_one(surveyed / marked),
            about=1.0,
            limit=float(f"{_limit(2) / np.sqrt(2.0 * samples):.2g}"),
        )
    ]


def _others(outcome: Outcome) -> list[Criterion]:
    tolerance = outcome.result.tolerances
    apart = np.abs(tolerance.spread_arcsec / np.maximum(tolerance.linear_arcsec, 1e-12) - 1.0)
    found = [
        Criterion(
            name="built lenses: scatter of the chromatic entries against the sum of sensitivities, relative",
            value=float(apart.max()),
            limit=round(max(_limit(apart.size) * tolerance.spread_uncertainty, 0.05), 3),
        ),
    ]
    if outcome.result.published is None:
        return found
    printed = outcome.values("published_arcsec", term="total") - outcome.values("by_equations_arcsec", term="total")
    found.append(
        Criterion(
            name="document: total by eq. 31-32 from the printed terms against the printed total",
            value=float(np.abs(printed).max()),
            limit=0.005,
            unit="arcsec",
        )
    )
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
