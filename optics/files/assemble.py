"""Conversion of a parsed lens file into a prescription: glasses, stop, field, report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from optics.arrays import FloatArray
from optics.errors import ConfigError
from optics.files.first_order import FirstOrder, first_order
from optics.files.glasses import AssignedGlass, GlassFinder
from optics.files.parsed_file import ParsedFile, SurfaceRow
from optics.files.report import FirstOrderComparison, GlassChoice, ImportReport
from optics.glass.absolute_index import CATALOGUE_AIR, Environment
from optics.glass.catalogue import Glass, get_glass, list_glasses
from optics.records import locked

WIDEST_DEG = 89.0
AXIS_ONLY_DEG = 0.1
"""Half field of a lens whose file states the axis only; the report names it."""
MIRROR = "mirror"
AIR = "air"


@dataclass(frozen=True, slots=True, kw_only=True)
class FileDefaults:
    """Settings in a lens file that are not part of the lens; defaults of its user."""

    wavelength_nm: FloatArray  # (w,) Design wavelengths [nm] and weights
    wavelength_weight: FloatArray  # (w,)
    # How the file states fields: ``angle`` [deg], ``object``, ``paraxial_image`` or ``real_image`` [mm]
    field_kind: str
    field_stated: FloatArray  # (f, 2) Fields as stated, and as angles along x and y [deg]
    field_deg: FloatArray  # (f, 2)
    field_weight: FloatArray  # (f,) Weights
    vignetting: FloatArray  # (f, 5) Decentre x, y, compression x, y and angle of the pupil for every field
    aperture: str  # How the file states the aperture, in words
    entrance_pupil_mm: float  # Diameter of the paraxial entrance pupil [mm]
    object_mm: float  # Distance of the object; infinite for stars
    environment: Environment  # Temperature and pressure of the file
    configuration: int  # Which configuration was read, and how many there are
    configurations: int


@dataclass(frozen=True, slots=True)
class Imported:
    """A lens file as tables of a prescription (`optics.lens.tables`), with its report and defaults.

    ``rows`` are the file's data for each table of a surface or coordinate break, in the same order.
    """

    tables: dict[str, Any]
    report: ImportReport
    defaults: FileDefaults
    rows: tuple[SurfaceRow, ...]


def assemble(parsed: ParsedFile, catalogues: Sequence[Path], glasses: Mapping[str, str]) -> Imported:
    """Complete a parsed file: glasses, stop, fields, defaults of its program."""
    _checked_rows(parsed)
    _checked_wavelengths(parsed)
    finder = GlassFinder(parsed, catalogues, glasses)
    assigned = {row.number: finder.find(row.glass) for row in parsed.rows if row.glass is not None}
    media = _media(parsed.rows, assigned)
    data = _first_order(parsed, media)
    choices = [_choice(parsed, row, assigned[row.number], media, data) for row in parsed.rows if row.number in assigned]
    pupil_mm = _stop(parsed, data)
    angles = _field_angles(parsed, data)
    comparisons = _comparisons(parsed, data, pupil_mm)
    tables = _tables(parsed, assigned, angles)
    _remarks(parsed)
    unique = {(c.asked, c.taken, c.where): c for c in choices}
    return Imported(
        tables=tables,
        report=parsed.report.finished(list(unique.values()), comparisons),
        defaults=_defaults(parsed, angles, pupil_mm),
        rows=tuple(parsed.rows),
    )


def _checked_rows(parsed: ParsedFile) -> None:
    if not parsed.rows:
        raise ConfigError(f"{parsed.report.file}: no surface between object and image")
    for row in parsed.rows:
        if math.isinf(row.thickness_mm):
            raise parsed.fail(row.line, f"surface {row.number}: its thickness is infinite")
    stops = [row for row in parsed.rows if row.stop]
    if len(stops) > 1:
        raise parsed.fail(stops[1].line, f"surfaces {stops[0].number} and {stops[1].number} are both the stop")
    if stops and stops[0].is_break:
        raise parsed.fail(stops[0].line, "a coordinate break cannot be the stop")
    if not stops:
        first = next((row for row in parsed.rows if not row.is_break), None)
        if first is None:
            raise ConfigError(f"{parsed.report.file}: it contains only coordinate breaks, no surface")
        first.stop = True
        parsed.report.assumed("STOP", f"the file names no stop; surface {first.number} is taken, as design programs do")


def _checked_wavelengths(parsed: ParsedFile) -> None:
    if not parsed.wavelengths:
        raise ConfigError(f"{parsed.report.file}: no wavelength is stated")
    for wave, weight in parsed.wavelengths:
        if not 100.0 < wave < 30000.0 or not weight >= 0.0:
            raise ConfigError(
                f"{parsed.report.file}: wavelength {wave:g} nm, weight {weight:g}; 100 to 30000 nm "
                "and a weight of 0 or more are needed"
            )
    if not 0 <= parsed.primary < len(parsed.wavelengths):
        parsed.report.assumed(
            "primary wavelength", f"number {parsed.primary + 1} of {len(parsed.wavelengths)} does not exist: 1 is taken"
        )
        parsed.primary = 0


def _media(rows: Sequence[SurfaceRow], assigned: Mapping[int, AssignedGlass]) -> list[Glass | None]:
    """Medium behind every row, None for air; behind mirrors and breaks that in front of them."""
    media: list[Glass | None] = []
    for row in rows:
        if row.mirror or row.is_break:
            media.append(media[-1] if media else None)
        else:
            media.append(assigned[row.number].glass if row.number in assigned else None)
    return media


def _first_order(parsed: ParsedFile, media: list[Glass | None]) -> FirstOrder:
    return first_order(parsed.rows, media, parsed.wavelengths[parsed.primary][0], _environment(parsed))


def _choice(
    parsed: ParsedFile, row: SurfaceRow, assigned: AssignedGlass, media: list[Glass | None], data: FirstOrder
) -> GlassChoice:
    """The choice of a glass with the change of focal length that it makes; its line of the report is written."""
    choice, asked = assigned.choice, row.glass
    assert asked is not None
    if assigned.intended is not None:
        intended = [assigned.intended if glass is assigned.glass else glass for glass in media]
        other = _first_order(parsed, intended)
        choice = replace(choice, efl_mm=data.efl_mm - other.efl_mm, bfl_mm=data.bfl_mm - other.bfl_mm)
    if choice.status == "taken":
        parsed.report.taken(asked.line, asked.command, f"{choice.taken}: {choice.where}", row.number)
    else:
        text = f"{choice.asked} -> {choice.taken}: {choice.where}; {choice.change_text}"
        parsed.report.approximated(asked.line, asked.command, text, row.number)
    return choice


def _stop(parsed: ParsedFile, data: FirstOrder) -> float:
    """Give the stop its semi-diameter [mm] from the aperture that the file states; the entrance pupil's diameter."""
    row = next(row for row in parsed.rows if row.stop)
    aperture, stop_height = parsed.aperture, abs(data.stop_height)
    own_mm = row.clear_mm or row.drawn_mm
    if aperture is None or aperture.kind == "STOP":
        if not own_mm:
            what = "no aperture is stated" if aperture is None else "the aperture floats by the stop"
            raise parsed.fail(row.line, f"{what}, and the stop (surface {row.number}) has no semi-diameter")
        if aperture is None:
            parsed.report.assumed("aperture", f"none is stated; the stop's own semi-diameter {own_mm:g} mm is taken")
        row.clear_mm = own_mm
        return 2.0 * own_mm / stop_height if stop_height else math.inf
    if aperture.kind == "FNO":
        pupil_mm = abs(data.efl_mm) / aperture.value
    elif aperture.kind == "NA":
        pupil_mm = abs(data.efl_mm) / (1.0 / math.tan(math.asin(min(aperture.value, 1))) / 2.0)
    elif aperture.kind == "NAO":
        if math.isinf(parsed.object_mm) or not 0.0 < aperture.value < 1.0:
            raise parsed.fail(
                aperture.line,
                f"object-side NA {aperture.value:g}, object at {parsed.object_mm:g} mm; an NA "
                "between 0 and 1 and a finite distance are needed",
            )
        pupil_mm = 2.0 * math.tan(math.asin(aperture.value)) * abs(parsed.object_mm + data.pupil_mm)
    else:
        pupil_mm = aperture.value
    semi_mm = 0.5 * pupil_mm * stop_height
    if not 0.0 < semi_mm < 1e7:
        raise parsed.fail(
            aperture.line,
            f"the aperture gives the stop a semi-diameter of {semi_mm:g} mm; it must be positive and below 1e7 mm",
        )
    if row.clear_mm is not None and row.clear_mm < semi_mm * (1.0 - 1e-6):
        message = f"the stop is then {semi_mm:.6g} mm; its smaller clear aperture, {row.clear_mm:.6g} mm, is used"
        parsed.report.approximated(aperture.line, "aperture", message, row.number)
        semi_mm = row.clear_mm
        pupil_mm = 2.0 * semi_mm / stop_height
    row.clear_mm = semi_mm
    return pupil_mm


