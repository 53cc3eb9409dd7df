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

READINGS: dict[str, tuple[Correlation, str]] = {
    "independent": ("independent", "LSFE independent"),
    "as it is": ("smooth", "chromatic LSFE common, distortion smooth"),
    "common": ("common", "LSFE common"),
}
"""Correlation of the low-frequency error from star to star, and its label."""
FAR_FROM_THE_AXIS = 0.1
"""Part by which angles and their tangents may differ in a wide field."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attitude:
    """The study, 3 sigma; components are x, y (displacement of the boresight) and roll."""

    stars: int = col("Stars")  # N of the budget
    trials: int = col("Trials")  # Fields of stars per number
    failed: int = col("Trials without an attitude")
    # Total / sqrt(N); for roll divided by the RMS distance of a star from the middle of the field, in radians
    rule_arcsec: FloatArray = col("Rule", "arcsec", ".3f", "component")
    relative_uncertainty: float = col("Uncertainty")  # Of every error: a standard deviation from so many trials
    # Errors in units of what the rule makes of each trial's stars, root mean square: the shift of their mean by
    # ``total / sqrt(N)``, carried to the boresight by the roll that they leave
    over_expected: Sequence[Measured] = col("Error / rule for the same stars", dims="component")


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Attitude error at N of the budget, by reading of the low-frequency error."""

    arcsec: FloatArray = col("Attitude error", "arcsec", ".3f", "component")
    over_rule: FloatArray = col("Error / rule", "", ".2f", "component")


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """Attitude errors from a number of stars."""

    stars: int = col("Stars")
    arcsec: FloatArray = col("Attitude error, 3σ", "arcsec", ".4g", "reading component")
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
    """Monte-Carlo of the attitude: the records of `SECTIONS`."""

    def scatters(stars: int, at: Streams) -> list[AttitudeScatter]:
        return [
            simulate_attitudes(
                errors, half_field, stars, trials=config.trials, rng=at.generator(name), correlation=correlation
            )
            for name, (correlation, _) in READINGS.items()
        ]

    numbers, every = [], []
    for stars in config.counts:
        every += (found := scatters(stars, streams.child("curve", stars)))
        numbers.append(
            Number(
                stars=stars,
                arcsec=np.stack([one.arcsec for one in found]),
                rule_arcsec=attitude_rule_arcsec(errors, half_field, stars),
                stated_arcsec=found[0].stated_arcsec,
            )
        )
        advance()
    rule = attitude_rule_arcsec(errors, half_field, config.stars)
    first, *_ = here = scatters(config.stars, streams.child("at"))
    part = first.relative_error
    return {
        "attitude": Attitude(
            stars=config.stars,
            trials=config.trials,
            failed=sum(one.failed for one in (*every, *here)),
            rule_arcsec=rule,
            relative_uncertainty=part,
            over_expected=measured(first.over_expected, first.over_expected * part, config.trials),
        ),
        "readings": [Errors(arcsec=one.arcsec, over_rule=one.arcsec / rule) for one in here],
        "attitude_curve": numbers,
    }


def _axes(q: Quantities, _: Any) -> None:
    q.axis("component", ["x", "y", "roll"], "Component")
    labels = {name: label for name, (_, label) in READINGS.items()}
    q.axis("reading", list(READINGS), "Low-frequency error", names=labels)


SECTIONS = {
    "attitude": Section(
        record=Attitude,
        axes=_axes,
        verdicts=[
            agree(
                "over_expected",
                1.0,
                slack=FAR_FROM_THE_AXIS,
                title="Attitude error from stars with the measured errors over total / √N for the same stars",
            )
        ],
    ),
    "readings": Section(
        record=Errors,
        across="component",
        dim="reading",
        table="attitude",
        caption="Attitude error for the budget's number of stars, 3 sigma, from solved attitudes of "
        "simulated star fields.",
        note="x, y: displacement of the boresight. Rule: total / √N; for roll also divided by the RMS distance of a "
        "star from the middle of the field.",
    ),
    "attitude_curve": Section(
        record=Number,
        dim="stars",
        along="stars",
        rows="stars",
        across="reading component",
        caption="Attitude error against the number of stars, 3 sigma.",
        figures={
            "attitude_curves": curves(
                "stars",
                points="arcsec",
                lines="rule_arcsec",
                by="reading",
                panels="component",
                log="xy",
                aspect_ratio=0.42,
            )
        },
    ),
}
