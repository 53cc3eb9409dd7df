"""Slew and life: the prediction against slew rate and age, and the first requirement missed.

A star of a camera that turns at w trails over w t in the exposure t; an acceleration a moves the mean of its light by a
t^2 / 24 from its position in the middle of the exposure, alike for all stars. A tracker that extrapolates the last turn
is off by a T^2 after the period T, which has to stay within half the window.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from experiments.camera.settings import Config
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
RATE = "slew_rate_deg_per_s"
_NAMES = (
    "nea_arcsec",
    "limiting_magnitude_mag",
    "stars_mean_per_frame",
    "attitude_cross_arcsec",
    "attitude_roll_arcsec",
)

Limits = Mapping[str, tuple[float, bool]]
Numbers = tuple[Optics, StarAccuracy, SkyPerformance]


def _values(found: Sequence[Numbers | None], prefix: str, names: Sequence[str] = _NAMES) -> dict[str, FloatArray]:
    """Numbers of several predictions by the names of a record's columns, NaN where there is none."""
    known = [{name: v for part in one or () for name, v in asdict(part).items()} for one in found]
    columns = {f"{prefix}_{name}": [one.get(name, math.nan) for one in known] for name in names}
    return {name: np.where(np.isfinite(column), column, math.nan) for name, column in columns.items()}


def _judged(found: Numbers, limits: Limits) -> list[Requirement]:
    return judge(limits, numbers_of(*found))


def _predicted(config: Config) -> Numbers | None:
    """None where nothing can be predicted, such as a star that leaves its window."""
    try:
        return predict_camera(config).records
    except StarbenchError:
        return None


def moving(config: Config, part: float = 1.0) -> Config:
    """The sensor at a part of the slew rate at which the trail of a star fills its window."""
    at_rest = optical_state(with_value(config, "slew.rate_deg_per_s", 0.0))
    most_px, _, _ = longest_trail_px(config, at_rest)
    widest = max(most_px, 0.0) * at_rest.pixel_arcsec / 3600.0 / config.instrument.exposure_s
    rate: Config = with_value(config, "slew.rate_deg_per_s", part * min(widest, 100.0) * (1.0 - 1e-9))
    return rate


def _first_missed(at: Callable[[float], Config], limits: Limits, held: float, lost: float) -> tuple[float, str]:
    """Where between a value that meets all requirements and one that does not the first is missed, and which."""
    missed: dict[float, str] = {}

    def met(value: float) -> bool:
        found = _predicted(at(value))
        worst = sorted([] if found is None else _judged(found, limits), key=lambda one: one.excess)[:1]
        missed[value] = "no prediction" if found is None else "".join(one.key for one in worst)
        return found is not None and all(one.met for one in worst)

    if not met(lost):
        lost = crossing(met, held, lost)
        return lost, missed[min(value for value in missed if value >= lost)]
    return math.inf, ""


# --- In motion


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """The sensor against its slew rate; largest rate and acceleration."""

    motion_trail_px: FloatArray = col("Trail", "px", ".2f", "rate")
    motion_nea_arcsec: FloatArray = col("NEA", "arcsec", ".3f", "rate")
    motion_limiting_magnitude_mag: FloatArray = col("Limiting magnitude", "mag", ".2f", "rate")
    motion_stars_mean_per_frame: FloatArray = col("Stars per frame", "", ".1f", "rate")
    motion_attitude_cross_arcsec: FloatArray = col("Attitude across, median", "arcsec", ".3f", "rate")
    motion_attitude_roll_arcsec: FloatArray = col("Attitude roll, median", "arcsec", ".3f", "rate", shown=False)
    slew_rate_deg_per_s: float = col("Largest slew rate", "deg/s", ".3g")
    slew_fails: str = col("First failure in motion")
    acceleration_deg_per_s2: float = col("Largest angular acceleration while tracking", "deg/s2", ".3g")
    acceleration_bias_s2: float = col("Attitude error across per angular acceleration", "s2", ".3g")
    rate_deg_per_s: FloatArray