def _field_angles(parsed: ParsedFile, data: FirstOrder) -> list[tuple[float, float]]:
    """Fields as angles along x and y [deg]."""
    angles = []
    for point in parsed.fields:
        largest = max(abs(point.x), abs(point.y))
        if not math.isfinite(point.x + point.y):
            raise parsed.fail(parsed.fields_line, "a field is not finite")
        if parsed.field_kind == "angle":
            if largest >= 90.0:
                raise parsed.fail(parsed.fields_line, f"a field of {largest:g} deg; it must be below 90 deg")
            angles.append((point.x, point.y))
            continue
        base_mm = data.efl_mm if parsed.field_kind != "object" else parsed.object_mm + data.pupil_mm
        if not math.isfinite(base_mm) or base_mm == 0.0:
            message = "fields are heights, but object or focus is at infinity; give field angles"
            raise parsed.fail(parsed.fields_line, message)
        angles.append((math.degrees(math.atan(point.x / base_mm)), math.degrees(math.atan(point.y / base_mm))))
    return angles


def _half_field(parsed: ParsedFile, angles: list[tuple[float, float]]) -> float:
    tangents = [math.hypot(*(math.tan(math.radians(a)) for a in angle)) for angle in angles]
    half = math.degrees(math.atan(max(tangents, default=0.0)))
    if half < 1e-6:
        parsed.report.assumed("field", f"the only field is the axis; a half field of {AXIS_ONLY_DEG:g} deg is taken")
        return AXIS_ONLY_DEG
    return min(half, WIDEST_DEG)


