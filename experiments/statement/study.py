"""Numbers of a performance statement: prediction of `camera`, thermal sensitivity of the lens, results of a flight."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calib.accuracy.ecss_metrics import mixture_bound, normal_factor, quantile_limit
from calib.attitude.attitude_covariance import attitude_of_velocity
from experiments.harness.progress import Progress
from experiments.harness.provenance import without_paths
from experiments.harness.registry import declared
from experiments.harness.run import Options, configuration
from experiments.harness.sections import single_numbers
from experiments.statement.clauses import CLAUSES
from optics.arrays import FloatArray
from optics.errors import ConfigError, StarbenchError
from optics.rays.thermal_sensitivity import ThermalSensitivity, thermal_sensitivity
from optics.settings import flat
from optics.units import RAD_ARCSEC
from render.sensor_file.instrument import build_instrument, housing_of

LEVELS = (0.683, 0.95, 0.997)
"""Confidence levels of the AME."""
OVER_TEMPERATURE = {"focus_shift_um", "spot_thermal_px", "scale_change_ppm"}
"""Requirements that need the sensor predicted at several temperatures."""
CONFIDENCE = 0.9
"""Confidence of a limit that is estimated from a sample of attitudes."""
ANALYSIS, RENDERED, INPUT = "analysis", "rendered simulation", "input"
"""Derivations of a number: method of verification, or a setting."""
EARTH_KM_PER_S = 29.7847
"""Mean orbital speed of the Earth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StatementLine:
    """A number with its metric, conditions and method."""

    clause: str  # Key of `CLAUSES`
    quantity: str
    value: str  # Number with its unit; cross-boresight / roll
    statistic: str
    conditions: str
    derivation: str = ANALYSIS


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """Content of the document."""

    name: str
    conditions: Sequence[tuple[str, str, str]]  # Condition, value, derivation
    errors: Sequence[StatementLine]
    detection: Sequence[StatementLine]
    requirements: Sequence[Any]
    unjudged: Sequence[str]
    flight: str
    notes: Sequence[str] = field(default_factory=tuple)
    ame_arcsec: tuple[float, float]  # AME at 95 %: cross-boresight, roll
    limiting_mag: float


Numbers = Callable[[str], float]
"""Prediction of the experiment camera by field."""


def _attitude_error(number: Numbers, name: str = "") -> tuple[float, float]:
    """A predicted attitude error across and about the boresight."""
    return number(f"attitude_cross{name}_arcsec"), number(f"attitude_roll{name}_arcsec")


def predict_statement(sensor: Sequence[str], settings: Sequence[str] = (), flight: str | None = None) -> Statement:
    """Predict the sensor of a file and collect its statement.

    Parameters
    ----------
    sensor : sequence of str
        The sensor file, or none for the built-in tracker.
    settings : sequence of str
        ``key=value`` of the configuration of `camera`.
    flight : str, optional
        Output folder of `flight`.
    """
    camera = declared("camera")
    config = configuration(camera, Options(sensor=tuple(sensor), settings=tuple(settings)))
    flown = None if flight is None else read_flight(Path(flight), config)
    outcome = camera.outcome(config, camera.part(camera.predict)(config, progress=Progress()))
    required = {key for key, value in config.requirements.model_dump().items() if value is not None}
    if required & OVER_TEMPERATURE:
        no_tornado = config.tornado.model_copy(update={"parameters": ()})
        config = config.model_copy(update={"tornado": no_tornado, "predict_only": True})
        outcome = camera.outcome(config, camera.part(camera.run)(config, progress=Progress()))
    numbers = single_numbers(outcome.data)

    def number(name: str) -> float:
        return float(numbers[name].values)

    setup = outcome.result["setup"]
    requirements = outcome.result["requirements"]
    thermal, reason = _sensitivity(config, number("field_diagonal_deg"))
    conditions = _conditions(config, number, setup)
    sampled_sky = f"sky, {config.sky.attitudes} attitudes"
    across, roll = (outcome.values(f"attitudes.{axis}_arcsec") for axis in ("cross", "roll"))
    errors = [
        *_attitude(number, across, roll, sampled_sky),
        *_terms(number, config, sampled_sky),
        *(() if thermal is None else _thermal(thermal, number)),
        _aberration(),
        *([] if flown is None else _flight(flown, Path(str(flight)).name)),
    ]
    return Statement(
        name=setup.name,
        conditions=conditions,
        errors=errors,
        detection=[
            *_detection(number, sampled_sky),
            *([] if flown is None else _availability(flown, Path(str(flight)).name)),
        ],
        requirements=requirements,
        unjudged=sorted(required - {requirement.key for requirement in requirements}),
        flight="" if flight is None else Path(flight).name,
        notes=[f"No thermo-elastic sensitivity: {reason}."] if reason else [],
        ame_arcsec=(mixture_bound(across, 0.95), mixture_bound(roll, 0.95)),
        limiting_mag=number("limiting_magnitude_mag"),
    )


