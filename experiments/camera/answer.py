"""The answer in the terminal: performance against requirements, and the most effective change.

Light to import: no figures, no renderer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.accuracy.ecss_metrics import mixture_bound
from experiments.camera.settings import CameraReportConfig
from experiments.harness.range import value_at, with_value
from experiments.harness.sections import col
from experiments.harness.system import shared
from experiments.harness.what_if import Requirement
from experiments.laboratory.sensor_prediction import CameraPrediction, predict_camera
from optics.arrays import FloatArray
from optics.errors import DomainError, StarbenchError
from render.sensor_file.instrument import stated_lens
from render.sensor_file.requirements import AT_LEAST


def limits(config: CameraReportConfig) -> dict[str, tuple[float, bool]]:
    """Requirements of the sensor file: key -> (value, whether at least)."""
    required = config.requirements.model_dump()
    return {key: (float(value), key in AT_LEAST) for key, value in required.items() if value is not None}


# --- Over temperature


@dataclass(frozen=True, slots=True, kw_only=True)
class Temperatures:
    """Lens and housing at a uniform temperature, the detector fixed."""

    focus_um: FloatArray = col("Best focus", "um", ".1f", "temperature")
    scale_ppm: FloatArray = col("Plate scale, change", "ppm", ".1f", "temperature")
    spot_px: FloatArray = col("RMS spot radius, largest", "px", ".3f", "temperature")
    lateral_colour_px: FloatArray = col("Lateral colour", "px", ".3f", "temperature")
    nea_arcsec: FloatArray = col("NEA", "arcsec", ".3f", "temperature")
    attitude_cross_arcsec: FloatArray = col("Attitude across, median", "arcsec", ".3f", "temperature")
    temperature_c: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalRange:
    """Extremes over the temperatures; NaN for a lens without thermal data."""

    focus_shift_um: float = col("Change of the best focus over temperature", "um", ".1f", default=math.nan)
    spot_thermal_px: float = col("Spot radius (RMS), largest over temperature", "px", ".3f", default=math.nan)
    scale_change_ppm: float = col("Change of the plate scale over temperature", "ppm", ".1f", default=math.nan)
    refusal: str = col("Reason for no answer", default="")


def temperatures(config: CameraReportConfig) -> tuple[Temperatures | None, ThermalRange]:
    """Predictions at all temperatures; None, and the reason, for a lens without thermal data."""
    setting, lens = config.thermal, stated_lens(config.instrument)
    temperature_c = np.linspace(setting.lowest_c, setting.highest_c, setting.points)

    def predicted(lens_c: float | None) -> tuple[float, Mapping[str, float]]:
        if lens_c == lens.environment.temperature_c:
            lens_c = None  # equal to the prediction without a stated temperature, which is cached
        prediction = predict_camera(with_value(config, "instrument.lens_temperature_c", lens_c))
        return prediction.state.performance.plate_scale_mm, prediction.numbers

    try:
        (reference_mm, _), *predictions = shared(predicted, (None, *map(float, temperature_c)))
    except DomainError as error:
        return None, ThermalRange(refusal=str(error).splitlines()[0])
    scale_mm = np.array([scale for scale, _ in predictions])

    def values(name: str) -> FloatArray:
        return np.array([numbers[name] for _, numbers in predictions])

    curves = Temperatures(
        focus_um=values("best_focus_um"),
        scale_ppm=1e6 * (scale_mm / reference_mm - 1.0),
        spot_px=values("spot_px"),
        lateral_colour_px=values("lateral_colour_px"),
        nea_arcsec=values("nea_arcsec"),
        attitude_cross_arcsec=values("attitude_cross_arcsec"),
        temperature_c=temperature_c,
    )
    return curves, ThermalRange(
        focus_shift_um=float(np.ptp(curves.focus_um)),
        spot_thermal_px=float(curves.spot_px.max()),
        scale_change_ppm=float(np.abs(curves.scale_ppm).max()),
    )


# --- Most effective design change


@dataclass(frozen=True, slots=True, kw_only=True)
class Swing:
    """Changes of the performance when a single key is lowered and raised: relative, of magnitudes the difference."""

    key: str = col("Key")
    low: float = col("From", format=".3g", shown=False)
    high: float = col("To", format=".3g", shown=False)
    unit: str = col("Unit", shown=False)
    attitude_cross_change: Sequence[float] = col("Change of attitude error", format="+.3f", dims="end")
    single_star_change: Sequence[float] = col("Single star", format="+.3f", dims="end", shown=False)
    limiting_magnitude_change_mag: Sequence[float] = col("Limiting magnitude", "mag", "+.2f", "end")
    stars_worst_change: Sequence[float] = col("Stars", format="+.3f", dims="end", shown=False)
    label: str  # Name of the setting in words
    best_value: float  # The value, low or high, with the smaller attitude error
    gain: float  # Relative decrease of the attitude error there; 0 if neither value lowers it

    @property
    def size(self) -> float:
        """Largest finite change of the attitude error."""
        return max((abs(change) for change in self.attitude_cross_change if math.isfinite(change)), default=0.0)


CHANGED = {
    "attitude_cross_change": "attitude_cross_arcsec",
    "single_star_change": "single_star_arcsec",
    "limiting_magnitude_change_mag": "limiting_magnitude_mag",
    "stars_worst_change": "stars_worst_per_frame",
}
"""Field of `Swing` -> predicted quantity."""
SWING_ATTITUDES = 150
"""Attitudes suffice for changes, which compare the same attitudes."""


def swings(
    config: CameraReportConfig, base: CameraPrediction, *, advance: Callable[[], None] = lambda: None
) -> list[Swing]:
    """Swings of all keys, sorted by possible gain, then by sensitivity."""
    fewer = config.sky.model_copy(update={"attitudes": min(SWING_ATTITUDES, config.sky.attitudes)})
    config = config.model_copy(update={"sky": fewer})
    nominal, rows = predict_camera(config), []
    advance()
    keys = parameters(config, base)

    def changes_at(case: tuple[str, float, float]) -> dict[str, float]:
        key, value, nominal_value = case
        return _changes(config, key, value, nominal) if value != nominal_value else dict.fromkeys(CHANGED, 0.0)

    cases = [(key, end, value) for key, _, _, low, value, high in keys for end in (low, high)]
    changes = shared(changes_at, cases, lambda case: advance())
    for (key, label, unit, low, _, high), *pair in zip(keys, changes[::2], changes[1::2], strict=True):
        columns = {field: [change[field] for change in pair] for field in CHANGED}
        attitude = np.nan_to_num(columns["attitude_cross_change"], nan=math.inf)
        best = int(np.argmin(attitude))
        gain = max(0.0, -float(attitude[best]))
        rows.append(
            Swing(
                key=key, label=label, low=low, high=high, unit=unit, best_value=(low, high)[best], gain=gain, **columns
            )
        )
    return sorted(rows, key=lambda swing: (-swing.gain, -swing.size))


def _changes(config: CameraReportConfig, key: str, value: float, nominal: CameraPrediction) -> dict[str, float]:
    """Changes from the nominal prediction; NaN where the setting is refused or the nominal value is not finite."""
    try:
        prediction = predict_camera(with_value(config, key, value))
    except (StarbenchError, ValueError):
        return dict.fromkeys(CHANGED, math.nan)
    changes = {}
    for field, name in CHANGED.items():
        new, old = prediction.value(name), nominal.value(name)
        relative = new / old - 1.0 if math.isfinite(old) and old else math.nan
        changes[field] = new - old if name.endswith("_mag") else relative
    return changes


def parameters(config: CameraReportConfig, base: CameraPrediction) -> list[tuple[str, str, str, float, float, float]]:
    """Key, label, unit, low, value, high."""
    change, chip = config.tornado, base.detector
    fraction, depth_mm = change.change_fraction, base.value("depth_of_focus_um") * 1e-3
    rows = []
    for key, label, unit, stated in (
        ("instrument.exposure_s", "exposure", "s", None),
        ("instrument.f_number", "F-number", "", base.value("f_number")),
        ("detector.read_noise_e", "read noise", "e⁻", chip.read_noise_e),
        ("detector.dark_current_e_per_s", "dark current", "e⁻/s", chip.dark_current_e_per_s),
        ("detector.prnu", "PRNU", "", chip.prnu),
        ("throughput_fraction", "throughput (QE, coatings)", "", None),
        ("background_e_per_s", "straylight", "e⁻/s", None),
        ("threshold_sigma", "detection limit", "σ", base.value("threshold_sigma")),
    ):
        value = float(value_at(config, key) if stated is None else stated)
        low, high = value * (1.0 - fraction), value * (1.0 + fraction)
        if key == "instrument.f_number":
            low = value  # the stop can be closed, not opened beyond the aperture of the lens
        if key == "throughput_fraction":
            high = min(high, 1.0)
        rows.append((key, label, unit, low, value, high))
    value, best_mm = value_at(config, "instrument.chip_temperature_c"), base.value("best_focus_um") * 1e-3
    rows.append(
        ("instrument.chip_temperature_c", "chip temperature", "°C", value - change.chip_k, value, value + change.chip_k)
    )
    value = value_at(config, "instrument.defocus_mm")
    ends = [value - depth_mm, value + depth_mm]
    if abs(best_mm) > depth_mm / 20.0:  # towards the best focus the change ends there
        ends[best_mm > 0.0] = value + best_mm
    rows.append(("instrument.defocus_mm", "defocus", "mm", ends[0], value, ends[1]))
    return [row for row in rows if row[3] < row[5] and row[0] in change.parameters]


# --- The answer


SECOND_LEVEL = 0.997
"""Level of the second attitude accuracy of the answer: fraction of the frames."""
VERDICT, ADVICE = "Requirements", "Change first"
"""Names of the lines that may need further predictions: verdict on the requirements, most effective change."""


def answer_rows(
    prediction: CameraPrediction, requirements: Sequence[Requirement], swings: Sequence[Swing]
) -> dict[str, str]:
    """Name -> line of at most 80 characters, apart from long names; the last two are `VERDICT` and `ADVICE`."""
    lens, star, sky = prediction.records
    state, config, forecast = prediction.state, prediction.config, prediction.attitude
    system, quoted = state.light.magnitude_system, config.star.magnitude_mag
    across = np.sqrt((forecast.total_arcsec[:, :2] ** 2).mean(axis=1))
    nea = f"{star.nea_arcsec:.3g}\u2033" if math.isfinite(star.nea_arcsec) else "none, the star saturates"
    scale = (
        f"{lens.pixel_arcsec:.3f}\u2033 per pixel, focal length {lens.focal_length_mm:.3f} mm at F/{lens.f_number:.3g}"
    )
    depths = lens.best_focus_um / lens.depth_of_focus_um
    best_mm = state.sensor.camera.defocus_mm + 1e-3 * lens.best_focus_um
    defocus = f"; defocus_mm = {best_mm:.4f}" if abs(depths) > 2.0 else ""
    advice = "; ".join(
        f"{swing.label} {swing.best_value:.3g} {swing.unit}".rstrip() + f": error −{100 * swing.gain:.0f} %"
        for swing in [swing for swing in swings if swing.gain > 0.0][:2]
    )
    rows = {
        "Sensor": config.name or f"{state.sensor.camera.lens.name} on {prediction.detector.name}",
        "Field": f"{lens.field_width_deg:.2f}° × {lens.field_height_deg:.2f}°, diagonal {lens.field_diagonal_deg:.2f}°",
        "Scale": scale,
        "Focus": f"best {round(lens.best_focus_um):+d} µm from the detector, "
        f"{abs(depths):.1f} depths of focus{defocus}",
        "Limiting magnitude": f"{system} = {sky.limiting_magnitude_mag:.2f} mag, half of the stars are detected",
        "NEA": f"{nea} for {system} = {quoted:g} mag, one axis, 1σ",
        "Stars per frame": f"{sky.stars_mean_per_frame:.1f}, worst 1 % of the sky {sky.stars_worst_per_frame:.1f}"
        + f"; catalogue to {prediction.view.depth_mag:.1f} mag" * prediction.catalogue_ends,
        "Attitude": _accuracies("1σ, median", sky.attitude_cross_arcsec, sky.attitude_roll_arcsec)
        + "; "
        + _accuracies(
            "99.7 %", mixture_bound(across, SECOND_LEVEL), mixture_bound(forecast.total_arcsec[:, 2], SECOND_LEVEL)
        ),
        VERDICT: _verdict(requirements),
        ADVICE: advice or "no key of [tornado] lowers the attitude error",
    }
    return {name: f"{name:<19} {text}" for name, text in rows.items()}


def _accuracies(level: str, across: float, roll: float) -> str:
    values = (f"{value:.3g}\u2033" if math.isfinite(value) else "too few stars" for value in (across, roll))
    return f"{level}: {' / '.join(values)}"


TEXT_WIDTH = 60
"""Characters of a line after its name."""


def _verdict(requirements: Sequence[Requirement]) -> str:
    if not requirements:
        return "none stated ([requirements] of the sensor file)"
    ordered = sorted(requirements, key=lambda requirement: requirement.excess)
    missed = [requirement for requirement in ordered if not requirement.met]
    text = f"{len(ordered) - len(missed)} of {len(ordered)} met; {'missed' if missed else 'least margin'}:"
    for number, requirement in enumerate((missed or ordered)[:3]):
        item = f"{',' * bool(number)} {requirement.key} {requirement.margin}"
        text += item if not number or len(text) + len(item) <= TEXT_WIDTH else ""
    return text
