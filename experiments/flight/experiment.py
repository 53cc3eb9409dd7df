"""Flight of a star sensor: error budget, rendered frames, their error terms, metrics, availability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.accuracy.attitude_terms import AttitudeErrors
from calib.accuracy.ecss_metrics import ecss_metrics, normal_factor, success_limit
from calib.attitude.tracker import sky_coverage
from experiments.flight.frames import Segment, render_flight
from experiments.flight.prediction import Budget, build_budget
from experiments.flight.scenario import Flight, build_flight
from experiments.flight.settings import FlightConfig
from experiments.flight.terms import COMPONENTS, LABELS, VERDICTS, AttitudeTerm, measured_terms, predicted_terms
from experiments.harness.drawings import bars, curves
from experiments.harness.progress import Progress
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, above, below, col
from experiments.harness.summary import Measured, measured
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.heated_lens import ThermalState
from render.motion.trajectory import rate_of_trail, trail_of_rate

ORBIT_SAMPLES = 61
"""Times of the curves over the orbit."""
COVERAGE_ATTITUDES = 1500
"""Random attitudes of the sky coverage."""
CONFIDENCE = 0.9
"""Confidence of the lower limit of the acquisition success."""
LEVEL = 0.95
"""Confidence level of the metrics."""


# --- The sensor and its mission


@dataclass(frozen=True, slots=True, kw_only=True)
class Mission:
    """Sensor, guide catalogue, availability and acquisition."""

    name: str = col("Sensor")
    lens: str = col("Lens")
    detector: str = col("Detector")
    period_s: float = col("Period of the orbit", "s", ".0f")
    rate_deg_per_s: float = col("Rate across the line of sight, mean", "deg/s", ".4g")
    # Angular acceleration a, exposure t: mean attitude over t minus attitude at mid-exposure = a t^2 / 24
    acceleration_bias_s2: float = col("Attitude error across per angular acceleration", "s2", ".3g")
    guide_stars: int = col("Guide stars")
    guide_stars_mean: float = col("Guide stars in the field, mean over the sky", "", ".1f")
    guide_stars_worst: float = col("Guide stars in the field, worst 1 % of the sky", "", ".1f")
    sky_coverage_percent: float = col("Sky with enough guide stars", "percent", ".2f")
    guide_star_error_arcsec: float = col("Error of a guide star without noise, median", "arcsec", ".3g")
    available_percent: float = col("Availability over the orbit, predicted", "percent", ".1f")
    # None without frames
    solved_percent: Measured | None = col("Fraction of unblinded frames tracked", "percent", default=None)
    acquired_fraction: Measured | None = col("Successful lost-in-space acquisitions", default=None)
    acquired_lower_limit: float | None = col(
        "Acquisition success, lower limit at 90 % confidence", "", ".3f", default=None
    )
    acquisition_time_s: Measured | None = col("Time of an acquisition on this machine", "s", default=None)
    wrong_attitudes: int | None = col("Wrong attitudes", default=None)
    rejected_per_frame: float | None = col("Windows rejected per frame", "", ".3g", default=None)
    false_stars_per_frame: float | None = col("Planets and cosmic rays per frame, truth", "", ".3g", default=None)


def summarise_mission(budget: Budget, history: Sequence[OrbitSample], segments: Sequence[Segment]) -> Mission:
    """Numbers of the mission."""
    config, flight, state = budget.config, budget.flight, budget.nominal.state
    counts = sky_coverage(
        budget.guides, budget.model, attitudes=COVERAGE_ATTITUDES, margin_px=config.window_px // 2 + 1.0
    )
    rates = [trail_of_rate(flight.trajectory.rate(sample.time_min * 60.0))[0] for sample in history]
    lens = state.sensor.camera.lens.name
    detector = budget.nominal.detector.name
    return Mission(
        name=config.name or f"{lens} on {detector}",
        lens=lens,
        detector=detector,
        period_s=flight.period_s,
        rate_deg_per_s=float(np.mean(rates)),
        acceleration_bias_s2=config.instrument.exposure_s**2 / 24.0,
        guide_stars=len(budget.guides),
        guide_stars_mean=float(counts.mean()),
        guide_stars_worst=float(np.quantile(counts, 0.01)),
        sky_coverage_percent=100.0 * float((counts >= config.tracker.fewest).mean()),
        guide_star_error_arcsec=float(np.median(budget.star_error_px)) * state.pixel_arcsec,
        available_percent=100.0 * float(np.mean([sample.available for sample in history])),
        **_measured_mission([segment for segment in segments if not segment.blinded]),
    )


def _measured_mission(unblinded: Sequence[Segment]) -> dict[str, Any]:
    """Numbers of rendered segments that no body blinds."""
    if not unblinded:
        return {}

    def fraction(values: FloatArray, scale: float = 1.0, unit: str = "") -> Measured:
        p = float(np.mean(values))
        error = scale * math.sqrt(p * (1.0 - p) / len(values))
        return Measured(value=scale * p, unit=unit, uncertainty=error, n=len(values))

    def per_frame(name: str) -> float:
        return float(np.concatenate([getattr(segment, name) for segment in unblinded]).mean())

    acquired = np.array([segment.acquired == "ok" for segment in unblinded])
    times_s = np.array([segment.acquisition_s for segment in unblinded])
    error = float(times_s.std() / math.sqrt(len(times_s)))
    return {
        "solved_percent": fraction(np.concatenate([segment.solved for segment in unblinded]), 100.0, "percent"),
        "acquired_fraction": fraction(acquired),
        "acquired_lower_limit": success_limit(int(acquired.sum()), len(acquired), CONFIDENCE),
        "acquisition_time_s": Measured(value=float(times_s.mean()), unit="s", uncertainty=error, n=len(times_s)),
        "wrong_attitudes": sum(segment.wrong for segment in unblinded),
        "rejected_per_frame": per_frame("rejected"),
        "false_stars_per_frame": per_frame("false_stars"),
    }


# --- Over the orbit


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitSample:
    """Prediction at a time of the orbit."""

    time_min: float = col("Time", "min", ".1f")
    mean_k: float = col("Lens above its calibration", "K", ".2f")
    sun_deg: float = col("Angle to the Sun", "deg", ".1f")
    earth_deg: float = col("Angle to the Earth's limb", "deg", ".1f")
    moon_deg: float = col("Angle to the Moon", "deg", ".1f")
    background_e_per_s: float = col("Stray light", "e-/s", ".3g", shown=False)
    stars: float = col("Guide stars", "", ".1f")
    thermo_elastic_arcsec: FloatArray = col("Thermo-elastic error", "arcsec", ".4g", "axis", shown=False)
    aberration_arcsec: FloatArray = col("Aberration, residual", "arcsec", ".4g", "axis", shown=False)
    noise_arcsec: FloatArray = col("Temporal noise", "arcsec", ".4g", "axis", shown=False)
    available: bool  # Whether there is an attitude


def orbit_samples(budget: Budget, progress: Progress) -> list[OrbitSample]:
    """Prediction at even times over the orbit."""
    flight, rows = budget.flight, []
    for time_s in progress.track(np.linspace(0.0, flight.period_s, ORBIT_SAMPLES).tolist(), "prediction"):
        errors, angles = budget.errors(time_s), flight.angles_deg(time_s)
        rows.append(
            OrbitSample(
                time_min=time_s / 60.0,
                mean_k=float(flight.thermal.at(time_s)[0]),
                background_e_per_s=float(flight.background_e_per_s(time_s)),
                stars=errors.stars,
                thermo_elastic_arcsec=errors.thermal_arcsec,
                aberration_arcsec=errors.aberration_arcsec,
                noise_arcsec=np.sqrt(errors.noise_arcsec2),
                available=errors.available,
                **{f"{body}_deg": float(angle) for body, angle in angles.items()},
            )
        )
    return rows


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentErrors:
    """Rendered segment: errors, means over its frames, and their prediction."""

    time_min: float = col("Time", "min", ".1f")
    stars: float = col("Stars used", "", ".1f")
    error_arcsec: FloatArray = col("Attitude error", "arcsec", ".4f", "axis")
    thermo_elastic_arcsec: Sequence[Measured] = col("Thermo-elastic error", "arcsec", dims="axis")
    predicted_thermo_elastic_arcsec: FloatArray = col("Predicted", "arcsec", ".4f", "axis", shown=False)
    aberration_arcsec: Sequence[Measured] = col("Aberration, residual", "arcsec", dims="axis")
    predicted_aberration_arcsec: FloatArray = col("Predicted", "arcsec", ".4f", "axis", shown=False)
    status: str = col("First frame")


def segment_errors(segments: Sequence[Segment], errors: Sequence[AttitudeErrors]) -> list[SegmentErrors]:
    """Errors of all segments."""

    def mean(values: FloatArray) -> list[Measured]:
        solved = values[np.isfinite(values).all(axis=1)]
        if not len(solved):
            return [Measured(value=math.nan, uncertainty=math.nan)] * 3
        error = solved.std(axis=0, ddof=1) / math.sqrt(len(solved)) if len(solved) > 1 else np.full(3, np.nan)
        return list(measured(solved.mean(axis=0), error, len(solved), "arcsec"))

    rows = []
    for segment, predicted in zip(segments, errors, strict=True):
        solved = segment.solved
        rows.append(
            SegmentErrors(
                time_min=segment.start_s / 60.0,
                stars=float(segment.stars[solved].mean()) if solved.any() else 0.0,
                error_arcsec=segment.error_arcsec[:, solved].mean(axis=(0, 1)) if solved.any() else np.full(3, np.nan),
                thermo_elastic_arcsec=mean(segment.thermal_arcsec),
                predicted_thermo_elastic_arcsec=predicted.thermal_arcsec,
                aberration_arcsec=mean(segment.aberration_arcsec),
                predicted_aberration_arcsec=predicted.aberration_arcsec,
                status=segment.acquired.replace("_", " "),
            )
        )
    return rows


# --- Metrics of the standard


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """An error metric at the confidence level, for a normal error of the predicted terms."""

    metric: str = col("Metric")
    meaning: str = col("Meaning")
    predicted_arcsec: FloatArray = col("Predicted", "arcsec", ".4g", "component")
    measured_arcsec: Sequence[float] | None = col("Measured", "arcsec", ".4g", "component", default=None)


METRICS = (
    ("AME", "attitude error at any time", ("total",)),
    ("MME", "mean error of a segment", ("bias", "thermo_elastic", "fov_spatial", "aberration")),
    ("RME", "error about the mean of its segment", ("pixel_spatial", "temporal_noise")),
)
"""ECSS-E-ST-60-20C: absolute, mean and relative measurement error."""


def metrics(terms: Sequence[AttitudeTerm], segments: Sequence[Segment]) -> list[Metric]:
    """Metrics at `LEVEL`, across about one axis, mixed interpretation: over the sampled orbit."""
    squares = {term.term: np.square(term.predicted_arcsec) for term in terms}
    values: list[dict[str, float]] = []
    if any(segment.solved.any() for segment in segments):
        # (segments, frames, 3) Errors of the first readout
        error = np.array([np.where(segment.solved[:, None], segment.error_arcsec[0], np.nan) for segment in segments])
        series = error.reshape(-1, 3).T
        values = [ecss_metrics(series[list(component_axes)], error.shape[1], LEVEL) for _, component_axes in COMPONENTS]
    return [
        Metric(
            metric=name,
            meaning=meaning,
            predicted_arcsec=normal_factor(LEVEL) * np.sqrt(np.sum([squares[term] for term in contributors], axis=0)),
            measured_arcsec=[component[name] for component in values] or None,
        )
        for name, meaning, contributors in METRICS
    ]


# --- Begin and end of life


@dataclass(frozen=True, slots=True, kw_only=True)
class AgePrediction:
    """Prediction at begin or end of life."""

    age: str = col("Life")
    limiting_magnitude_mag: float = col("Limiting magnitude, half detected", "mag", ".2f")
    electrons_e: float = col("Electrons of a star of 6 mag", "e-", ".0f")
    dark_e: float = col("Dark charge", "e-", ".3g")
    stars: float = col("Guide stars, mean of the flight", "", ".1f")
    available_percent: float = col("Availability at the segments", "percent", ".1f")
    noise_arcsec: FloatArray = col("Temporal noise", "arcsec", ".4g", "component")
    total_arcsec: FloatArray = col("Total", "arcsec", ".4g", "component")


def age_prediction(budget: Budget, errors: Sequence[AttitudeErrors]) -> AgePrediction:
    """Prediction of a budget at its age."""
    terms = {term.term: term.predicted_arcsec for term in predicted_terms(budget, errors)}
    no_attitude = np.full(len(COMPONENTS), np.nan)
    electrons = float(budget.nominal.electrons(np.array([6.0]), budget.config.star_temperature_k)[0])
    return AgePrediction(
        age="end" if budget.old else "begin",
        limiting_magnitude_mag=budget.nominal.limits_mag[0.5],
        electrons_e=electrons,
        dark_e=budget.nominal.pixel.dark_e,
        stars=float(np.mean([error.stars for error in errors])),
        available_percent=100.0 * float(np.mean([error.available for error in errors])),
        noise_arcsec=terms.get("temporal_noise", no_attitude),
        total_arcsec=terms.get("total", no_attitude),
    )


# --- Against rate and temperature


@dataclass(frozen=True, slots=True, kw_only=True)
class RatePrediction:
    """Prediction for the stars of the segments at a slew rate."""

    rate_deg_per_s: float = col("Rate", "deg/s", "g")
    trail_px: float = col("Trail of a star", "px", ".2f")
    noise_arcsec: FloatArray = col("Temporal noise", "arcsec", ".4g", "component")
    pixel_spatial_arcsec: FloatArray = col("Pixel spatial error", "arcsec", ".4g", "component")


def _by_component(squares: Sequence[FloatArray]) -> FloatArray:
    """RMS by component from n squared errors about x, y and roll (3,); NaN where n = 0."""
    values = np.array(squares).reshape(-1, 3) if len(squares) else np.full((1, 3), np.nan)
    return np.sqrt([values[:, list(axes)].mean() for _, axes in COMPONENTS])


def rate_predictions(budget: Budget) -> list[RatePrediction]:
    """Predictions at the configured rates; NaN where the trail is too long for the window."""
    flight, rows = budget.flight, []
    for rate in budget.config.rates_deg_per_s:
        rate_rad_per_s = rate_of_trail(rate, 0.0)
        try:
            predictions = [
                budget.errors_of(flight.trajectory.attitude(time), rate_rad_per_s, time) for time in flight.segments_s
            ]
        except DomainError:  # the window is too small for the trail
            predictions = []
        available = [errors for errors in predictions if errors.available]
        rows.append(
            RatePrediction(
                rate_deg_per_s=rate,
                trail_px=float(np.radians(rate)) * budget.config.instrument.exposure_s / budget.pixel_rad,
                noise_arcsec=_by_component([errors.noise_arcsec2 for errors in available]),
                pixel_spatial_arcsec=_by_component([errors.static_arcsec2 for errors in available]),
            )
        )
    return rows


@dataclass(frozen=True, slots=True, kw_only=True)
class StateSensitivity:
    """Attitude error per kelvin of a component of the temperature field, RMS over the segments."""

    state: str = col("Temperature")
    attitude_arcsec_per_k: FloatArray = col("Attitude error per kelvin", "arcsec", ".4g", "component")
    corner_px_per_k: float = col("Shift of a star in the corner per kelvin", "px", ".4f")


STATE_LABELS = {
    "mean_k": "uniform",
    "axial_k": "front to detector",
    "transverse_x_k": "across, along columns",
    "transverse_y_k": "across, along rows",
    "radial_k": "elements, middle to edge",
}


def state_sensitivities(budget: Budget) -> list[StateSensitivity]:
    """Sensitivities to the thermal states that occur in the flight."""
    corner, rows = budget.model.unproject(np.array([[-0.5, -0.5]])), []
    for name, shift in budget.sensitivity.items():
        state = ThermalState(**{name: 1.0}).vector
        errors = [budget.errors(float(start), state_k=state) for start in budget.flight.segments_s]
        rms = _by_component([error.thermal_arcsec**2 for error in errors if error.available])
        corner_shift_px = math.hypot(*shift.at(corner)[0])
        rows.append(
            StateSensitivity(state=STATE_LABELS[name], attitude_arcsec_per_k=rms, corner_px_per_k=corner_shift_px)
        )
    return rows


# --- The run


def axes(config: FlightConfig) -> Quantities:
    """Dimensions that all sections share."""
    q = Quantities()
    q.axis("component", [name for name, _ in COMPONENTS], "Component")
    q.axis("axis", ["x", "y", "roll"], "Axis")
    return q


def _term_axis(q: Quantities, terms: Sequence[AttitudeTerm]) -> None:
    keys = [term.term for term in terms]
    q.axis("term", np.array(keys, dtype=object), "Term", names=[LABELS[key] for key in keys])


def at_segments(budget: Budget, flight: Flight) -> list[AttitudeErrors]:
    """Prediction in the middle of each segment."""
    pairs = zip(flight.segments_s, flight.states_k, strict=True)
    return [budget.errors(float(flight.frame_times_s(start).mean()), state_k=state) for start, state in pairs]


def run(config: FlightConfig, *, progress: Progress) -> dict[str, Any]:
    """Budget, orbit, rendered segments and the terms of their errors.

    Raises
    ------
    StarbenchError
        For unusable tables, orbits, lenses without thermal data, sensors without stars.
    """
    flight = build_flight(config)
    with progress.stage("budget"):
        budgets = [build_budget(config, flight, old=old) for old in (False, True)[: 1 + (config.life.years > 0)]]
    budget = budgets[config.frames.end_of_life]
    history = orbit_samples(budget, progress)
    errors_by_age = [at_segments(aged, flight) for aged in budgets]
    errors = errors_by_age[config.frames.end_of_life]
    segments: list[Segment] = []
    if not config.predict_only:
        with progress.stage("frames", total=config.frames.segments * config.frames.frames) as stage:
            segments = render_flight(budget, advance=stage.advance)
    terms = measured_terms(budget, segments, errors) if segments else predicted_terms(budget, errors)
    return {
        "mission": summarise_mission(budget, history, segments),
        "terms": terms or None,
        "metrics": metrics(terms, segments) if terms else None,
        "history": history,
        "segments": segment_errors(segments, errors) if segments else None,
        "rates": rate_predictions(budget) or None,
        "thermal_sensitivity": state_sensitivities(budget) or None,
        "ageing": [age_prediction(*pair) for pair in zip(budgets, errors_by_age, strict=True)],
    }


SECTIONS = {
    "mission": Section(
        record=Mission,
        vertical=True,
        caption="Sensor, guide catalogue, availability and acquisition.",
        verdicts=[
            below("wrong_attitudes", 0.0, title="wrong attitudes"),
            above("solved_percent", 95.0, title="tracked fraction of the unblinded frames"),
        ],
    ),
    "terms": Section(
        record=AttitudeTerm,
        dim="term",
        axes=_term_axis,
        rows="term component",
        columns="measured_arcsec predicted_arcsec ratio slope",
        caption="Attitude error by terms, RMS over the flight, one standard deviation; across: about one axis.",
        note="No ratio or slope: the term is below 5 % of the total. The total adds errors of known sign (bias, thermo-"
        "elastic, FOV spatial, aberration) in every segment, not their squares.",
        figures={"terms": bars("term", bars="measured_arcsec", points="predicted_arcsec", panels="component")},
        verdicts=VERDICTS,
    ),
    "metrics": Section(
        record=Metric,
        dim="metric_row",
        hidden="metric_row",
        rows="metric_row component",
        caption="Metrics at a confidence level of 95 %.",
        note="Predicted for a normal error; measured: quantile of all frames, or of all segments.",
    ),
    "history": Section(
        record=OrbitSample,
        dim="moment",
        along="time_min",
        caption="Geometry and temperature over the orbit.",
        figures={
            "angles": curves("moment", lines="sun_deg earth_deg moon_deg", y="Angle from the boresight"),
            "temperature": curves("moment", lines="mean_k"),
        },
    ),
    "segments": Section(
        record=SegmentErrors,
        dim="segment",
        along="time_min",
        rows="segment",
        columns="stars status thermo_elastic_arcsec aberration_arcsec error_arcsec",
        across="axis",
        caption="Rendered segments.",
        figures={
            name: curves(
                "segment",
                points=f"{name}_arcsec",
                lines=f"predicted_{name}_arcsec",
                panels="axis",
                aspect_ratio=0.36,
            )
            for name in ("thermo_elastic", "aberration")
        },
    ),
    "ageing": Section(
        record=AgePrediction,
        dim="life",
        rows="life",
        hidden="life",
        across="component",
        caption="Predicted performance at begin and end of life.",
    ),
    "rates": Section(
        record=RatePrediction,
        dim="rate",
        along="rate_deg_per_s",
        across="component",
        caption="Prediction for the same stars while the body turns across the line of sight.",
        note="No number: the trail is too long for the window.",
    ),
    "thermal_sensitivity": Section(
        record=StateSensitivity,
        dim="state_row",
        rows="state_row",
        hidden="state_row",
        across="component",
        caption="Attitude error per kelvin, RMS over the segments.",
    ),
}