def _sensitivity(config: Any, diagonal_deg: float) -> tuple[ThermalSensitivity | None, str]:
    """Derivatives by temperature of the focused lens over the detector, or why there are none."""
    try:
        lens = build_instrument(config.instrument).camera.focused_lens
        lens.check_glass()
        corner = min(0.5 * diagonal_deg, lens.max_field_deg)
        return thermal_sensitivity(lens, housing_of(config.instrument.housing), corner_deg=corner), ""
    except StarbenchError as error:
        return None, str(error).splitlines()[0]


def _conditions(config: Any, number: Numbers, setup: Any) -> list[tuple[str, str, str]]:
    instrument, star = config.instrument, config.star
    lens_c = instrument.lens_temperature_c
    return [
        ("Lens, detector", f"{setup.lens}, {setup.detector}", INPUT),
        ("Focal length, F-number", f"{number('focal_length_mm'):.3f} mm, {number('f_number'):.2f}", ANALYSIS),
        ("Exposure", f"{instrument.exposure_s:g} s", INPUT),
        ("Chip temperature", f"{instrument.chip_temperature_c:g} °C", INPUT),
        ("Lens temperature", "that of the prescription" if lens_c is None else f"{lens_c:g} °C", INPUT),
        ("Slew during an exposure", f"{config.slew.rate_deg_per_s:g} °/s", INPUT),
        ("Pass band", config.passband.words, INPUT),
        ("Even background", f"{config.background_e_per_s:g} e⁻/s in a pixel", INPUT),
        ("Centroid, detection", f"{config.centroid}, {config.window_px} px, {config.threshold_sigma:g} σ", INPUT),
        ("Stars", f"{config.catalogue.source}, epoch {config.catalogue.epoch_year:g}", INPUT),
        ("Sky", f"{config.sky.attitudes} attitudes, uniform over all rotations", INPUT),
        (
            "Quoted star",
            f"{star.magnitude_mag:g} mag ({setup.prediction.state.light.magnitude_system}), {star.temperature_k:g} K",
            INPUT,
        ),
        ("Life", "begin", INPUT),
    ]


def _arcsec(*values: float) -> str:
    """Across / about the boresight."""
    return " / ".join(map(_angle, values))


def _angle(value: float) -> str:
    if not math.isfinite(value):
        return "none"
    return "< 0.001″" if 0.0 < value < 1e-3 else f"{value:.3g}″"


def _percent(level: float) -> str:
    return f"{100.0 * level:.4g} %"


def _attitude(number: Numbers, across: FloatArray, roll: FloatArray, sampled_sky: str) -> Iterator[StatementLine]:
    axes = (across, roll)
    factor = normal_factor(0.997)
    worst = "attitude, worst 1 % of the sky"
    rows = [("attitude", [mixture_bound(a, p) for a in axes], f"AME, {_percent(p)}, mixed") for p in LEVELS]
    rows.append((worst, [factor * v for v in _attitude_error(number, "_worst")], "AME, 99.7 %, ensemble, normal error"))
    limits = [factor * quantile_limit(axis, 0.99, CONFIDENCE) for axis in axes]
    rows.append((worst, limits, f"the same, upper limit at {_percent(CONFIDENCE)} confidence"))
    for quantity, values, statistic in rows:
        yield StatementLine(
            clause="total", quantity=quantity, value=_arcsec(*values), statistic=statistic, conditions=sampled_sky
        )