def _comparisons(parsed: ParsedFile, data: FirstOrder, pupil_mm: float) -> list[FirstOrderComparison]:
    stated = {name: value for name, (value, _) in parsed.stated.items()}
    source = {name: where for name, (_, where) in parsed.stated.items()}
    finite = math.isfinite(data.efl_mm) and abs(data.efl_mm) < 1e9
    f_number = abs(data.efl_mm) / pupil_mm if finite and pupil_mm else None
    return [
        FirstOrderComparison("EFL", data.efl_mm if finite else None, stated.get("EFL"), "mm", source.get("EFL", "")),
        FirstOrderComparison(
            "BFL", data.bfl_mm if finite else None, data.image_mm, "mm", "distance of the image plane in the file"
        ),
        FirstOrderComparison("F-number", f_number, stated.get("F-number"), "", source.get("F-number", "")),
        FirstOrderComparison("entrance pupil", pupil_mm, None, "mm"),
    ]


def _tables(
    parsed: ParsedFile, assigned: dict[int, AssignedGlass], angles: list[tuple[float, float]]
) -> dict[str, Any]:
    """The prescription."""
    built_in = {*list_glasses(), *list_glasses(obsolete=True)}
    own: dict[str, Any] = {}
    names: dict[tuple[str, str], str] = {}
    surfaces = []
    medium = AIR
    for row in parsed.rows:
        if row.is_break:
            surfaces.append({**row.shape, "thickness_mm": row.thickness_mm})
            continue
        if not row.mirror:
            medium = AIR
            if row.number in assigned:
                glass = assigned[row.number].glass
                medium = names.setdefault((glass.name, glass.maker), _free_name(glass, built_in, own))
                if medium not in built_in:
                    own[medium] = glass_table(glass)
        surfaces.append(_surface_table(row, MIRROR if row.mirror else medium))
    tables: dict[str, Any] = {
        "name": parsed.name or parsed.path.stem or "lens",
        "source": _source(parsed),
        "design_wavelength_nm": parsed.wavelengths[parsed.primary][0],
        "max_field_deg": _half_field(parsed, angles),
        "surface": surfaces,
    }
    image = parsed.image
    if image is not None and image.moved:
        tables["image"] = {k: v for k, v in image.moved.items() if k != "carry"}
    if own:
        tables["glass"] = own
    if parsed.coatings:
        tables["coating"] = parsed.coatings
    return tables


def _free_name(glass: Glass, built_in: set[str], own: Mapping[str, Any]) -> str:
    """Name of the glass unless the built-in catalogue has another glass of that name."""
    if glass.name in built_in and get_glass(glass.name) is glass:
        return glass.name
    name = glass.name if glass.name not in built_in and glass.name != AIR else f"{glass.name}_{glass.maker}"
    while name in own:
        name += "'"
    return name


