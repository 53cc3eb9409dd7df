"""Attitude from N stars with the measured errors, against total / sqrt(N) (`calib.accuracy.attitude_from_stars`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.accuracy.attitude_from_stars import (
    AttitudeScatter,
    Correlation,
    DirectionErrors,
    attitude_rule_arcsec,
    simulate_attitudes,
)
from experiments.budget.settings import AttitudeConfig
from experiments.harness.drawings import curves
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, agree, col
from experiments.harness.summary import Measured, measured
from optics.arrays import FloatArray
from render.engine.random import Streams

CORRELATIONS: dict[Correlation, tuple[str, str]] = {
    "independent": ("independent", "LSFE independent"),
    "smooth": ("as it is", "chromatic LSFE common, distortion smooth"),
    "common": ("common", "LSFE common"),
}
"""Correlation of the low-frequency error from star to star -> its random stream, its label."""
TANGENT_SLACK = 0.1
"""Relative difference of angles and their tangents in a wide field."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeStudy:
    """The rule and its test, 3 sigma; components are x, y (displacement of the boresight) and roll."""

    stars: int = col("Stars")  # N of the budget
    trials: int = col("Trials")  # Fields of stars per number
    failed: int = col("Trials without an attitude")
    # Total / sqrt(N); for roll divided by the RMS distance of a star from the middle of the field, in radians
    rule_arcsec: FloatArray = col("Rule", "arcsec", ".3f", "component")
    relative_uncertainty: float = col("Uncertainty")  # Of every error: a standard deviation from so many trials
    # Errors in units of the rule for each trial's stars, root mean square: total / sqrt(N) is the shift of their mean,
    # to which the roll error about that mean adds at the boresight
    over_expected: Sequence[Measured] = col("Error / rule for the same stars", dims="component")


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrelatedErrors:
    """Attitude error at N of the budget for one correlation of the low-frequency error."""

    error_arcsec: FloatArray = col("Attitude error", "arcsec", ".3f", "component")
    over_rule: FloatArray = col("Error / rule", "", ".2f", "component")


@dataclass(frozen=True, slots=True, kw_only=True)
class StarCount:
    """Attitude errors from a number of stars."""

    stars: int = col("Stars")
    error_arcsec: FloatArray = col("Attitude error, 3σ", "arcsec", ".4g", "correlation component")
    rule_arcsec: FloatArray = col("Rule 1/√N", "arcsec", ".4g", "component")
    # Root mean variance that the estimator states for independent errors
    stated_arcsec: FloatArray = col("Stated by the estimator", "arcsec", ".4g", "component")


def attitude_study(
    half_field: FloatArray,
    errors: DirectionErrors,
    config: AttitudeConfig,
    streams: Streams,
    *,
    advance: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Monte Carlo of the attitude: the records of `SECTIONS`."""

    def scatters(stars: int, branch: Streams) -> list[AttitudeScatter]:
        return [
            simulate_attitudes(
                errors, half_field, stars, trials=config.trials, rng=branch.generator(stream), correlation=correlation
            )
            for correlation, (stream, _) in CORRELATIONS.items()
        ]

    counts, failed = [], 0
    for stars in config.counts:
        simulated = scatters(stars, streams.child("curve", stars))
        failed += sum(scatter.failed for scatter in simulated)
        counts.append(
            StarCount(
                stars=stars,
                error_arcsec=np.stack([scatter.arcsec for scatter in simulated]),
                rule_arcsec=attitude_rule_arcsec(errors, half_field, stars),
                stated_arcsec=simulated[0].stated_arcsec,
            )
        )
        advance()
    rule = attitude_rule_arcsec(errors, half_field, config.stars)
    simulated = scatters(config.stars, streams.child("at"))
    independent = simulated[0]
    return {
        "attitude": AttitudeStudy(
            stars=config.stars,
            trials=config.trials,
            failed=failed + sum(scatter.failed for scatter in simulated),
            rule_arcsec=rule,
            relative_uncertainty=independent.relative_error,
            over_expected=measured(
                independent.over_expected, independent.over_expected * independent.relative_error, config.trials
            ),
        ),
        "attitude_errors": [CorrelatedErrors(error_arcsec=s.arcsec, over_rule=s.arcsec / rule) for s in simulated],
        "attitude_curve": counts,
    }


def _axes(q: Quantities, _: Any) -> None:
    q.axis("component", ["x", "y", "roll"], "Component")
    labels = {name: label for name, (_, label) in CORRELATIONS.items()}
    q.axis("correlation", list(CORRELATIONS), "Low-frequency error", names=labels)


SECTIONS = {
    "attitude": Section(
        record=AttitudeStudy,
        axes=_axes,
        verdicts=[
            agree(
                "over_expected",
                1.0,
                slack=TANGENT_SLACK,
                title="Attitude error from stars with the measured errors over total / √N for the same stars",
            )
        ],
    ),
    "attitude_errors": Section(
        record=CorrelatedErrors,
        across="component",
        dim="correlation",
        table="attitude",
        caption="Attitude error for the budget's number of stars, 3 sigma, from solved attitudes of "
        "simulated star fields.",
        note="x, y: displacement of the boresight. Rule: total / √N; for roll also divided by the RMS distance of a "
        "star from the middle of the field.",
    ),
    "attitude_curve": Section(
        record=StarCount,
        dim="stars",
        along="stars",
        rows="stars",
        across="correlation component",
        caption="Attitude error against the number of stars, 3 sigma.",
        figures={
            "attitude_curves": curves(
                "stars",
                points="error_arcsec",
                lines="rule_arcsec",
                by="correlation",
                panels="component",
                log="xy",
                aspect_ratio=0.42,
            )
        },
    ),
}
