"""Slew and life: the prediction against slew rate and age, and the first requirement missed.

At the angular rate w a star trails over w t in the exposure t. An angular acceleration a shifts its photocentre by
a t^2 / 24 from its position in the middle of the exposure, by the same angle for all stars. A tracker that extrapolates
the last rotation is off by a T^2 after the update period T; the error has to stay within half the window.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from experiments.camera.settings import CameraReportConfig
from experiments.harness.drawings import curves
from experiments.harness.quantities import Quantities
from experiments.harness.range import with_value
from experiments.harness.sections import Section, col, numbers_of
from experiments.harness.system import shared
from experiments.harness.what_if import Requirement, crossing, judge
from experiments.laboratory.sensor_prediction import (
    CameraPrediction,
    Optics,
    SkyPerformance,
    StarAccuracy,
    longest_trail_px,
    optical_state,
    overridden_detector,
    predict_camera,
)
from experiments.laboratory.settings.prediction import aged_config
from optics.arrays import FloatArray
from optics.errors import StarbenchError
from render.sensor_file.ageing import aged_transmission

AGES = 5
"""Ages of the curves over life."""
RATE = "slew_rate_deg_per_s"
"""Requirement that is met or missed by motion alone."""
_CURVES = (
    "nea_arcsec",
    "limiting_magnitude_mag",
    "stars_mean_per_frame",
    "attitude_cross_arcsec",
    "attitude_roll_arcsec",
)

Limits = Mapping[str, tuple[float, bool]]
Numbers = tuple[Optics, StarAccuracy, SkyPerformance]


def _curves(predictions: Sequence[Numbers | None], names: Sequence[str] = _CURVES) -> dict[str, FloatArray]:
    """Predicted numbers by name, one value per prediction; NaN where there is none."""
    values = [{name: v for record in records or () for name, v in asdict(record).items()} for records in predictions]
    columns = {name: [numbers.get(name, math.nan) for numbers in values] for name in names}
    return {name: np.where(np.isfinite(column), column, math.nan) for name, column in columns.items()}


def _judged(numbers: Numbers, limits: Limits) -> list[Requirement]:
    return judge(limits, numbers_of(*numbers))


def _predicted(config: CameraReportConfig) -> Numbers | None:
    """None where a prediction is refused, such as for stars that leave their window."""
    try:
        return predict_camera(config).records
    except StarbenchError:
        return None


def slewing_config(config: CameraReportConfig, fraction: float = 1.0) -> CameraReportConfig:
    """The sensor at a fraction of the slew rate at which the trail of a star fills its window."""
    at_rest = optical_state(with_value(config, "slew.rate_deg_per_s", 0.0))
    trail_px, _, _ = longest_trail_px(config, at_rest)
    fastest = max(trail_px, 0.0) * at_rest.pixel_arcsec / 3600.0 / config.instrument.exposure_s
    return _at_rate(config, fraction * min(fastest, 100.0) * (1.0 - 1e-9))


def _at_rate(config: CameraReportConfig, rate_deg_per_s: float) -> CameraReportConfig:
    slewing: CameraReportConfig = with_value(config, "slew.rate_deg_per_s", float(rate_deg_per_s))
    return slewing


def _first_missed(
    config_at: Callable[[float], CameraReportConfig], limits: Limits, inside: float, outside: float
) -> tuple[float, str]:
    """Value between ``inside``, which meets all requirements, and ``outside`` where the first is missed; its key.

    Infinite where ``outside`` meets them too.
    """
    missed: dict[float, str] = {}

    def met(value: float) -> bool:
        numbers = _predicted(config_at(value))
        if numbers is None:
            missed[value] = "no prediction"
            return False
        verdicts = sorted(_judged(numbers, limits), key=lambda requirement: requirement.excess)
        missed[value] = verdicts[0].key if verdicts else ""
        return all(verdict.met for verdict in verdicts)

    if met(outside):
        return math.inf, ""
    limit = crossing(met, inside, outside)
    return limit, missed[min(value for value in missed if value >= limit)]


# --- In motion


@dataclass(frozen=True, slots=True, kw_only=True)
class SlewPrediction:
    """Prediction against slew rate; largest rate and acceleration."""

    trail_px: FloatArray = col("Trail", "px", ".2f", "rate")
    nea_arcsec: FloatArray = col("NEA", "arcsec", ".3f", "rate")
    limiting_magnitude_mag: FloatArray = col("Limiting magnitude", "mag", ".2f", "rate")
    stars_mean_per_frame: FloatArray = col("Stars per frame", "", ".1f", "rate")
    attitude_cross_arcsec: FloatArray = col("Attitude across, median", "arcsec", ".3f", "rate")
    attitude_roll_arcsec: FloatArray = col("Attitude roll, median", "arcsec", ".3f", "rate", shown=False)
    slew_rate_deg_per_s: float = col("Largest slew rate", "deg/s", ".3g")
    first_failure: str = col("First failure in motion")
    acceleration_deg_per_s2: float = col("Largest angular acceleration while tracking", "deg/s2", ".3g")
    acceleration_bias_s2: float = col("Attitude error across per angular acceleration", "s2", ".3g")
    rate_deg_per_s: FloatArray


def in_motion(prediction: CameraPrediction, limits: Limits) -> SlewPrediction | None:
    """From rest to the rate at which stars leave their window; None with a rolling shutter, or without rates."""
    config, setting = prediction.config, prediction.config.motion
    exposure_s = config.instrument.exposure_s
    if config.instrument.line_time_us or not setting.points:
        return None

    pixel_deg = prediction.state.pixel_arcsec / 3600.0
    fastest = slewing_config(config).slew.rate_deg_per_s
    rates = np.linspace(0.0, setting.fastest_deg_per_s or fastest, setting.points)
    predictions = shared(_predicted, [_at_rate(config, rate) for rate in rates])
    # without a requirement on it, the attitude has to exist in half of the sky
    required = {"attitude_cross_arcsec": (1e9, False)} | {key: limit for key, limit in limits.items() if key != RATE}
    rest = next((numbers for numbers in predictions if numbers is not None), None)
    largest_rate = 0.0
    failure = "at rest"
    if rest is not None:  # a requirement that is missed at rest is not missed by motion
        met_at_rest = {verdict.key: required[verdict.key] for verdict in _judged(rest, required) if verdict.met}
        largest_rate, failure = _first_missed(partial(_at_rate, config), met_at_rest, 0.0, fastest)
        if not math.isfinite(largest_rate):
            largest_rate, failure = fastest, "window_px"
    period_s = config.timing.period_s(exposure_s)
    return SlewPrediction(
        **_curves(predictions),
        trail_px=np.radians(rates) * exposure_s / np.radians(pixel_deg),
        slew_rate_deg_per_s=largest_rate,
        first_failure=failure,
        acceleration_deg_per_s2=(config.window_px // 2) * pixel_deg / period_s**2,
        acceleration_bias_s2=exposure_s**2 / 24.0,
        rate_deg_per_s=rates,
    )


def _rate_axis(q: Quantities, motion: SlewPrediction) -> None:
    q.axis("rate", motion.rate_deg_per_s, "Slew rate", unit="deg/s", format=".3g")


MOTION = Section(
    record=SlewPrediction,
    axes=_rate_axis,
    columns="trail_px nea_arcsec limiting_magnitude_mag stars_mean_per_frame attitude_cross_arcsec",
    caption="Performance against slew rate across the line of sight.",
    figures={
        "motion": curves(
            "rate",
            lines="attitude_cross_arcsec nea_arcsec",
            log="y",
            y="1σ",
            aspect_ratio=0.9,
            width="half",
        ),
    },
)


# --- Over life


@dataclass(frozen=True, slots=True, kw_only=True)
class LifePrediction:
    """Prediction against age."""

    transmission: FloatArray = col("Light", "", ".3f", "age")
    dark_e: FloatArray = col("Dark charge", "e-", ".2f", "age")
    damaged_percent: FloatArray = col("Damaged pixels", "percent", ".2f", "age")
    nea_arcsec: FloatArray = col("NEA", "arcsec", ".3f", "age")
    limiting_magnitude_mag: FloatArray = col("Limiting magnitude", "mag", ".2f", "age")
    false_alarms_per_frame: FloatArray = col("False alarms per frame", "", ".3g", "age")
    stars_mean_per_frame: FloatArray = col("Stars per frame", "", ".1f", "age")
    attitude_cross_arcsec: FloatArray = col("Attitude across, median", "arcsec", ".3f", "age")
    attitude_roll_arcsec: FloatArray = col("Attitude roll, median", "arcsec", ".3f", "age", shown=False)
    requirements_missed_at_end: int = col("Requirements missed at the end of life")
    requirements_at_end: int = col("Requirements compared at the end of life")
    lifetime_years: float = col("Age up to which all requirements are met", "yr", ".3g")
    first_failure: str = col("First failure with age")
    age_years: FloatArray


def over_life(prediction: CameraPrediction, limits: Limits) -> LifePrediction | None:
    """Prediction from the beginning to the end of life; None without a life."""
    config = prediction.config
    if not config.life.years:
        return None
    limits = {key: limit for key, limit in limits.items() if key != RATE}
    fractions = np.linspace(0.0, 1.0, AGES)
    configs = [aged_config(config, float(fraction)) for fraction in fractions]
    predictions = shared(_predicted, configs)
    new, old = predictions[0], predictions[-1]
    at_end = [] if old is None else _judged(old, limits)
    lifetime, failure = math.inf, ""
    if new is not None and (at_begin := _judged(new, limits)):
        if missed := [requirement for requirement in at_begin if not requirement.met]:
            lifetime, failure = 0.0, min(missed, key=lambda requirement: requirement.excess).key
        else:
            lifetime, failure = _first_missed(partial(aged_config, config), limits, 0.0, 1.0)
    detectors = [overridden_detector(aged) for aged in configs]
    dark_time_s = detectors[0].dark_factor(config.instrument.chip_temperature_c) * config.instrument.exposure_s
    dark_e_per_s = [
        detector.dark_current_e_per_s + detector.damage_centres_per_px * detector.damage_dark_e_per_s
        for detector in detectors
    ]
    return LifePrediction(
        **_curves(predictions, (*_CURVES, "false_alarms_per_frame")),
        transmission=np.array([aged_transmission(config.life, float(fraction)) for fraction in fractions]),
        dark_e=dark_time_s * np.array(dark_e_per_s),
        damaged_percent=100.0 * -np.expm1(-np.array([detector.damage_centres_per_px for detector in detectors])),
        requirements_missed_at_end=sum(not verdict.met for verdict in at_end) if at_end else len(limits),
        requirements_at_end=len(at_end) or len(limits),
        lifetime_years=lifetime * config.life.years,
        first_failure=failure,
        age_years=config.life.years * fractions,
    )


def life_line(life: LifePrediction) -> str:
    """Line on the life for the terminal."""
    result = f"attitude {life.attitude_cross_arcsec[-1]:.3g}\u2033 across"
    if life.requirements_at_end:
        result = f"{life.requirements_at_end - life.requirements_missed_at_end} of {life.requirements_at_end} met"
    failure = (
        f"; first missed: {life.first_failure} after {life.lifetime_years:.2g} years" if life.first_failure else ""
    )
    return f"{'End of life':<19} {life.age_years[-1]:g} years: {result}{failure}"


def _age_axis(q: Quantities, life: LifePrediction) -> None:
    q.axis("age", life.age_years, "Age", unit="yr", format=".2f")


LIFE = Section(
    record=LifePrediction,
    axes=_age_axis,
    caption="Performance from beginning to end of life.",
    figures={
        "life": curves(
            "age",
            lines="attitude_cross_arcsec nea_arcsec",
            y="1σ",
            aspect_ratio=0.9,
            width="half",
        ),
    },
)
