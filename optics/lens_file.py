"""Lens files of all formats, with a report on every line and the file's settings that are not part of the lens.

Clear apertures missing in the file are computed by ray trace: as wide as the light of the whole field needs. The
geometry is then checked (`optics.lens.geometry`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from optics.errors import ConfigError, StarbenchError, unknown_name
from optics.files.assemble import FileDefaults, Imported, glass_table
from optics.files.glasses import read_glass
from optics.files.parsed_file import SurfaceRow
from optics.files.read import FOREIGN, Reading, import_lens, split_configuration
from optics.files.report import ImportReport, ReportLine, Status
from optics.glass.absolute_index import CATALOGUE_AIR, Environment
from optics.glass.catalogue import list_glasses
from optics.lens.geometry import acts, crossings, geometry_faults, idle_stop
from optics.lens.ideal_lens import measured_lens
from optics.lens.measured import measured_from_table
from optics.lens.prescription import lens_from_table, rims_mm
from optics.lens.system import LensSystem
from optics.lens.tables import BREAK
from optics.rays.marginal_rays import SemiDiameters, beam_semi_diameters
from optics.validate import read_toml

MARGIN = 1.002
"""Of a clear aperture that is found over the marginal rays that find it, which are some of all (`SemiDiameters`)."""
TOML_FIELDS = (0.0, 0.7, 1.0)
TOML_WAVES = (0.85, 1.0, 1.2)
"""Shares of the half field, and of the design wavelength, whose light has to pass where a TOML file states no rim."""
DRAWN_APART = 0.02
"""Relative difference up to which clear apertures agree with the file's program."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensFile:
    """A lens file.

    Attributes
    ----------
    lens : LensSystem
        The lens.
    tables : dict
        Its prescription, as a TOML file holds it (`optics.lens.tables.Prescription`).
    report : ImportReport or None
        Import report, line by line; None for a TOML file.
    defaults : FileDefaults or None
        Fields, wavelengths, vignetting factors, aperture; None for a TOML file.
    labels : tuple of str
        Names of the surfaces in the file, if it does not number them from 0.
    """

    lens: LensSystem
    tables: dict[str, Any]
    report: ImportReport | None = None
    defaults: FileDefaults | None = None
    labels: tuple[str, ...] = ()


def _builtin() -> dict[str, Path]:
    folder = Path(str(resources.files("optics"))) / "data" / "lenses"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def list_lenses() -> tuple[str, ...]:
    """Names of the built-in prescriptions.

    Returns
    -------
    tuple of str
        Names for `load_lens`, sorted.
    """
    return tuple(_builtin())


def lens_path(name_or_path: str | Path) -> Path:
    """File of a lens: a built-in name, or a path."""
    builtin, text = _builtin(), str(name_or_path)
    if text in builtin:
        return builtin[text]
    if "/" in text or text.lower().endswith((".toml", *FOREIGN)):
        return Path(text)
    if os.path.isfile(text):  # False as well where a name is too long for the system
        raise ConfigError(f"{text}: a lens file ends in .toml, {' or '.join(FOREIGN)}")
    raise unknown_name("lens", text, builtin)


def load_lens(name_or_path: str | Path, *, environment: Environment | None = None) -> LensSystem:
    """Read a lens.

    Parameters
    ----------
    name_or_path : str or path
        A built-in name (`list_lenses`), a TOML file, or a lens file of Zemax (.zmx) or CODE V (.seq), of which
        ``zoom.zmx#2`` is the second configuration. `read_lens_file` reports on every line of such a file.
    environment : Environment, optional
        Temperature and pressure; `optics.glass.absolute_index.VACUUM` for space. Left out: that of the file, or
        `optics.glass.absolute_index.CATALOGUE_AIR`.

    Returns
    -------
    LensSystem
        The lens.

    Raises
    ------
    ConfigError
        As `read_lens_file`.
    """
    return read_lens_file(name_or_path, environment=environment).lens


