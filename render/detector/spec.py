"""Detector specification: an EMVA 1288 description of one chip, and the number of chips side by side.

Names and definitions follow EMVA Standard 1288, release 4.0 linear: system gain K [DN/e-], PRNU_1288 and DSNU_1288 as
spatial standard deviations, full well as saturation capacity. `render.detector.readout` says in which order they act.
Data files are TOML, lengths in um; the record is in mm.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from optics.errors import ConfigError, DomainError, unknown_name
from optics.light.band_file import load_band
from optics.response import Response
from optics.textfile import read_text, two_columns
from optics.units import UM_MM
from optics.validate import MOST_MISSING, parse_model, read_toml
from render.detector.dark_current import dark_current_ratio, tabulated_dark_current
from render.detector.nonlinearity import falling_from

_DATA = Path(__file__).parents[1] / "data" / "detectors"
_HIGHEST = 1e7
LEAST_PEAK = 0.01
"""No detector has less: fractions in a column of percents."""
OFFSET_SIGMA = 10.0
"""Offset where a file gives none, in the read noise: no pixel is cut off at zero."""
UNSTATED = frozenset({"base", "assumed", "chips", "gap_px", "sensor_seed", "dark_current"})
"""Keys whose default is no statement about the chip; radiation damage is none either."""
_LENGTHS = {"pixel_pitch_um": "pixel_pitch_mm", "diffusion_sigma_um": "diffusion_sigma_mm"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Detector:
    """One detector.

    Attributes
    ----------
    name, source : str
        What it is and where its numbers come from.
    chip_width_px, chip_height_px, chips, gap_px : int
        Size of one chip [px]; chips side by side along a row (ACC18: 2) and dead columns between them: whole pixels of
        insensitive mosaic, part of the image, flagged.
    pixel_pitch_mm, diffusion_sigma_mm : float
        Pixel pitch; charge diffusion as the standard deviation of a Gaussian [mm].
    quantum_efficiency : Response
        Interacting quantum efficiency over wavelength, fill factor included.
    prnu : float
        PRNU_1288: spatial standard deviation of the response over its mean.
    dark_current_e_per_s, dark_spread_e_per_s : float
        Mean dark current of the normal pixels and its spatial standard deviation (log-normal) at the reference [e-/s].
    dark_reference_c, dark_doubling_c : float
        Dark current doubles with every ``dark_doubling_c`` kelvin above the reference [C].
    hot_fraction, hot_dark_e_per_s : float
        Fraction of hot pixels, and the mean of their exponentially distributed additional dark current [e-/s].
    dead_fraction : float
        Fraction of pixels without response.
    full_well_e, blooming : float
        Saturation capacity [e-]; fraction of the charge above it that blooms along its column, 0: all is drained.
    crosstalk_horizontal, crosstalk_vertical, crosstalk_diagonal : float
        Fraction of a pixel's charge that appears in *each* left/right, upper/lower, diagonal neighbour.
    read_noise_e, read_noise_spread : float
        Median over the pixels of the temporal dark noise [e-]; standard deviation of its natural logarithm.
    gain_dn_per_e, nonlinearity : float, tuple of float
        System gain K at small signals [DN/e-]; c_1, c_2 ... in DN = K x (1 + sum_i c_i (x / full_well)^i), x in
        electrons, which must rise up to the full well.
    offset_dn, dsnu_e, column_pattern_e : float
        Mean offset [DN]; its spatial standard deviation per pixel (DSNU_1288 at zero exposure) and per column [e-].
    adc_bits, sensor_seed : int
        Resolution of the converter; seed of the individual detector: hot pixels and fixed patterns.
    lag : float
        Fraction of a frame's charge that is read with the next frame.
    transfer_line_us : float
        Time per row of a frame transfer under light [us]; 0: a shutter, or a detector that does not shift its image.
    damage_centres_per_px, damage_dark_e_per_s, damage_known_e_per_s : float
        Radiation damage (`render.detector.displacement_damage.aged`): mean number of centres per pixel, mean of the
        exponentially distributed dark current of each at the reference, and limit of the map of defects [e-/s].
    dark_curve_c, dark_curve_e_per_s : tuple of float
        Tabulated mean dark current over temperature, in place of ``dark_doubling_c``.
    assumed, from_base, from_default : tuple of str
        Keys of the data file whose value its source does not give; that came from its base; that it leaves out.

    Raises
    ------
    DomainError
        On a value that is no number or outside its range, a crosstalk that leaves a pixel less than half of its charge,
        or a non-linearity that folds back.
    """

    name: str
    source: str
    chip_width_px: int
    chip_height_px: int
    chips: int
    gap_px: int
    pixel_pitch_mm: float
    diffusion_sigma_mm: float
    quantum_efficiency: Response
    prnu: float
    dark_current_e_per_s: float
    dark_reference_c: float
    dark_doubling_c: float
    dark_spread_e_per_s: float
    hot_fraction: float
    hot_dark_e_per_s: float
    dead_fraction: float
    full_well_e: float
    crosstalk_horizontal: float
    crosstalk_vertical: float
    crosstalk_diagonal: float
    read_noise_e: float
    read_noise_spread: float
    gain_dn_per_e: float
    nonlinearity: tuple[float, ...]
    offset_dn: float
    dsnu_e: float
    column_pattern_e: float
    adc_bits: int
    sensor_seed: int
    blooming: float = 0.0
    lag: float = 0.0
    transfer_line_us: float = 0.0
    damage_centres_per_px: float = 0.0
    damage_dark_e_per_s: float = 0.0
    damage_known_e_per_s: float = _HIGHEST
    dark_curve_c: tuple[float, ...] = ()
    dark_curve_e_per_s: tuple[float, ...] = ()
    assumed: tuple[str, ...] = ()
    from_base: tuple[str, ...] = ()
    from_default: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for key, (low, high, unit) in RANGES.items():
            name = _LENGTHS.get(key, key)
            scale = UM_MM if key in _LENGTHS else 1.0
            field = getattr(self, name)
            for value in field if isinstance(field, tuple) else (field,):
                number = isinstance(value, Real) and not isinstance(value, bool)
                if not (number and low * scale <= value <= high * scale):  # NaN fails too
                    shown_unit = unit.replace("um", "mm")
                    shown = f"{value:g} {shown_unit}".rstrip() if number else f"{value!r}"
                    allowed = f"{low * scale:g} to {high * scale:g} {shown_unit}".rstrip()
                    raise DomainError(
                        f"Detector.{name} = {shown}; it must be {'' if number else 'a number, '}{allowed}"
                    )
        if not isinstance(self.quantum_efficiency, Response):
            raise DomainError(f"Detector.quantum_efficiency = {self.quantum_efficiency!r}; a Response is needed")
        lost = 2 * (self.crosstalk_horizontal + self.crosstalk_vertical) + 4 * self.crosstalk_diagonal
        if lost > 0.5:
            raise DomainError(
                f"Detector crosstalk takes {lost:g} of a pixel's charge (2 horizontal + 2 vertical + 4 diagonal); "
                "at most 0.5 is allowed"
            )

        fraction = falling_from(self.nonlinearity)
        if fraction is not None:
            raise DomainError(
                f"Detector.nonlinearity = {tuple(self.nonlinearity)}: output falls again from {fraction:.3g} of the "
                f"full well ({fraction * self.full_well_e:.4g} e-) on; it must rise up to the full well"
            )

    @property
    def width_px(self) -> int:
        """Columns of the whole detector, gaps included."""
        return self.chips * self.chip_width_px + (self.chips - 1) * self.gap_px

    @property
    def height_px(self) -> int:
        """Number of rows."""
        return self.chip_height_px

    @property
    def gap_columns_px(self) -> tuple[tuple[int, int], ...]:
        """First and last columns of the gaps between chips."""
        if not self.gap_px:
            return ()
        starts = [(k + 1) * self.chip_width_px + k * self.gap_px for k in range(self.chips - 1)]
        return tuple((start, start + self.gap_px - 1) for start in starts)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the image."""
        return self.height_px, self.width_px

    @property
    def diffusion_sigma_px(self) -> float:
        """Charge diffusion [px]."""
        return self.diffusion_sigma_mm / self.pixel_pitch_mm

    @property
    def has_column_effects(self) -> bool:
        """Whether light in one row changes others, by blooming or smear."""
        return bool(self.blooming or self.transfer_line_us)

    @property
    def largest_dn(self) -> int:
        """Largest number the converter gives."""
        return int(2**self.adc_bits - 1)

    @property
    def converter_top_e(self) -> float:
        """Electrons above the offset at which the converter ends [e-]."""
        return (self.largest_dn - self.offset_dn) / self.gain_dn_per_e

    @property
    def saturation_e(self) -> float:
        """Electrons at which a pixel saturates: the full well, or where the converter ends."""
        return min(self.full_well_e, self.converter_top_e)

    def remarks(self) -> tuple[str, ...]:
        """Numbers that are not from the data sheet, and a converter that ends below half the full well."""
        remarks = []
        for keys, words in (
            (self.from_base, "taken from base"),
            (self.from_default, "left out of the file, so the default"),
            (self.assumed, "assumed, not in the source"),
        ):
            if keys:
                remarks.append(f"Detector {self.name}: {words}: {', '.join(keys)}.")
        if self.converter_top_e < 0.5 * self.full_well_e:
            remarks.append(
                f"Detector {self.name}: the converter ends at {self.converter_top_e:.0f} e-, "
                f"{100.0 * self.converter_top_e / self.full_well_e:.0f} % of the full well of {self.full_well_e:.0f} "
                "e-: gain_dn_per_e is high for adc_bits."
            )
        return tuple(remarks)

    def dark_factor(self, temperature_c: float) -> float:
        """Dark current at a temperature over that at the reference.

        2^((T - T_ref) / T_double); of a tabulated curve its logarithm, linear in 1/T between the points. `DomainError`
        outside -200 to 150 C, or outside the curve.
        """
        if self.dark_curve_c:
            low, high = self.dark_curve_c[0], self.dark_curve_c[-1]
            if not low <= temperature_c <= high:
                raise DomainError(
                    f"temperature_c = {temperature_c:g} C; the dark current of detector {self.name!r} is tabulated "
                    f"from {low:g} to {high:g} C"
                )
            current = tabulated_dark_current(self.dark_curve_c, self.dark_curve_e_per_s, temperature_c)
            return current / self.dark_current_e_per_s
        return dark_current_ratio(temperature_c, reference_c=self.dark_reference_c, doubling_c=self.dark_doubling_c)