def in_motion(prediction: CameraPrediction, limits: Limits) -> Motion | None:
    """From rest to where stars leave their window; None with a rolling shutter, or without rates."""
    config, setting = prediction.config, prediction.config.motion
    exposure_s = config.instrument.exposure_s
    if config.instrument.line_time_us or not setting.points:
        return None

    def at(rate: float) -> Config:
        moved: Config = with_value(config, "slew.rate_deg_per_s", float(rate))
        return moved

    pixel_deg = prediction.state.pixel_arcsec / 3600.0
    widest = moving(config).slew.rate_deg_per_s
    last = widest if setting.fastest_deg_per_s is None else setting.fastest_deg_per_s
    rates = np.linspace(0.0, last, setting.points)
    found = shared(_predicted, [at(rate) for rate in rates])
    # some stars are needed for an attitude, in half of the sky at least
    known = {key: limit for key, limit in limits.items() if key != RATE} | {"attitude_cross_arcsec": (1e9, False)}
    known |= {key: limits[key] for key in known.keys() & limits.keys()}
    rest = next((one for one in found if one is not None), None)
    borne, fails = 0.0, "at rest"
    if rest is not None:  # requirements that are missed at rest say nothing of motion
        lasting = {one.key: known[one.key] for one in _judged(rest, known) if one.met}
        borne, fails = _first_missed(at, lasting, 0.0, widest)
        if not math.isfinite(borne):
            borne, fails = widest, "window_px"
    period_s = config.timing.period_s(exposure_s)
    return Motion(
        **_values(found, "motion"),
        motion_trail_px=np.radians(rates) * exposure_s / np.radians(pixel_deg),
        slew_rate_deg_per_s=borne,
        slew_fails=fails,
        acceleration_deg_per_s2=(config.window_px // 2) * pixel_deg / period_s**2,
        acceleration_bias_s2=exposure_s**2 / 24.0,
        rate_deg_per_s=rates,
    )


def _rates(q: Quantities, found: Motion) -> None:
    q.axis("rate", found.rate_deg_per_s, "Slew rate", unit="deg/s", format=".3g")


MOTION = Section(
    record=Motion,
    axes=_rates,
    table="motion",
    columns="motion_trail_px motion_nea_arcsec motion_limiting_magnitude_mag motion_stars_mean_per_frame "
    "motion_attitude_cross_arcsec",
    caption="Performance against slew rate across the line of sight.",
    figures={
        "motion": curves(
            "rate",
            lines="motion_attitude_cross_arcsec motion_nea_arcsec",
            log="y",
            y="1σ",
            aspect_ratio=0.9,
            width="half",
        ),
    },
)


# --- Over life


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """The sensor against its age."""

    life_light: FloatArray = col("Light", "", ".3f", "age")
    life_dark_e: FloatArray = col("Dark charge", "e-", ".2f", "age")
    life_damaged_percent: FloatArray = col("Damaged pixels", "percent", ".2f", "age")
    life_nea_arcsec: FloatArray = col("NEA", "arcsec", ".3f", "age")
    life_limiting_magnitude_mag: FloatArray = col("Limiting magnitude", "mag", ".2f", "age")
    life_false_alarms_per_frame: FloatArray = col("False alarms per frame", "", ".3g", "age")
    life_stars_mean_per_frame: FloatArray = col("Stars per frame", "", ".1f", "age")
    life_attitude_cross_arcsec: FloatArray = col("Attitude across, median", "arcsec", ".3f", "age")
    life_attitude_roll_arcsec: FloatArray = col("Attitude roll, median", "arcsec", ".3f", "age", shown=False)
    life_missed: int = col("Requirements missed at the end of life")
    life_of: int = col("Requirements compared at the end of life")
    life_lasts_years: float = col("Age up to which all requirements are met", "yr", ".3g")
    life_fails: str = col("First failure with age")
    age_years: FloatArray


def over_life(prediction: CameraPrediction, limits: Limits) -> Life | None:
    """Prediction from the beginning to the end of life; None without a life."""
    config = prediction.config
    if not config.life.years:
        return None
    limits = {key: limit for key, limit in limits.items() if key != RATE}
    parts = np.linspace(0.0, 1.0, AGES)
    configs = [aged_config(config, float(part)) for part in parts]
    found = shared(_predicted, configs)
    last = found[-1]
    end = [] if last is None else _judged(last, limits)
    lasts, fails = math.inf, ""
    new = found[0]
    if new is not None and limits:
        held = _judged(new, limits)
        if missed := [one for one in held if not one.met]:
            lasts, fails = 0.0, min(missed, key=lambda one: one.excess).key
        elif held:
            lasts, fails = _first_missed(lambda part: aged_config(config, part), limits, 0.0, 1.0)
    chips = [overridden_detector(one) for one in configs]
    factor = chips[0].dark_factor(config.instrument.chip_temperature_c) * config.instrument.exposure_s
    dark = [one.dark_current_e_per_s + one.damage_centres_per_px * one.damage_dark_e_per_s for one in chips]
    return Life(
        **_values(found, "life", (*_NAMES, "false_alarms_per_frame")),
        life_light=np.array([aged_transmission(config.life, float(part)) for part in parts]),
        life_dark_e=factor * np.array(dark),
        life_damaged_percent=100.0 * -np.expm1(-np.array([one.damage_centres_per_px for one in chips])),
        life_missed=sum(not one.met for one in end) if end else len(limits),
        life_of=len(end) if end else len(limits),
        life_lasts_years=lasts * config.life.years,
        life_fails=fails,
        age_years=config.life.years * parts,
    )


def life_line(found: Life) -> str:
    """Line on the life for the terminal."""
    missed = f"{found.life_of - found.life_missed} of {found.life_of} met"
    if not found.life_of:
        missed = f"attitude {found.life_attitude_cross_arcsec[-1]:.3g}\u2033 across"
    fails = f"; first missed: {found.life_fails} after {found.life_lasts_years:.2g} years" if found.life_fails else ""
    return f"{'End of life':<19} {found.age_years[-1]:g} years: {missed}{fails}"


def _ages(q: Quantities, found: Life) -> None:
    q.axis("age", found.age_years, "Age", unit="yr", format=".2f")


LIFE = Section(
    record=Life,
    axes=_ages,
    table="life",
    caption="Performance from beginning to end of life.",
    figures={
        "life": curves(
            "age",
            lines="life_attitude_cross_arcsec life_nea_arcsec",
            y="1σ",
            aspect_ratio=0.9,
            width="half",
        ),
    },
)
