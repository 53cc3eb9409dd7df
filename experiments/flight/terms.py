"""Terms of the attitude error, measured and predicted, with verdicts on their ratios and slopes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.accuracy.attitude_terms import TERMS, AttitudeErrors, AttitudePrediction, TermEstimate, frame_correlation
from experiments.flight.frames import Segment
from experiments.flight.prediction import Budget
from experiments.harness.quantities import Outcome
from experiments.harness.sections import FALSE_ALARM, Verdict, agree, col, ratio_near
from experiments.harness.summary import Criterion, Measured
from optics.arrays import FloatArray

LABELS = {
    "bias": "Bias",
    "thermo_elastic": "Thermo-elastic error",
    "fov_spatial": "FOV spatial error",
    "pixel_spatial": "Pixel spatial error",
    "temporal_noise": "Temporal noise",
    "aberration": "Aberration of light, residual",
    "total": "Total",
}
COMPONENTS: tuple[tuple[str, tuple[int, ...]], ...] = (("across", (0, 1)), ("roll", (2,)))
FEWEST_SOLVED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeTerm:
    """Term of the budget: RMS over the flight about a cross axis, and about the boresight."""

    measured_arcsec: Sequence[Measured] | None = col("Measured", "arcsec", dims="component", default=None)
    predicted_arcsec: FloatArray = col("Predicted", "arcsec", ".4g", "component")
    ratio: Sequence[Measured] | None = col("Measured / predicted", dims="component", default=None)
    # Slope of measured errors against predicted ones over the segments; NaN for random terms
    slope: Sequence[Measured] | None = col("Slope of measured against predicted", dims="component", default=None)
    term: str  # Key of `LABELS`


def _where_finite(make: Callable[..., Verdict], name: str, *values: float, **options: Any) -> list[Verdict]:
    """Verdicts on a number of each of ``terms`` and each component; none where it is NaN."""

    def judged(term: str, component: str) -> Verdict:
        at = {"term": term, "component": component}
        verdict = make(name, *values, at=at, **options)

        def judge(outcome: Outcome) -> list[Criterion]:
            present = name in outcome and term in outcome.data["term"].values
            return verdict(outcome) if present and math.isfinite(float(outcome.values(name, **at))) else []

        judge.names = verdict.names  # type: ignore[attr-defined]
        return judge  # type: ignore[return-value]

    terms = options.pop("terms")
    return [judged(term, component) for term in terms for component, _ in COMPONENTS]


VERDICTS = [
    *_where_finite(ratio_near, "terms.ratio", within=0.15, title="measured over predicted", terms=TERMS),
    *_where_finite(ratio_near, "terms.ratio", within=0.10, title="measured over predicted", terms=("total",)),
    *_where_finite(
        agree,
        "terms.slope",
        1.0,
        slack=0.15,
        title="slope of the measured errors against the predicted ones",
        advice="a wrong sign, unit or frame: the errors have the predicted size but the wrong direction",
        terms=("thermo_elastic", "fov_spatial", "aberration"),
    ),
]


def segment_prediction(budget: Budget, errors: Sequence[AttitudeErrors]) -> AttitudePrediction:
    """Predicted errors of segments with the correlation between frames."""
    flight = budget.flight
    rates = [np.asarray(flight.trajectory.rate(error.time_s))[:2] / budget.pixel_rad for error in errors]
    return AttitudePrediction(
        errors=errors,
        correlation=[
            frame_correlation(rate, flight.frame_times_s(error.time_s))
            for rate, error in zip(rates, errors, strict=True)
        ],
        bias_arcsec=budget.bias_arcsec(),
        switched=budget.config.frames.switched,
    )


def predicted_terms(budget: Budget, errors: Sequence[AttitudeErrors]) -> list[AttitudeTerm]:
    """Terms of the prediction alone; empty where there is no attitude at any time."""
    available = [error for error in errors if error.available]
    if not available:
        return []
    prediction = segment_prediction(budget, available)
    squares = [prediction.squares(axes) for _, axes in COMPONENTS]
    return [
        AttitudeTerm(term=name, predicted_arcsec=np.sqrt([component[name] for component in squares]))
        for name in (*TERMS, "total")
    ]


def measured_terms(budget: Budget, segments: Sequence[Segment], errors: Sequence[AttitudeErrors]) -> list[AttitudeTerm]:
    """Measured and predicted terms, over the segments with both."""
    pairs = [
        (segment, error)
        for segment, error in zip(segments, errors, strict=True)
        if error.available and segment.solved.sum() >= FEWEST_SOLVED
    ]
    if len(pairs) < 2:
        return predicted_terms(budget, errors)
    prediction, solved = segment_prediction(budget, [error for _, error in pairs]), [segment for segment, _ in pairs]
    columns = [
        prediction.compare(
            axes,
            error_arcsec=[segment.error_arcsec for segment in solved],
            thermal_arcsec=[segment.thermal_arcsec for segment in solved],
            aberration_arcsec=[segment.aberration_arcsec for segment in solved],
            false_alarm=FALSE_ALARM,
        )
        for _, axes in COMPONENTS
    ]
    return [_term(name, [column[name] for column in columns]) for name in (*TERMS, "total")]


def _term(name: str, components: Sequence[TermEstimate]) -> AttitudeTerm:
    def judged(number: tuple[float, float], estimate: TermEstimate) -> Measured:
        value, error = number
        if not (estimate.comparable and math.isfinite(value)):
            return Measured(value=math.nan, uncertainty=math.nan)
        return Measured(value=value, uncertainty=error, n=estimate.samples)

    roots = [(*estimate.root_arcsec, estimate.samples) for estimate in components]
    return AttitudeTerm(
        term=name,
        measured_arcsec=[Measured(value=v, unit="arcsec", uncertainty=error, n=n) for v, error, n in roots],
        predicted_arcsec=np.sqrt([estimate.predicted_arcsec2 for estimate in components]),
        ratio=[judged(estimate.ratio, estimate) for estimate in components],
        slope=[judged(estimate.slope, estimate) for estimate in components],
    )