def read_lens_file(
    name_or_path: str | Path,
    *,
    environment: Environment | None = None,
    configuration: int | None = None,
    catalogues: Sequence[str | Path] = (),
    glasses: Mapping[str, str] | None = None,
    strict: bool = False,
) -> LensFile:
    """Read a lens file with its import report.

    Parameters
    ----------
    name_or_path : str or path
        A Zemax (.zmx), CODE V (.seq) or TOML file, or a built-in name; ``zoom.zmx#2`` is its second configuration.
    environment : Environment, optional
        Temperature and pressure; the file's if left out.
    configuration : int, optional
        Configuration or zoom position, from 1; the active one if left out.
    catalogues : sequence of path
        Glass catalogues (AGF); those beside the file are used too.
    glasses : mapping, optional
        Name in the file -> glass to take in its place.
    strict : bool
        Refuse every difference from the file, and leave surfaces open that have no clear aperture there.

    Returns
    -------
    LensFile
        The lens, with the report of every line that was read, approximated or left out.

    Raises
    ------
    ConfigError
        Unknown name (with the nearest), missing or broken file, unknown key (with the nearest), unknown glass, a
        geometry that cannot be (`optics.lens.geometry`); one line per fault, with the line of the file.
    """
    where = str(name_or_path)
    name, marked = split_configuration(where)
    path = lens_path(name)
    reading = Reading(
        configuration=marked if configuration is None else configuration,
        catalogues=tuple(map(Path, catalogues)),
        glasses=glasses or {},
        strict=strict,
    )
    if path.suffix.lower() in FOREIGN:
        return _of_program(import_lens(path, reading), path, environment, strict)
    if reading != Reading(strict=strict):
        raise ConfigError(f"{name}: configuration, catalogues and substitute glasses apply to .zmx and .seq files only")
    return _of_toml(path, where, environment)


def _of_toml(path: Path, where: str, environment: Environment | None) -> LensFile:
    """A file of our own format."""
    tables = read_toml(path)
    if tables.get("kind") == "measured":
        return LensFile(lens=measured_lens(measured_from_table(tables, where)), tables=tables)
    _check_glasses(tables, where)
    tables = _with_glass_files(tables, path.parent, where)
    lens = lens_from_table(tables, where=where, folder=path.parent, environment=environment or CATALOGUE_AIR)
    if _open(lens):
        shares = [(0.0, 0.0), *((c * f, s * f) for f in TOML_FIELDS[1:] for c, s in ((0, 1), (1, 0), (0, -1), (-1, 0)))]
        waves = np.clip(np.array(TOML_WAVES) * lens.design_wavelength_nm, *lens.wavelength_range_nm)
        try:
            found = beam_semi_diameters(lens, np.array(shares) * lens.max_field_deg, waves)
            lens, tables = _closed(lens, tables, found)
        except StarbenchError:
            pass  # no light to go by: they stay open
    faults = geometry_faults(lens)
    if faults:
        raise ConfigError("\n".join(f"{where}: {fault}" for fault in faults))
    return LensFile(lens=lens, tables=tables)


def _open(lens: LensSystem) -> list[int]:
    """Surfaces of glass and mirrors without any clear aperture; planes that only help to count have no rim."""
    return [
        i for i, s in enumerate(lens.surfaces) if np.isinf(s.semi_diameter_mm) and not s.apertures and acts(lens, i)
    ]


def _places(lens: LensSystem, tables: Mapping[str, Any]) -> list[int]:
    """Number of the lens's surface that each table of a surface makes, -1 for a coordinate break."""
    alone = lens.stop_index if tables.get("stop") else len(lens.surfaces)
    free = iter(i for i in range(len(lens.surfaces)) if i != alone)
    return [-1 if table.get("kind") == BREAK else next(free) for table in tables["surface"]]


def _with_rims(
    lens: LensSystem, tables: Mapping[str, Any], radius_mm: Mapping[int, float]
) -> tuple[LensSystem, dict[str, Any]]:
    """Lens and prescription with other clear apertures of some surfaces."""
    surfaces = {i: replace(lens.surfaces[i], semi_diameter_mm=radius) for i, radius in radius_mm.items()}
    rows = [
        {**table, "semi_diameter_mm": radius_mm[i]} if i in radius_mm else table
        for i, table in zip(_places(lens, tables), tables["surface"], strict=True)
    ]
    return lens.with_surfaces(surfaces), {**tables, "surface": rows}


def _closed(
    lens: LensSystem, tables: Mapping[str, Any], found: SemiDiameters, surfaces: Sequence[int] | None = None
) -> tuple[LensSystem, dict[str, Any]]:
    """Lens and prescription with the clear apertures that light needs, of those surfaces that have none if left out."""
    radius = {}
    for i in _open(lens) if surfaces is None else surfaces:
        surface, widest = lens.surfaces[i], float(found.semi_diameter_mm[i])
        if widest > surface.inner_semi_diameter_mm:
            radius[i] = min(MARGIN * widest, 0.5 * (widest + surface.shape.rim_mm))
    return _with_rims(lens, tables, radius)