def _terms(number: Numbers, config: Any, sampled_sky: str) -> Iterator[StatementLine]:
    factor = normal_factor(0.997)
    sigma = "99.7 %, normal error"
    star = f"star of {config.star.magnitude_mag:g} mag, mean over the detector"
    rows: list[tuple[str, str, Sequence[float], str, str]] = []
    for part, where in (("", "median of the sky"), ("_worst", "worst 1 % of the sky")):
        noise = _attitude_error(number, f"{part}_noise")
        total = _attitude_error(number, part)
        spatial = [math.sqrt(max(t * t - n * n, 0.0)) for t, n in zip(total, noise, strict=True)]
        quantity = f"attitude, {where}; with star colours (FOV spatial)"
        squares = f"{sampled_sky}; squares of quantiles subtracted"
        rows.append(("temporal_noise", f"attitude, {where}", noise, f"RME, {sigma}, ensemble", sampled_sky))
        rows.append(("pixel_spatial", quantity, spatial, f"{sigma}, ensemble", squares))
    for clause, quantity, parts in (
        ("temporal_noise", "noise-equivalent angle", ("nea",)),
        ("pixel_spatial", "pixel patterns and pixel phase", ("pattern", "phase")),
        ("fov_spatial", "star colours (distortion calibrated)", ("colour",)),
    ):
        size = math.hypot(*(number(f"{part}_arcsec") for part in parts))
        rows.append((clause, f"single star, {quantity}", (size,), sigma, star))
    for clause, quantity, values, statistic, conditions in rows:
        value = _arcsec(*(factor * v for v in values))
        yield StatementLine(clause=clause, quantity=quantity, value=value, statistic=statistic, conditions=conditions)


def _thermal(sensitivity: ThermalSensitivity, number: Numbers) -> Iterator[StatementLine]:
    corner = math.tan(math.radians(0.5 * number("field_diagonal_deg"))) * RAD_ARCSEC * 1e-6
    across, (uniform, axial) = math.hypot(*sensitivity.boresight_arcsec_per_k[2]), sensitivity.scale_ppm_per_k[:2]
    along = f"1 K from front to detector: {axial:+.3g} ppm"
    for quantity, value, where in (
        ("line of sight, lens against detector", f"{across:.3g}″/K", "1 K across the housing"),
        ("corner of the field, scale", f"{uniform * corner:+.3g}″/K", f"1 K, uniform: {uniform:+.3g} ppm"),
        ("corner of the field, scale", f"{axial * corner:+.3g}″/K", along),
        (
            "field, without shift, scale and roll",
            f"{sensitivity.distortion_arcsec_per_k[0]:.2g}″/K",
            "1 K, uniform; RMS",
        ),
        ("best focus", f"{sensitivity.focus_um_per_k[0]:+.3g} µm/K", "1 K, uniform"),
    ):
        yield StatementLine(
            clause="thermo_elastic", quantity=quantity, value=value, statistic="derivative", conditions=where
        )


def _aberration() -> StatementLine:
    return StatementLine(
        clause="aberration",
        quantity="uncorrected, orbit of the Earth about the Sun",
        value=_arcsec(RAD_ARCSEC * float(attitude_of_velocity([EARTH_KM_PER_S, 0.0, 0.0])[1])),
        statistic="largest",
        conditions="speed of 29.785 km/s across the line of sight",
    )


def _detection(number: Numbers, sampled_sky: str) -> Iterator[StatementLine]:
    half = " × ".join(f"±{0.5 * number(f'field_{side}_deg'):.2f}°" for side in ("width", "height"))
    limit, complete = (f"{number(f'{name}_magnitude_mag'):.2f} mag" for name in ("limiting", "complete"))
    mean, worst = (f"{number(f'stars_{name}_per_frame'):.1f}" for name in ("mean", "worst"))
    brightest, alarms = f"{number('saturation_mag'):.2f} mag", f"{number('false_alarms_per_frame'):.2g}"
    for clause, quantity, value, statistic in (
        ("field", "about the X and Y axes", half, ""),
        ("detection", "limiting magnitude", limit, "half of the stars detected"),
        ("detection", "limiting magnitude", complete, "90 % of the stars detected"),
        ("detection", "brightest star", brightest, "brightest pixel full on the axis"),
        ("detection", "stars in a frame", mean, "mean over the sky"),
        ("detection", "stars in a frame", worst, "1 % quantile of the sky"),
        ("false_star", "by noise, in a frame", alarms, "expectation"),
        ("bandwidth", "update rate", f"{number('update_rate_hz'):.3g} Hz", "exposures without a gap"),
    ):
        where = sampled_sky if "sky" in statistic else "one frame"
        yield StatementLine(clause=clause, quantity=quantity, value=value, statistic=statistic, conditions=where)