def _number(low: float, high: float, unit: str, text: str, default: Any = ...) -> Any:
    """A number of a detector file with its range and unit."""
    about = f"{text} [{unit}]" if unit else text
    return Field(default=default, ge=low, le=high, allow_inf_nan=False, description=about)


class ResponseTable(BaseModel):
    """Quantum efficiency, fill factor included: two lists, or a CSV file in their place."""

    model_config = ConfigDict(extra="forbid", strict=False)
    source: str = Field(min_length=1, description="source of the curve")
    wavelength_nm: list[float] = Field(min_length=2, description="increasing wavelengths [nm]")
    value: list[float] = Field(min_length=2, description="quantum efficiency, 0 to 1")


class DarkTable(BaseModel):
    """Mean dark current over the temperature of the chip: two lists, or a CSV file in their place."""

    model_config = ConfigDict(extra="forbid")
    temperature_c: list[float] = Field(min_length=2, description="increasing temperatures [C]")
    e_per_s: list[float] = Field(min_length=2, description="mean dark current [e-/s]")

    @model_validator(mode="after")
    def _curve(self) -> DarkTable:
        t, current = np.array(self.temperature_c), np.array(self.e_per_s)
        if len(t) != len(current):
            raise ValueError(f"{len(t)} temperatures, {len(current)} dark currents")
        if not (np.diff(t) > 0.0).all() or not (t[0] >= -200.0 and t[-1] <= 150.0):
            raise ValueError("temperatures must increase, from -200 to 150 C at most")
        if not ((current > 0.0) & (current <= _HIGHEST)).all():
            raise ValueError(f"dark currents must be above 0 and at most {_HIGHEST:g} e-/s")
        return self


