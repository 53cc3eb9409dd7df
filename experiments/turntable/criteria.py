"""What has to hold for the turntable calibration to count as passed."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion
from experiments.turntable.case import Case
from experiments.turntable.independent import Check
from experiments.turntable.quantities import UNKNOWNS
from optics.arrays import FloatArray

__all__ = ["criteria", "rendered_limit"]


PULL_TOLERANCE = 0.10
ENOUGH_RUNS = 300
"""So many that a standard deviation is known to 4 %."""
SWEEP_TOLERANCE = 1.25
RENDERED_QUANTILE = 0.998
"""Of a scaled chi-square with the mean and the variance of the runs: their own quantile would be their largest."""
FALSE_ALARM = 1e-3
"""Probability that one of the tests against written-out equations fails although all is well (Bonferroni)."""
MOVED_LIMIT = 1e-3


def rendered_limit(ratio: FloatArray) -> float:
    """What the map error over its prediction stays below with probability `RENDERED_QUANTILE`.

    Its square is a sum of squares of unequal size; a scaled chi-square takes its mean and variance from all runs
    (Satterthwaite), where a quantile so far out would hang on one or two of them.
    """
    square = ratio**2
    if len(square) < 2:
        return float("nan")
    mean, variance = float(square.mean()), float(square.var(ddof=1))
    freedom = 2.0 * mean**2 / variance
    return float(np.sqrt(mean * chi2.ppf(RENDERED_QUANTILE, freedom) / freedom))


def _of_table(outcome: Outcome, key: str, case: Case) -> list[Criterion]:
    def value(name: str, **at: str) -> float:
        return float(outcome.values(name, table=key, **at))

    runs, predicted = int(value("runs")), value("map_predicted_arcsec")
    pulls = [value(f"{name}_rms_pull") for name in UNKNOWNS]
    chi2_error = np.sqrt(2.0 / value("degrees_of_freedom"))
    return [
        Criterion(
            name=f"{case.name}: RMS pull farthest from 1, Monte-Carlo",
            value=float(np.nanmax(np.abs(np.array(pulls) - 1))),
            limit=PULL_TOLERANCE if runs >= ENOUGH_RUNS else 3.0 / np.sqrt(2.0 * runs),
        ),
        Criterion(
            name=f"{case.name}: map error over Cramér–Rao bound, Monte-Carlo",
            value=value("map_monte_carlo_arcsec") / value("map_bound_arcsec"),
            limit=1.10,
        ),
        Criterion(
            name=f"{case.name}: rendered run, map error over prediction (limit: {RENDERED_QUANTILE:.1%} "
            "of a scaled χ² with mean and variance of the runs)",
            value=value("map_error_arcsec", reduction="estimated") / predicted,
            limit=rendered_limit(case.monte_carlo.map_rms_arcsec / case.monte_carlo.predicted_map_arcsec),
        ),
        Criterion(
            name=f"{case.name}: rendered run, |χ²/dof − 1| in its standard errors",
            value=abs(value("reduced_chi2", reduction="estimated") - 1) / chi2_error,
            limit=3.0,
            unit="σ",
        ),
        Criterion(
            name=f"{case.name}: camera model against traced lens, over the predicted map error",
            value=value("map_split_arcsec", split="model") / predicted,
            limit=0.1,
        ),
        *_independent(outcome, key, case),
    ]


def _independent(outcome: Outcome, key: str, case: Case) -> list[Criterion]:
    """By paths that share no equation with simulation and reduction."""
    chances = [name for name in Check.LABELS if name.endswith("probability")]
    made = [
        Criterion(
            name=f"{case.name}: {Check.LABELS[name]}",
            value=float(outcome.values(name, table=key)),
            limit=FALSE_ALARM / (len(chances) * outcome.data.sizes["table"]),
            relation=">=",
        )
        for name in chances
    ]
    moved = float(outcome.values("moved_part", table=key))
    return [
        *made,
        Criterion(name=f"{case.name}: {Check.LABELS['moved_part']}", value=moved, limit=MOVED_LIMIT),
    ]


def criteria(outcome: Outcome) -> list[Criterion]:
    """Nothing lost, honest covariances, a camera model that is good enough, and the bounds of narrow fields."""
    tables = zip(outcome.data.coords["table"].values, outcome.result.cases, strict=True)
    field, lean = outcome.values("field_deg")[0], outcome.values("lean_arcsec")
    estimated = outcome.values("lean_estimated_arcsec")
    return [
        Criterion(name="calibrations that did not converge", value=int(outcome.values("lost")), limit=0),
        *(criterion for key, case in tables for criterion in _of_table(outcome, key, case)),
        Criterion(
            name=f"principal point over line of sight, per axis, at {field:g}° field",
            value=float(outcome.values("field_point_over_line")[0]),
            limit=100.0,
            relation=">=",
        ),
        Criterion(
            name=f"bound against closed form at {field:g}° field",
            value=abs(float(outcome.values("field_plain_x0_px")[0] / outcome.values("field_closed_px")[0]) - 1),
            limit=0.02,
        ),
        Criterion(
            name=f"map error at {lean[-1]:g}″ of non-orthogonality over that at {lean[0]:g}″, estimated",
            value=float(estimated[-1] / estimated[0]),
            limit=SWEEP_TOLERANCE,
        ),
    ]
