"""The answer in the terminal: performance against requirements, and the most effective change.

Light to import: no figures, no renderer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.accuracy.ecss_metrics import mixture_bound
from experiments.camera.settings import Config
from experiments.harness.range import value_at, with_value
from experiments.harness.sections import col
from experiments.harness.system import shared
from experiments.harness.what_if import Requirement
from experiments.laboratory.sensor_prediction import CameraPrediction, predict_camera
from optics.arrays import FloatArray
from optics.errors import DomainError, StarbenchError
from render.sensor_file.instrument import stated_lens
from render.sensor_file.requirements import AT_LEAST


def limits(config: Config) -> dict[str, tuple[float, bool]]:
    """Requirements of the sensor file: number -> (value, whether at least)."""
    required = config.requirements.model_dump()
    return {key: (float(value), key in AT_LEAST) for key, value in required.items() if value is not None}


# --- From the coldest to the hottest


@dataclass(frozen=True, slots=True, kw_only=True)
class Temperatures:
    """Lens and housing at one temperature, the detector where the focus was set."""

    thermal_focus_um: FloatArray = col("Best focus", "um", ".1f", "temperature")
    thermal_scale_ppm: FloatArray = col("Plate scale, change", "ppm", ".1f", "temperature")
    thermal_spot_px: FloatArray = col("RMS spot radius, largest", "px", ".3f", "temperature")
    thermal_colour_px: FloatArray = col("Lateral colour", "px", ".3f", "temperature")
    thermal_nea_arcsec: FloatArray = col("NEA", "arcsec", ".3f", "temperature")
    thermal_attitude_arcsec: FloatArray = col("Attitude across, median", "arcsec", ".3f", "temperature")
    temperature_c: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalRange:
    """Largest changes over the temperatures; NaN for a lens without thermal data."""

    focus_shift_um: float = col("Change of the best focus over temperature", "um", ".1f", default=math.nan)
    spot_thermal_px: float = col("Spot radius (RMS), largest over temperature", "px", ".3f", default=math.nan)
    scale_change_ppm: float = col("Change of the plate scale over temperature", "ppm", ".1f", default=math.nan)
    refusal: str = col("Reason for no answer", default="")


def temperatures(config: Config) -> tuple[Temperatures | None, ThermalRange]:
    """The sensor predicted at all temperatures; None, and the reason, for a lens without thermal data."""
    setting, lens = config.thermal, stated_lens(config.instrument)
    at_c = np.linspace(setting.lowest_c, setting.highest_c, setting.points)

    def at(temperature_c: float | None) -> tuple[float, Mapping[str, float]]:
        if temperature_c == lens.environment.temperature_c:
            temperature_c = None  # as it is without a temperature, which is known already
        found = predict_camera(with_value(config, "instrument.lens_temperature_c", temperature_c))
        return found.state.performance.plate_scale_mm, found.numbers

    try:
        (reference_mm, _), *found = shared(at, (None, *map(float, at_c)))
    except DomainError as error:
        return None, ThermalRange(refusal=str(error).splitlines()[0])
    scale_mm = np.array([scale for scale, _ in found])

    def values(name: str) -> FloatArray:
        return np.array([numbers[name] for _, numbers in found])

    over = Temperatures(
        thermal_focus_um=values("best_focus_um"),
        thermal_scale_ppm=1e6 * (scale_mm / reference_mm - 1.0),
        thermal_spot_px=values("spot_px"),
        thermal_colour_px=values("lateral_colour_px"),
        thermal_nea_arcsec=values("nea_arcsec"),
        thermal_attitude_arcsec=values("attitude_cross_arcsec"),
        temperature_c=at_c,
    )
    return over, ThermalRange(
        focus_shift_um=float(np.ptp(over.thermal_focus_um)),
        spot_thermal_px=float(over.thermal_spot_px.max()),
        scale_change_ppm=float(np.abs(over.thermal_scale_ppm).max()),
    )


# --- Most effective design change


@dataclass(frozen=True, slots=True, kw_only=True)
class Swing:
    """One key moved down and up, the others unchanged: relative changes, for magnitudes the difference."""

    key: str = col("Key")
    low: float = col("From", format=".3g", shown=False)
    high: float = col("To", format=".3g", shown=False)
    unit: str = col("Unit", shown=False)
    swing_attitude_cross_arcsec: Sequence[float] = col("Change of attitude error", format="+.3f", dims="end")
    swing_single_star_arcsec: Sequence[float] = col("Single star", format="+.3f", dims="end", shown=False)
    swing_limiting_magnitude_mag: Sequence[float] = col("Limiting magnitude", "mag", "+.2f", "end")
    swing_stars_worst_per_frame: Sequence[float] = col("Stars", format="+.3f", dims="end", shown=False)
    label: str  # Of the key

    better: float  # Value at which the attitude error is least
    gain: float  # Relative decrease of the attitude error there, 0 if no value that was tried lowers it

    @property
    def size(self) -> float:
        """Largest known change of the attitude error."""
        return max((abs(one) for one in self.swing_attitude_cross_arcsec if math.isfinite(one)), default=0.0)


CHANGED = ("attitude_cross_arcsec", "single_star_arcsec", "limiting_magnitude_mag", "stars_worst_per_frame")
FEW_ATTITUDES = 150
"""Differences of the same attitudes are known from fewer of them."""


def swings(config: Config, base: CameraPrediction, *, advance: Callable[[], None] = lambda: None) -> list[Swing]:
    """Swings of all keys, sorted by possible gain, then by sensitivity."""
    fewer = config.sky.model_copy(update={"attitudes": min(FEW_ATTITUDES, config.sky.attitudes)})
    config = config.model_copy(update={"sky": fewer})
    middle, rows = predict_camera(config), []
    advance()
    keys = parameters(config, base)

    def end(case: tuple[str, float, float]) -> dict[str, float]:
        key, at, value = case
        return _changes(config, key, at, middle) if at != value else dict.fromkeys(CHANGED, 0.0)

    cases = [(key, at, value) for key, _, _, low, value, high in keys for at in (low, high)]
    ends = shared(end, cases, lambda case: advance())
    for (key, label, unit, low, _, high), *pair in zip(keys, ends[::2], ends[1::2], strict=True):
        moved = {f"swing_{name}": [one[name] for one in pair] for name in CHANGED}
        attitude = np.nan_to_num([one[CHANGED[0]] for one in pair], nan=math.inf)
        least = int(np.argmin(attitude))
        gain = max(0.0, -float(attitude[least]))
        rows.append(
            Swing(key=key, label=label, low=low, high=high, unit=unit, better=(low, high)[least], gain=gain, **moved)
        )
    return sorted(rows, key=lambda one: (-one.gain, -one.size))


def _changes(config: Config, key: str, value: float, middle: CameraPrediction) -> dict[str, float]:
    """NaN where the setting is refused, or nothing is known to change."""
    try:
        found = predict_camera(with_value(config, key, value))
    except (StarbenchError, ValueError):
        return dict.fromkeys(CHANGED, math.nan)
    changes = {}
    for name in CHANGED:
        new, old = found.value(name), middle.value(name)
        relative = new / old - 1.0 if math.isfinite(old) and old else math.nan
        changes[name] = new - old if name.endswith("_mag") else relative
    return changes


def parameters(config: Config, base: CameraPrediction) -> list[tuple[str, str, str, float, float, float]]:
    """Key, label, unit, low, value, high."""
    change, chip = config.tornado, base.detector
    share, depth_mm = change.change_fraction, base.value("depth_of_focus_um") * 1e-3
    rows = []
    for key, label, unit, own in (
        ("instrument.exposure_s", "exposure", "s", None),
        ("instrument.f_number", "F-number", "", base.value("f_number")),
        ("detector.read_noise_e", "read noise", "e⁻", chip.read_noise_e),
        ("detector.dark_current_e_per_s", "dark current", "e⁻/s", chip.dark_current_e_per_s),
        ("detector.prnu", "PRNU", "", chip.prnu),
        ("throughput_fraction", "throughput (QE, coatings)", "", None),
        ("background_e_per_s", "straylight", "e⁻/s", None),
        ("threshold_sigma", "detection limit", "σ", base.value("threshold_sigma")),
    ):
        value = float(value_at(config, key) if own is None else own)
        low, high = value * (1.0 - share), value * (1.0 + share)
        if key == "instrument.f_number":
            low = value  # a stop can be closed, not opened beyond what the lens has
        if key == "throughput_fraction":
            high = min(high, 1.0)
        rows.append((key, label, unit, low, value, high))
    value, best_mm = value_at(config, "instrument.chip_temperature_c"), base.value("best_focus_um") * 1e-3
    rows.append(
        ("instrument.chip_temperature_c", "chip temperature", "°C", value - change.chip_k, value, value + change.chip_k)
    )
    value = value_at(config, "instrument.defocus_mm")
    ends = [value - depth_mm, value + depth_mm]
    if abs(best_mm) > depth_mm / 20.0:  # towards the best focus there is no more to gain than to reach it
        ends[best_mm > 0.0] = value + best_mm
    rows.append(("instrument.defocus_mm", "defocus", "mm", ends[0], value, ends[1]))
    return [row for row in rows if row[3] < row[5] and row[0] in change.parameters]


# --- The answer


USUAL = 0.997
"""Share of all frames that the second accuracy of the answer holds for."""


def answer_lines(
    prediction: CameraPrediction, requirements: Sequence[Requirement], found: Sequence[Swing]
) -> list[str]:
    """The answer in ten lines of at most 80 characters, but for names."""
    lens, star, seen = prediction.records
    state, config, forecast = prediction.state, prediction.config, prediction.attitude
    system, quoted = state.light.magnitude_system, config.star.magnitude_mag
    across = np.sqrt((forecast.total_arcsec[:, :2] ** 2).mean(axis=1))
    nea = f"{star.nea_arcsec:.3g}\u2033" if math.isfinite(star.nea_arcsec) else "none, the star saturates"
    scale = (
        f"{lens.pixel_arcsec:.3f}\u2033 per pixel, focal length {lens.focal_length_mm:.3f} mm at F/{lens.f_number:.3g}"
    )
    depths = lens.best_focus_um / lens.depth_of_focus_um
    best_mm = state.sensor.camera.defocus_mm + 1e-3 * lens.best_focus_um
    put = f"; defocus_mm = {best_mm:.4f}" if abs(depths) > 2.0 else ""
    kept = [one for one in found if one.gain > 0.0][:2]
    first = "; ".join(
        f"{one.label} {one.better:.3g} {one.unit}".rstrip() + f": error −{100 * one.gain:.0f} %" for one in kept
    )
    rows = {
        "Sensor": config.name or f"{state.sensor.camera.lens.name} on {prediction.detector.name}",
        "Field": f"{lens.field_width_deg:.2f}° × {lens.field_height_deg:.2f}°, diagonal {lens.field_diagonal_deg:.2f}°",
        "Scale": scale,
        "Focus": f"best {round(lens.best_focus_um):+d} µm from the detector, {abs(depths):.1f} depths of focus{put}",
        "Limiting magnitude": f"{system} = {seen.limiting_magnitude_mag:.2f} mag, half of the stars are detected",
        "NEA": f"{nea} for {system} = {quoted:g} mag, one axis, 1σ",
        "Stars per frame": f"{seen.stars_mean_per_frame:.1f}, worst 1 % of the sky {seen.stars_worst_per_frame:.1f}"
        + f"; catalogue to {prediction.view.depth_mag:.1f} mag" * prediction.catalogue_ends,
        "Attitude": _two("1σ, median", seen.attitude_cross_arcsec, seen.attitude_roll_arcsec)
        + "; "
        + _two("99.7 %", mixture_bound(across, USUAL), mixture_bound(forecast.total_arcsec[:, 2], USUAL)),
        "Requirements": _verdict(requirements),
        "Change first": first or "no key of [tornado] lowers the attitude error",
    }
    return [f"{name:<19} {words}" for name, words in rows.items()]


def _two(which: str, across: float, roll: float) -> str:
    words = (f"{one:.3g}\u2033" if math.isfinite(one) else "too few stars" for one in (across, roll))
    return f"{which}: {' / '.join(words)}"


ROOM = 60
"""Characters of a line behind its name."""


def _verdict(requirements: Sequence[Requirement]) -> str:
    if not requirements:
        return "none stated ([requirements] of the sensor file)"
    tight = sorted(requirements, key=lambda one: one.excess)
    missed = [one for one in tight if not one.met]
    words = f"{len(tight) - len(missed)} of {len(tight)} met; {'missed' if missed else 'least margin'}:"
    for number, one in enumerate((missed or tight)[:3]):
        more = f"{',' * bool(number)} {one.key} {one.margin}"
        words += more if not number or len(words) + len(more) <= ROOM else ""
    return words