class DetectorFile(BaseModel):
    """A detector's data file; see `Detector` for the definitions. ``base`` names a detector to start from."""

    model_config = ConfigDict(extra="forbid")
    base: str | None = Field(default=None, description="detector that supplies the keys left out here")
    name: str = Field(min_length=1, description="name of the detector")
    source: str = Field(min_length=1, description="source of the values")
    assumed: list[str] = Field(default=[], description="keys with assumed values")
    quantum_efficiency: ResponseTable
    dark_current: DarkTable | None = None
    chip_width_px: int = _number(1, 32768, "px", "columns of a chip")
    chip_height_px: int = _number(1, 32768, "px", "rows of a chip")
    chips: int = _number(1, 16, "", "chips side by side", 1)
    gap_px: int = _number(0, 4096, "px", "dead columns between chips", 0)
    pixel_pitch_um: float = _number(0.1, 1000, "um", "pixel pitch")
    full_well_e: float = _number(1, _HIGHEST, "e-", "saturation capacity")
    read_noise_e: float = _number(0, 1e5, "e-", "median temporal dark noise")
    read_noise_spread: float = _number(
        0, 2, "", "standard deviation over the pixels of the logarithm of the read noise", 0.0
    )
    gain_dn_per_e: float = _number(1e-6, 1e5, "DN/e-", "system gain K")
    adc_bits: int = _number(1, 16, "bit", "resolution of the converter")
    offset_dn: float | None = _number(0, 65535, "DN", "mean offset; default: ten times the read noise", None)
    nonlinearity: tuple[float, ...] = Field(
        default=(), max_length=8, description="c_i (-0.5 to 0.5) of DN = K x (1 + sum c_i (x / full_well)^i), x in e-"
    )
    dark_current_e_per_s: float = _number(0, _HIGHEST, "e-/s", "mean dark current at dark_reference_c")
    dark_reference_c: float = _number(-200, 150, "C", "reference temperature of the dark current")
    dark_doubling_c: float = _number(1, 100, "C", "warming that doubles the dark current", 6.5)
    dark_spread_e_per_s: float = _number(
        0, _HIGHEST, "e-/s", "standard deviation of the dark current over the pixels", 0.0
    )
    hot_fraction: float = _number(0, 1, "", "fraction of hot pixels", 0.0)
    hot_dark_e_per_s: float = _number(0, _HIGHEST, "e-/s", "mean extra dark current of hot pixels", 0.0)
    dead_fraction: float = _number(0, 1, "", "fraction of dead pixels", 0.0)
    prnu: float = _number(0, 0.5, "", "relative standard deviation of the response over the pixels", 0.0)
    dsnu_e: float = _number(0, 1e5, "e-", "standard deviation of the offset over the pixels", 0.0)
    column_pattern_e: float = _number(0, 1e5, "e-", "standard deviation of the offset over the columns", 0.0)
    diffusion_sigma_um: float = _number(0, 100, "um", "charge diffusion, standard deviation of a Gaussian", 0.0)
    crosstalk_horizontal: float = _number(0, 0.2, "", "charge share of a left or right neighbour", 0.0)
    crosstalk_vertical: float = _number(0, 0.2, "", "charge share of an upper or lower neighbour", 0.0)
    crosstalk_diagonal: float = _number(0, 0.1, "", "charge share of a diagonal neighbour", 0.0)
    blooming: float = _number(0, 1, "", "share of the charge above the full well that blooms along the column", 0.0)
    lag: float = _number(0, 0.5, "", "fraction of a frame's charge that is read with the next frame", 0.0)
    transfer_line_us: float = _number(0, 1e5, "us", "frame transfer under light: time per row", 0.0)
    damage_centres_per_px: float = _number(
        0, 1000, "", "radiation damage: mean number of damage centres per pixel", 0.0
    )
    damage_dark_e_per_s: float = _number(0, _HIGHEST, "e-/s", "mean dark current of a damage centre", 0.0)
    damage_known_e_per_s: float = _number(
        0, _HIGHEST, "e-/s", "dark current by damage centres above which a pixel is a listed defect", _HIGHEST
    )
    sensor_seed: int = _number(0, 2**63, "", "seed of the individual detector's fixed patterns and defects", 1)

    @model_validator(mode="after")
    def _assumed(self) -> DetectorFile:
        for key in self.assumed:
            if key not in type(self).model_fields:
                raise ValueError(f"assumed: {unknown_name('key', key, type(self).model_fields)}")
        return self