def glass_table(glass: Glass) -> dict[str, Any]:
    """A glass as the table ``[glass.NAME]`` of a lens file."""
    table: dict[str, Any] = {
        "source": glass.source,
        "maker": glass.maker,
        "formula": glass.dispersion.formula,
        "coefficients": list(glass.dispersion.coefficients),
        "range_nm": list(glass.range_nm),
        "reference_temperature_c": glass.reference_temperature_c,
        "reference_pressure_hpa": glass.reference_pressure_hpa,
    }
    if glass.dndt is not None:
        table["dndt"], table["dndt_range_c"] = list(glass.dndt.constants), list(glass.dndt.range_c)
    for key in ("cte_per_k", "density_g_cm3", "nd", "vd"):
        if getattr(glass, key) is not None:
            table[key] = getattr(glass, key)
    if glass.transmittance is not None:
        table["transmittance_mm"] = glass.transmittance_mm
        table["transmittance_nm"] = [float(w) for w in glass.transmittance.wavelength_nm]
        table["transmittance"] = [float(t) for t in glass.transmittance.value]
    return table


def _surface_table(row: SurfaceRow, medium: str) -> dict[str, Any]:
    table: dict[str, Any] = {**row.shape, "thickness_mm": row.thickness_mm, "medium": medium}
    if row.clear_mm is not None:
        table["semi_diameter_mm"] = row.clear_mm
    if row.inner_mm:
        table["inner_semi_diameter_mm"] = row.inner_mm
    if row.stop:
        table["stop"] = True
    if row.apertures:
        table["aperture"] = row.apertures
    if row.coating:
        table["coating"] = row.coating
    return {**table, **row.moved}


def _source(parsed: ParsedFile) -> str:
    text = f"read from {parsed.report.file}"
    notes = " ".join(parsed.notes[:4])
    return f"{text}: {notes}"[:300] if notes else text


def _remarks(parsed: ParsedFile) -> None:
    """Remarks on an image plane that no detector can have."""
    report = parsed.report
    if math.isfinite(parsed.object_mm):
        report.assumed(
            "object",
            f"it stands at {parsed.object_mm:g} mm in the file; stars are at infinity, the lens is unchanged",
        )
    if parsed.image is not None and parsed.image.shape.get("kind") not in ("plane", "sphere", "coordinate_break"):
        report.assumed("image", "the image surface is not plane in the file; a plane detector stands at its vertex")
    elif parsed.image is not None and math.isfinite(parsed.image.shape.get("radius_mm", math.inf)):
        radius = parsed.image.shape["radius_mm"]
        report.assumed(
            "image", f"the image surface has a radius of {radius:g} mm; a plane detector stands at its vertex"
        )


def _environment(parsed: ParsedFile) -> Environment:
    """Surroundings that the indices of the file belong to."""
    if not parsed.adjusted:
        return CATALOGUE_AIR
    return Environment(temperature_c=parsed.temperature_c, pressure_hpa=parsed.pressure_hpa)


def _defaults(parsed: ParsedFile, angles: list[tuple[float, float]], pupil_mm: float) -> FileDefaults:
    aperture = parsed.aperture
    words = "semi-diameter of the stop" if aperture is None or aperture.kind == "STOP" else ""
    if not parsed.adjusted and (parsed.temperature_c, parsed.pressure_hpa) != (20.0, 1013.25):
        parsed.report.assumed(
            "environment",
            f"the file states {parsed.temperature_c:g} C, {parsed.pressure_hpa:g} hPa; refractive indices stay at 20 "
            "C in air",
            exact=True,
        )
    return FileDefaults(
        wavelength_nm=locked([wave for wave, _ in parsed.wavelengths]),
        wavelength_weight=locked([weight for _, weight in parsed.wavelengths]),
        field_kind=parsed.field_kind,
        field_stated=locked(np.array([(p.x, p.y) for p in parsed.fields]).reshape(-1, 2)),
        field_deg=locked(np.array(angles).reshape(-1, 2)),
        field_weight=locked([p.weight for p in parsed.fields]),
        vignetting=locked(np.array([p.vignetting for p in parsed.fields]).reshape(-1, 5)),
        aperture=words or f"{aperture.kind} {aperture.value:g}" if aperture is not None else words,
        entrance_pupil_mm=pupil_mm,
        object_mm=parsed.object_mm,
        environment=_environment(parsed),
        configuration=parsed.configuration,
        configurations=parsed.configurations,
    )
