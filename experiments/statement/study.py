"""Numbers of a performance statement: from the prediction of `camera`, the lens, and optionally a flight."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calib.accuracy.ecss_metrics import mixture_bound, normal_factor, quantile_limit
from calib.attitude.attitude_covariance import attitude_of_velocity
from experiments.harness.progress import Progress
from experiments.harness.provenance import without_paths
from experiments.harness.quantities import Outcome
from experiments.harness.registry import declared
from experiments.harness.run import Options, configuration
from experiments.statement.clauses import CLAUSES
from optics.arrays import FloatArray
from optics.errors import ConfigError, StarbenchError
from optics.rays.thermal_sensitivity import ThermalSensitivity, thermal_sensitivity
from optics.settings import flat
from optics.units import RAD_ARCSEC
from render.sensor_file.instrument import build_instrument, housing_of

LEVELS = (0.683, 0.95, 0.997)
OVER_TEMPERATURE = {"focus_shift_um", "spot_thermal_px", "scale_change_ppm"}
"""Requirements that need the sensor predicted at several temperatures."""
CONFIDENCE = 0.9
"""Of a limit that a sample of the sky tells."""
ANALYSIS, RENDERED, INPUT = "analysis", "rendered simulation", "input"
EARTH_KM_PER_S = 29.7847
"""Mean orbital speed of the Earth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A number with its metric, conditions and method."""

    clause: str  # Key of `CLAUSES`
    what: str
    value: str  # With its unit; across the boresight / about it
    statistic: str
    conditions: str
    derivation: str = ANALYSIS


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """Content of the document."""

    name: str
    conditions: Sequence[tuple[str, str, str]]  # What, value, derivation
    errors: Sequence[Line]
    detection: Sequence[Line]
    requirements: Sequence[Any]
    unjudged: Sequence[str]
    flight: str
    notes: Sequence[str] = field(default_factory=tuple)
    ame_arcsec: tuple[float, float]  # At 95 %, across and about the boresight
    limiting_mag: float


class _Numbers:
    """Numbers of the prediction by name."""

    def __init__(self, outcome: Outcome) -> None:
        self.outcome = outcome

    def __call__(self, name: str) -> float:
        return float(self.outcome.values(name))

    def pair(self, name: str) -> tuple[float, float]:
        """A number across and about the boresight."""
        return self(f"attitude_cross{name}_arcsec"), self(f"attitude_roll{name}_arcsec")


def statement(sensor: Sequence[str], settings: Sequence[str] = (), flight: str | None = None) -> Statement:
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
    told = None if flight is None else read_flight(Path(flight), config)
    outcome = camera.outcome(config, camera.part(camera.predict)(config, progress=Progress()))
    asked = {key for key, value in config.requirements.model_dump().items() if value is not None}
    if asked & OVER_TEMPERATURE:
        shorter = config.tornado.model_copy(update={"parameters": ()})
        config = config.model_copy(update={"tornado": shorter, "predict_only": True})
        outcome = camera.outcome(config, camera.part(camera.run)(config, progress=Progress()))
    number = _Numbers(outcome)
    setup, judged = outcome.result["setup"], outcome.result["requirements"]
    thermal, refusal = _sensitivity(config, number("field_diagonal_deg"))
    conditions = _conditions(config, number, setup)
    at = f"sky, {config.sky.attitudes} attitudes"
    across, roll = (outcome.values(f"sky_{axis}_arcsec") for axis in ("cross", "roll"))
    errors = [
        *_attitude(number, across, roll, at),
        *_terms(number, config, at),
        *(() if thermal is None else _thermal(thermal, number)),
        _aberration(),
        *([] if told is None else _flight(told, Path(str(flight)).name)),
    ]
    return Statement(
        name=setup.name,
        conditions=conditions,
        errors=errors,
        detection=[
            *_detection(number, at),
            *([] if told is None else _availability(told, Path(str(flight)).name)),
        ],
        requirements=judged,
        unjudged=sorted(asked - {one.key for one in judged}),
        flight="" if flight is None else Path(flight).name,
        notes=[f"No thermo-elastic sensitivity: {refusal}."] if refusal else [],
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


def _conditions(config: Any, number: _Numbers, setup: Any) -> list[tuple[str, str, str]]:
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


def _attitude(number: _Numbers, across: FloatArray, roll: FloatArray, at: str) -> Iterator[Line]:
    axes, factor, worst = (across, roll), normal_factor(0.997), "attitude, worst 1 % of the sky"
    rows = [("attitude", [mixture_bound(a, p) for a in axes], f"AME, {_percent(p)}, mixed") for p in LEVELS]
    rows.append((worst, [factor * v for v in number.pair("_worst")], "AME, 99.7 %, ensemble, normal error"))
    limits = [factor * quantile_limit(axis, 0.99, CONFIDENCE) for axis in axes]
    rows.append((worst, limits, f"the same, upper limit at {_percent(CONFIDENCE)} confidence"))
    for what, values, statistic in rows:
        yield Line(clause="total", what=what, value=_arcsec(*values), statistic=statistic, conditions=at)


def _terms(number: _Numbers, config: Any, at: str) -> Iterator[Line]:
    factor, sigma = normal_factor(0.997), "99.7 %, normal error"
    star = f"star of {config.star.magnitude_mag:g} mag, mean over the detector"
    rows: list[tuple[str, str, Sequence[float], str, str]] = []
    for part, where in (("", "median of the sky"), ("_worst", "worst 1 % of the sky")):
        noise, total = number.pair(f"{part}_noise"), number.pair(part)
        spatial = [math.sqrt(max(t * t - n * n, 0.0)) for t, n in zip(total, noise, strict=True)]
        what, squares = f"attitude, {where}; with star colours (FOV spatial)", f"{at}; squares of quantiles subtracted"
        rows.append(("temporal_noise", f"attitude, {where}", noise, f"RME, {sigma}, ensemble", at))
        rows.append(("pixel_spatial", what, spatial, f"{sigma}, ensemble", squares))
    for clause, what, parts in (
        ("temporal_noise", "noise-equivalent angle", ("nea",)),
        ("pixel_spatial", "pixel patterns and pixel phase", ("pattern", "phase")),
        ("fov_spatial", "star colours (distortion calibrated)", ("colour",)),
    ):
        size = math.hypot(*(number(f"{part}_arcsec") for part in parts))
        rows.append((clause, f"single star, {what}", (size,), sigma, star))
    for clause, what, values, statistic, conditions in rows:
        value = _arcsec(*(factor * v for v in values))
        yield Line(clause=clause, what=what, value=value, statistic=statistic, conditions=conditions)


def _thermal(found: ThermalSensitivity, number: _Numbers) -> Iterator[Line]:
    corner = math.tan(math.radians(0.5 * number("field_diagonal_deg"))) * RAD_ARCSEC * 1e-6
    across, (uniform, axial) = math.hypot(*found.boresight_arcsec_per_k[2]), found.scale_ppm_per_k[:2]
    along = f"1 K from front to detector: {axial:+.3g} ppm"
    for what, value, where in (
        ("line of sight, lens against detector", f"{across:.3g}″/K", "1 K across the housing"),
        ("corner of the field, scale", f"{uniform * corner:+.3g}″/K", f"1 K, uniform: {uniform:+.3g} ppm"),
        ("corner of the field, scale", f"{axial * corner:+.3g}″/K", along),
        ("field, without shift, scale and roll", f"{found.distortion_arcsec_per_k[0]:.2g}″/K", "1 K, uniform; RMS"),
        ("best focus", f"{found.focus_um_per_k[0]:+.3g} µm/K", "1 K, uniform"),
    ):
        yield Line(clause="thermo_elastic", what=what, value=value, statistic="derivative", conditions=where)


def _aberration() -> Line:
    return Line(
        clause="aberration",
        what="uncorrected, orbit of the Earth about the Sun",
        value=_arcsec(RAD_ARCSEC * float(attitude_of_velocity([EARTH_KM_PER_S, 0.0, 0.0])[1])),
        statistic="largest",
        conditions="speed of 29.785 km/s across the line of sight",
    )


def _detection(number: _Numbers, at: str) -> Iterator[Line]:
    half = " × ".join(f"±{0.5 * number(f'field_{side}_deg'):.2f}°" for side in ("width", "height"))
    limit, complete = (f"{number(f'{name}_magnitude_mag'):.2f} mag" for name in ("limiting", "complete"))
    mean, worst = (f"{number(f'stars_{name}_per_frame'):.1f}" for name in ("mean", "worst"))
    brightest, alarms = f"{number('saturation_mag'):.2f} mag", f"{number('false_alarms_per_frame'):.2g}"
    for clause, what, value, statistic in (
        ("field", "about the X and Y axes", half, ""),
        ("detection", "limiting magnitude", limit, "half of the stars detected"),
        ("detection", "limiting magnitude", complete, "90 % of the stars detected"),
        ("detection", "brightest star", brightest, "brightest pixel full on the axis"),
        ("detection", "stars in a frame", mean, "mean over the sky"),
        ("detection", "stars in a frame", worst, "1 % quantile of the sky"),
        ("false_star", "by noise, in a frame", alarms, "expectation"),
        ("bandwidth", "update rate", f"{number('update_rate_hz'):.3g} Hz", "exposures without a gap"),
    ):
        where = at if "sky" in statistic else "one frame"
        yield Line(clause=clause, what=what, value=value, statistic=statistic, conditions=where)


SAME = ("instrument", "passband", "centroid", "window_px", "threshold_sigma")
"""Settings that make a sensor, in `camera` and `flight` alike."""


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
    own = without_paths(config.model_dump(mode="json", include=set(SAME)))
    flown = flat({key: value for key, value in summary.get("config", {}).items() if key in SAME})
    for key, value in flat(own).items():
        if key in flown and flown[key] != value:
            raise ConfigError(
                f"{path}: is from another sensor: {key} = {flown[key]!r} there, {value!r} here; run flight with this "
                "sensor file"
            )
    results: Mapping[str, Any] = summary.get("results", {})
    return results


def _number(value: Any, key: str = "value") -> float:
    """A number, plain or with its uncertainty (``key``); NaN where there is none."""
    value = value.get(key) if isinstance(value, dict) else value if key == "value" else None
    return float(value) if isinstance(value, int | float) else math.nan


def _pair(value: Any, key: str = "value") -> list[float]:
    """Numbers across and about the boresight."""
    return [_number(part, key) for part in (value.values() if isinstance(value, dict) else value or ())]


def _flight(results: Mapping[str, Any], folder: str) -> Iterator[Line]:
    where, what = f"orbit of the flight {folder}", "attitude over the flight"
    for name, term in results.get("terms", {}).items():
        for key, derivation in (("measured_arcsec", RENDERED), ("predicted_arcsec", ANALYSIS)):
            values, spread = _pair(term.get(key)), _pair(term.get(key), "uncertainty")
            if name in CLAUSES and any(map(math.isfinite, values)):
                rms = f"RMS ± {_arcsec(*spread)} (1σ)" if any(map(math.isfinite, spread)) else "RMS"
                value = _arcsec(*values)
                yield Line(clause=name, what=what, value=value, statistic=rms, conditions=where, derivation=derivation)
    for life, age in zip(("begin of life", "end of life"), results.get("lives", ()), strict=False):
        yield Line(
            clause="total",
            what=f"{what}, {life}",
            value=_arcsec(*_pair(age.get("total_arcsec"))),
            statistic="RMS, all terms",
            conditions=f"{where}; {_number(age.get('dark_e')):.3g} e⁻ of dark charge in a pixel",
        )


def _availability(results: Mapping[str, Any], folder: str) -> Iterator[Line]:
    where = f"orbit of the flight {folder}"
    for clause, key, what, unit, derivation in (
        ("tracking", "available_percent", "availability over the orbit", " %", ANALYSIS),
        ("tracking", "solved_percent", "frames with an attitude, of those not blinded", " %", RENDERED),
        ("acquisition", "acquired", "successful acquisitions", "", RENDERED),
        ("acquisition", "acquired_least", "successful acquisitions, lower limit at 90 % confidence", "", RENDERED),
        ("acquisition", "wrong_attitudes", "wrong attitudes", "", RENDERED),
    ):
        value = _number(results.get(key))
        statistic = "mean" if key != "acquired_least" else "Clopper and Pearson"
        if math.isfinite(value):
            text = f"{value:.4g}{unit}"
            yield Line(
                clause=clause, what=what, value=text, statistic=statistic, conditions=where, derivation=derivation
            )