def _ranges() -> Iterator[tuple[str, tuple[float, float, str]]]:
    for name, field in DetectorFile.model_fields.items():
        limits = [getattr(mark, end) for end in ("ge", "le") for mark in field.metadata if hasattr(mark, end)]
        if limits:
            yield name, (*limits, str(field.description).partition(" [")[2].rstrip("]"))


RANGES: dict[str, tuple[float, float, str]] = {**dict(_ranges()), "nonlinearity": (-0.5, 0.5, "")}
"""Lowest and highest value and unit of the numbers of a data file."""


def list_detectors() -> tuple[str, ...]:
    """Names that `load_detector` knows.

    Returns
    -------
    tuple of str
        Names, sorted.
    """
    return tuple(sorted(path.stem for path in _DATA.glob("*.toml")))


def load_detector(name_or_path: str | Path) -> Detector:
    """Read a detector's data file.

    Parameters
    ----------
    name_or_path : str or pathlib.Path
        A name from `list_detectors`, or the path of a TOML file.

    Returns
    -------
    Detector
        The data sheet as a record.

    Raises
    ------
    ConfigError
        Unknown name, missing or broken file, unknown or missing key, value out of range: one line per fault.
    """
    path = _resolve(name_or_path)
    mapping, inherited = _read(path, ())
    needed = [key for key, field in DetectorFile.model_fields.items() if field.is_required()]
    missing = [key for key in needed if key not in mapping]
    if len(missing) > MOST_MISSING:
        names = " or ".join(f'"{name}"' for name in list_detectors())
        raise ConfigError(
            f"{path}: {len(missing)} keys are missing: {', '.join(missing)}; the page on detector files says where a "
            f"data sheet gives them; base = {names} at its head supplies missing keys from that detector"
        )
    checked = parse_model(DetectorFile, mapping, str(path))
    given = checked.model_fields_set
    values = checked.model_dump(exclude={"base", "quantum_efficiency", "dark_current", "assumed"} | set(_LENGTHS))
    if checked.offset_dn is None:
        values["offset_dn"] = OFFSET_SIGMA * checked.read_noise_e * checked.gain_dn_per_e
    lengths = {field: getattr(checked, key) * UM_MM for key, field in _LENGTHS.items()}
    table, dark = checked.quantum_efficiency, checked.dark_current
    silent = {key for key in DetectorFile.model_fields if key.startswith("damage")} | UNSTATED
    if dark is not None:
        values |= {"dark_curve_c": tuple(dark.temperature_c), "dark_curve_e_per_s": tuple(dark.e_per_s)}
        silent = silent | {"dark_doubling_c"}
    try:
        curve = Response(
            name=f"quantum efficiency of {checked.name}",
            source=table.source,
            wavelength_nm=np.array(table.wavelength_nm),
            value=np.array(table.value),
        )
        return Detector(
            **values,
            **lengths,
            quantum_efficiency=curve,
            assumed=tuple(checked.assumed),
            from_base=tuple(key for key in DetectorFile.model_fields if key in inherited),
            from_default=tuple(key for key in DetectorFile.model_fields if key not in given | silent),
        )
    except DomainError as error:
        raise ConfigError(f"{path}: {str(error).removeprefix('Detector.')}") from None