def _of_program(imported: Imported, path: Path, environment: Environment | None, strict: bool) -> LensFile:
    """A file of another program, with what it leaves to be found."""
    where, rows, defaults = str(path), imported.rows, imported.defaults
    tables = imported.tables
    notes: list[ReportLine] = []
    labels = tuple(f"surface {row.number} (line {row.line})" for row in rows)
    if not strict:
        tables, notes = _within_surfaces(tables, rows, labels, where)
    lens = lens_from_table(
        tables,
        where=where,
        folder=path.parent,
        environment=environment or defaults.environment,
        labels=labels,
    )
    mine = {i: row for i, row in zip(_places(lens, tables), rows, strict=True) if i >= 0}
    near = not strict and bool(np.isfinite(defaults.object_mm))
    if near:
        lens, tables = _as_drawn(lens, tables, mine, notes)
    elif not strict:
        try:
            found = _found(lens, defaults)
        except StarbenchError as error:
            notes.append(_note(0, "clear apertures", f"left open where the file states none: {error}"))
        else:
            needs = _open(lens)
            lens, tables = _closed(lens, tables, found)
            notes += _told(lens, needs, mine, found)
            lens, tables = _uncrossed(lens, tables, mine, found, notes)
    told = idle_stop(lens)
    notes += [_note(mine[lens.stop_index].line, "stop", line, mine[lens.stop_index].number) for line in told]
    for crossing in crossings(lens) if near else ():
        told.append(crossing.words)
        at = mine[crossing.surfaces[0]]
        notes.append(_note(at.line, "clear aperture", f"{crossing.words}; kept, as the object is near", at.number))
    faults = [fault for fault in geometry_faults(lens) if strict or fault not in told]
    if faults:
        raise ConfigError("\n".join(f"{where}: {fault}" for fault in faults))
    lines = sorted((*imported.report.lines, *notes), key=lambda line: line.line)
    report = replace(imported.report, lines=tuple(lines))
    return LensFile(lens=lens, tables=tables, report=report, defaults=defaults, labels=labels)


def _note(line: int, command: str, message: str, surface: int | None = None) -> ReportLine:
    return ReportLine(line, command, surface, Status.APPROXIMATED, message, harmless=False)


def _within_surfaces(
    tables: dict[str, Any], rows: Sequence[SurfaceRow], labels: Sequence[str], where: str
) -> tuple[dict[str, Any], list[ReportLine]]:
    """The prescription without clear apertures that reach beyond the rim where their surface ends."""
    rims, notes, surfaces = rims_mm(tables, where, labels), [], []
    for table, row, rim in zip(tables["surface"], rows, rims, strict=True):
        radius = table.get("semi_diameter_mm", 0.0)
        if radius >= rim and not row.stop:
            said = (
                f"{radius:.6g} mm reaches beyond the rim where the surface ends, {rim:.6g} mm: replaced by the "
                "radius that light needs"
            )
            notes.append(_note(row.line, "clear aperture", said, row.number))
            surfaces.append({k: v for k, v in table.items() if k != "semi_diameter_mm"})
        else:
            surfaces.append(table)
    return {**tables, "surface": surfaces}, notes


def _as_drawn(
    lens: LensSystem, tables: dict[str, Any], mine: Mapping[int, SurfaceRow], notes: list[ReportLine]
) -> tuple[LensSystem, dict[str, Any]]:
    """Clear apertures of a lens whose file has a near object: as its program computed them for light from there."""
    drawn = {i: mine[i].drawn_mm or 0.0 for i in _open(lens)}
    drawn = {
        i: r for i, r in drawn.items() if lens.surfaces[i].inner_semi_diameter_mm < r < lens.surfaces[i].shape.rim_mm
    }
    if drawn:
        text = ", ".join(f"{mine[i].number}: {radius:.5g}" for i, radius in drawn.items())
        said = f"not stated, as the file's program drew them for its near object [mm]: {text}"
        notes.append(_note(0, "clear apertures", said))
    left = [str(mine[i].number) for i in _open(lens) if i not in drawn]
    if left:
        notes.append(
            _note(0, "clear apertures", f"surfaces without any, for a near object: {', '.join(left)}: left open")
        )
    return _with_rims(lens, tables, drawn)


def _found(lens: LensSystem, defaults: FileDefaults) -> SemiDiameters:
    """Widths of the file's own light: its fields with their vignetting factors, its wavelengths from first to last."""
    fields = defaults.field_deg if len(defaults.field_deg) else np.zeros((1, 2))
    factors = defaults.vignetting if len(defaults.vignetting) else None
    low, high = lens.wavelength_range_nm
    waves = defaults.wavelength_nm[(defaults.wavelength_nm >= low) & (defaults.wavelength_nm <= high)]
    return beam_semi_diameters(lens, fields, np.unique([*waves, lens.design_wavelength_nm])[[0, -1]], factors)