SENSOR_SETTINGS = ("instrument", "passband", "centroid", "window_px", "threshold_sigma")
"""Settings of the sensor, common to `camera` and `flight`."""


def read_flight(folder: Path, config: Any) -> Mapping[str, Any]:
    """Results of a flight of the same sensor, from its ``summary.json``."""
    path = folder / "summary.json"
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); --flight takes the folder of a run") from None
    except ValueError:
        raise ConfigError(f"{path}: is not a run's summary") from None
    if not isinstance(summary, dict) or summary.get("experiment") != "flight":
        name = summary.get("experiment") if isinstance(summary, dict) else None
        raise ConfigError(f"{path}: is of {name!r}; --flight takes the folder of a run of flight")
    stated = without_paths(config.model_dump(mode="json", include=set(SENSOR_SETTINGS)))
    flown = flat({key: value for key, value in summary.get("config", {}).items() if key in SENSOR_SETTINGS})
    for key, value in flat(stated).items():
        if key in flown and flown[key] != value:
            raise ConfigError(
                f"{path}: is from another sensor: {key} = {flown[key]!r} there, {value!r} here; run flight with this "
                "sensor file"
            )
    results: Mapping[str, Any] = summary.get("results", {})
    return results


def _field(results: Mapping[str, Any], name: str, part: str = "value") -> Any:
    """Value or uncertainty of SECTION.FIELD in the results of a summary; None where they lack it."""
    section, _, field = name.partition(".")
    return results.get(section, {}).get(field, {}).get(part)


def _components(values: Mapping[str, float | None] | None) -> list[float]:
    """Across and about the boresight; NaN for a missing number."""
    return [math.nan if value is None else value for value in (values or {}).values()]


def _flight(results: Mapping[str, Any], folder: str) -> Iterator[StatementLine]:
    where, quantity = f"orbit of the flight {folder}", "attitude over the flight"
    for name, derivation in (("terms.measured_arcsec", RENDERED), ("terms.predicted_arcsec", ANALYSIS)):
        errors = _field(results, name, "uncertainty") or {}
        for term, components in (_field(results, name) or {}).items():
            values, sigma = _components(components), _components(errors.get(term))
            if term in CLAUSES and any(map(math.isfinite, values)):
                yield StatementLine(
                    clause=term,
                    quantity=quantity,
                    value=_arcsec(*values),
                    statistic=f"RMS ± {_arcsec(*sigma)} (1σ)" if any(map(math.isfinite, sigma)) else "RMS",
                    conditions=where,
                    derivation=derivation,
                )
    totals, dark_e = (_field(results, f"ageing.{name}") or () for name in ("total_arcsec", "dark_e"))
    for age, total, dark in zip(("begin of life", "end of life"), totals, dark_e, strict=False):
        yield StatementLine(
            clause="total",
            quantity=f"{quantity}, {age}",
            value=_arcsec(*_components(total)),
            statistic="RMS, all terms",
            conditions=f"{where}; {dark:.3g} e⁻ of dark charge in a pixel",
        )


def _availability(results: Mapping[str, Any], folder: str) -> Iterator[StatementLine]:
    for clause, name, quantity, unit, derivation in (
        ("tracking", "available_percent", "availability over the orbit", " %", ANALYSIS),
        ("tracking", "solved_percent", "frames with an attitude, of those not blinded", " %", RENDERED),
        ("acquisition", "acquired_fraction", "successful acquisitions", "", RENDERED),
        (
            "acquisition",
            "acquired_lower_limit",
            "successful acquisitions, lower limit at 90 % confidence",
            "",
            RENDERED,
        ),
        ("acquisition", "wrong_attitudes", "wrong attitudes", "", RENDERED),
    ):
        value = _field(results, f"mission.{name}")
        if value is not None:
            yield StatementLine(
                clause=clause,
                quantity=quantity,
                value=f"{value:.4g}{unit}",
                statistic="Clopper and Pearson" if name == "acquired_lower_limit" else "mean",
                conditions=f"orbit of the flight {folder}",
                derivation=derivation,
            )