def _resolve(name_or_path: str | Path) -> Path:
    path = Path(name_or_path)
    if path.suffix == ".toml" or len(path.parts) > 1:
        return path
    shipped = _DATA / f"{name_or_path}.toml"
    if not os.path.isfile(shipped):
        raise unknown_name("detector", str(name_or_path), list_detectors())
    return shipped


DARK_KEYS = ("dark_current_e_per_s", "dark_reference_c", "dark_doubling_c")


def _read(path: Path, above: tuple[Path, ...]) -> tuple[Mapping[str, Any], frozenset[str]]:
    """Mapping of the file with those of its bases underneath, and the keys that came from there."""
    if path.resolve() in above:
        raise ConfigError(f"{path}: base = {above[0].name!r} refers back to itself")
    if not os.path.exists(path):
        raise ConfigError(f"{path}: no such file; known detectors: {', '.join(list_detectors())}")
    mapping = _with_curves(read_toml(path), path)
    base = mapping.get("base")
    if base is None:
        return mapping, frozenset()
    if not isinstance(base, str):
        raise ConfigError(f"{path}: base = {base!r}; the name of a detector is needed")
    try:
        below = _resolve(base)
    except ConfigError as error:
        raise ConfigError(f"{path}: base: {error}") from None
    below = below if below.is_absolute() else path.parent / below
    lower, _ = _read(below, (*above, path.resolve()))
    inherited = {key: value for key, value in lower.items() if key not in mapping and key not in ("base", "assumed")}
    if "dark_current_e_per_s" in mapping:  # one law of the dark current takes the place of the other
        inherited.pop("dark_current", None)
    marks = [mapping.get("assumed", []), lower.get("assumed", [])]
    if all(isinstance(marked, list) for marked in marks):
        assumed, base_assumed = marks
        mapping = {
            **mapping,
            "assumed": [*assumed, *(key for key in base_assumed if key in inherited and key not in assumed)],
        }
    return {**inherited, **mapping}, frozenset(inherited) - UNSTATED