def _told(
    lens: LensSystem, needs: Sequence[int], mine: Mapping[int, SurfaceRow], found: SemiDiameters
) -> list[ReportLine]:
    """Report on computed clear apertures, clear apertures of the file's program, and lost light."""
    if not needs:
        return []
    text = ", ".join(f"{mine[i].number}: {lens.surfaces[i].semi_diameter_mm:.5g}" for i in needs)
    drawn = {i: mine[i].drawn_mm for i in needs if mine[i].drawn_mm}
    apart = {i: float(found.semi_diameter_mm[i]) / d - 1.0 for i, d in drawn.items() if d}
    said = ""
    if apart:
        worst = max(apart, key=lambda i: abs(apart[i]) if np.isfinite(apart[i]) else np.inf)
        within = max(100 * abs(apart[worst]), 1e-6)
        said = f"; within {within:.2g} % of what the file's program drew"
        if not abs(apart[worst]) < DRAWN_APART:
            said = f"; the file's program shows other values: surface {mine[worst].number}: {drawn[worst]:.5g} mm"
    notes = [
        _note(0, "clear apertures", f"not stated, as wide as the light of the file's fields needs [mm]: {text}{said}")
    ]
    if found.lost or found.dark:
        dark = f"no light of field {', '.join(str(i + 1) for i in found.dark)} passes the stop; " if found.dark else ""
        notes.append(
            _note(
                0, "fields", f"{dark}{found.lost} of {found.rays} marginal rays miss a surface or are totally reflected"
            )
        )
    return notes


def _uncrossed(
    lens: LensSystem,
    tables: dict[str, Any],
    mine: Mapping[int, SurfaceRow],
    found: SemiDiameters,
    notes: list[ReportLine],
) -> tuple[LensSystem, dict[str, Any]]:
    """Clear apertures closed to what light needs where surfaces meet beyond it only; told in ``notes``."""
    for crossing in crossings(lens):
        used = [float(found.semi_diameter_mm[i]) for i in crossing.surfaces]
        if not min(used) < crossing.from_mm:
            continue
        before = {i: lens.surfaces[i].semi_diameter_mm for i in crossing.surfaces if i != lens.stop_index}
        stated = {i: before[i] for i, u in zip(crossing.surfaces, used, strict=True) if before.get(i, 0.0) > MARGIN * u}
        lens, tables = _closed(lens, tables, found, list(stated))
        for i, radius in stated.items():
            closed = f"closed to {lens.surfaces[i].semi_diameter_mm:.6g} mm, which the light of the file's fields needs"
            said = f"{radius:.6g} mm, where it would cross the adjacent surface; {closed}"
            notes.append(_note(mine[i].line, "clear aperture", said, mine[i].number))
    return lens, tables


def _with_glass_files(tables: dict[str, Any], folder: Path, where: str) -> dict[str, Any]:
    """The prescription with the numbers of the glasses that name a file: an AGF catalogue or refractiveindex.info's."""
    own = tables.get("glass")
    if not isinstance(own, Mapping):
        return tables  # said elsewhere
    found = {}
    for name, table in own.items():
        if not isinstance(table, Mapping) or "file" not in table:
            continue
        for key, value in table.items():
            if key not in ("file", "name"):
                raise ConfigError(f"{where}: glass.{name}.{key} is not allowed together with file; only name is")
            if not isinstance(value, str):
                raise ConfigError(f"{where}: glass.{name}.{key} = {value!r}: text is needed, in quotation marks")
        try:
            found[name] = glass_table(read_glass(folder / table["file"], table.get("name", name)))
        except StarbenchError as error:
            raise ConfigError(f"{where}: glass.{name}.file: {error}") from None
    return {**tables, "glass": {**own, **found}} if found else tables


def _check_glasses(tables: Mapping[str, Any], where: str) -> None:
    """Refuse tables of glasses that no surface names, and such that hide a glass of the catalogue."""
    own, surfaces = tables.get("glass", {}), tables.get("surface", [])
    if not (isinstance(own, Mapping) and isinstance(surfaces, list)):
        return  # said elsewhere
    named = {s.get("medium") for s in surfaces if isinstance(s, Mapping)}
    for name in own:
        if name not in named:
            raise ConfigError(f"{where}: no surface is of glass.{name}; leave the table out or name it as a medium")
        if name in list_glasses():
            raise ConfigError(
                f"{where}: glass.{name} has the name of a catalogue glass; choose another name, such as '{name}-melt'"
            )