def _with_curves(mapping: dict[str, Any], path: Path) -> dict[str, Any]:
    """The tables that name a CSV file with what stands in it, and the reference of a dark current over temperature."""
    efficiency, dark = mapping.get("quantum_efficiency"), mapping.get("dark_current")
    if isinstance(efficiency, dict) and "file" in efficiency:
        if extra := {"wavelength_nm", "value"} & efficiency.keys():
            raise ConfigError(f"{path}: quantum_efficiency: give either file or {min(extra)}, not both")
        curve = load_band(_csv_path(path, efficiency["file"], "quantum_efficiency"))
        if curve.value.max() < LEAST_PEAK:
            raise DomainError(
                f"{curve.source}: quantum efficiencies up to {100.0 * curve.value.max():.2g} %; if the values are "
                "fractions, call the column quantum_efficiency"
            )
        rest = {key: value for key, value in efficiency.items() if key != "file"}
        lists = {"wavelength_nm": curve.wavelength_nm.tolist(), "value": curve.value.tolist()}
        mapping = {**mapping, "quantum_efficiency": {"source": curve.source, **rest, **lists}}
    if not isinstance(dark, dict):
        return mapping
    if "file" in dark:
        mapping = {**mapping, "dark_current": _dark_rows(_csv_path(path, dark["file"], "dark_current"))}
    if extra_key := next((key for key in DARK_KEYS if key in mapping and key != "dark_reference_c"), None):
        raise ConfigError(f"{path}: give either {extra_key} or a table [dark_current], not both")
    table = parse_model(DarkTable, mapping["dark_current"], f"{path}: dark_current")
    reference = mapping.get("dark_reference_c", table.temperature_c[-1])
    low, high = table.temperature_c[0], table.temperature_c[-1]
    if not isinstance(reference, int | float) or not low <= reference <= high:
        raise ConfigError(f"{path}: dark_reference_c = {reference!r} C is outside the table's {low:g} to {high:g} C")
    at = tabulated_dark_current(tuple(table.temperature_c), tuple(table.e_per_s), reference)
    return {**mapping, "dark_reference_c": reference, "dark_current_e_per_s": at}


def _csv_path(path: Path, name: Any, table: str) -> Path:
    if not isinstance(name, str):
        raise ConfigError(f"{path}: {table}.file = {name!r}; the path of a CSV file is needed")
    return path.parent / name


def _dark_rows(path: Path) -> dict[str, list[float]]:
    """Columns temperature_c and e_per_s of a CSV file; the temperatures may fall."""
    lines = read_text(path, "a table of temperatures and dark currents").lines
    _, rows = two_columns(lines, path.name, "temperature_c and e_per_s")
    if len(rows) > 1 and rows[0][0] > rows[-1][0]:
        rows.reverse()
    return {"temperature_c": [t for t, _ in rows], "e_per_s": [e for _, e in rows]}
