"""Lens files of all formats, with a report on every line and the file's settings that are not part of the lens.

Clear apertures missing in the file are computed by ray trace: as wide as the light of the whole field needs. The
geometry is then checked (`optics.lens.geometry`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
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
"""Ratio of a computed clear aperture to the heights of the marginal rays that were traced (`SemiDiameters`)."""
TOML_FIELDS = (0.0, 0.7, 1.0)
TOML_WAVES = (0.85, 1.0, 1.2)
"""Fractions of half field and design wavelength whose light has to pass where a TOML file states no rim."""
DRAWN_DIFFERENCE = 0.02
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
        Glass catalogues (AGF); those in the folder of the file are used too.
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
    """A TOML file."""
    tables = read_toml(path)
    if tables.get("kind") == "measured":
        return LensFile(lens=measured_lens(measured_from_table(tables, where)), tables=tables)
    _check_glasses(tables, where)
    tables = _with_glass_files(tables, path.parent, where)
    lens = lens_from_table(tables, where=where, folder=path.parent, environment=environment or CATALOGUE_AIR)
    prescription = _Prescription(lens, tables)
    if prescription.open():
        azimuths = [(f * c, f * s) for f in TOML_FIELDS[1:] for c, s in ((0, 1), (1, 0), (0, -1), (-1, 0))]
        waves = np.clip(np.array(TOML_WAVES) * lens.design_wavelength_nm, *lens.wavelength_range_nm)
        with suppress(StarbenchError):  # where no light passes, they stay open
            prescription.close(beam_semi_diameters(lens, np.array([(0.0, 0.0), *azimuths]) * lens.max_field_deg, waves))
    _refuse(geometry_faults(prescription.lens), where)
    return LensFile(lens=prescription.lens, tables=prescription.tables)


def _refuse(faults: Sequence[str], where: str) -> None:
    if faults:
        raise ConfigError("\n".join(f"{where}: {fault}" for fault in faults))


@dataclass(slots=True)
class _Prescription:
    """A lens and its tables while clear apertures missing in its file are computed; ``notes`` for the report.

    ``rows`` are the surfaces of the file of a design program by their number in the lens.
    """

    lens: LensSystem
    tables: dict[str, Any]
    rows: dict[int, SurfaceRow] = field(default_factory=dict)
    notes: list[ReportLine] = field(default_factory=list)

    def note(self, command: str, message: str, surface: int | None = None) -> None:
        """A line of the report about a surface, or about what the file does not state."""
        row = None if surface is None else self.rows[surface]
        self.notes.append(_note(command, message, row))

    def numbers(self) -> list[int]:
        """Number in the lens of the surface that each table makes, -1 for a coordinate break."""
        alone = self.lens.stop_index if self.tables.get("stop") else len(self.lens.surfaces)
        free = iter(i for i in range(len(self.lens.surfaces)) if i != alone)
        return [-1 if table.get("kind") == BREAK else next(free) for table in self.tables["surface"]]

    def open(self) -> list[int]:
        """Surfaces of glass and mirrors without any clear aperture; planes that only help to count have no rim."""
        return [
            i
            for i, surface in enumerate(self.lens.surfaces)
            if np.isinf(surface.semi_diameter_mm) and not surface.apertures and acts(self.lens, i)
        ]

    def set_rims(self, radius_mm: Mapping[int, float]) -> None:
        """Replace clear apertures of surfaces."""
        surfaces = {i: replace(self.lens.surfaces[i], semi_diameter_mm=radius) for i, radius in radius_mm.items()}
        tables = [
            {**table, "semi_diameter_mm": radius_mm[i]} if i in radius_mm else table
            for i, table in zip(self.numbers(), self.tables["surface"], strict=True)
        ]
        self.lens, self.tables = self.lens.with_surfaces(surfaces), {**self.tables, "surface": tables}

    def close(self, widths: SemiDiameters, surfaces: Sequence[int] | None = None) -> None:
        """Give surfaces the clear apertures that light needs, if left out the ones that have none."""
        radius_mm = {}
        for i in self.open() if surfaces is None else surfaces:
            surface, widest = self.lens.surfaces[i], float(widths.semi_diameter_mm[i])
            if widest > surface.inner_semi_diameter_mm:
                radius_mm[i] = min(MARGIN * widest, 0.5 * (widest + surface.shape.rim_mm))
        self.set_rims(radius_mm)

    def take_drawn(self) -> None:
        """Clear apertures of a lens with a near object: as its program computed them for light from there."""
        drawn = {}
        for i in self.open():
            surface, radius = self.lens.surfaces[i], self.rows[i].drawn_mm or 0.0
            if surface.inner_semi_diameter_mm < radius < surface.shape.rim_mm:
                drawn[i] = radius
        if drawn:
            text = ", ".join(f"{self.rows[i].number}: {radius:.5g}" for i, radius in drawn.items())
            message = f"not stated, as the file's program drew them for its near object [mm]: {text}"
            self.note("clear apertures", message)
        others = ", ".join(str(self.rows[i].number) for i in self.open() if i not in drawn)
        if others:
            self.note("clear apertures", f"surfaces without any, for a near object: {others}: left open")
        self.set_rims(drawn)

    def take_needed(self, defaults: FileDefaults) -> None:
        """Clear apertures as wide as the light of the file's fields and wavelengths needs."""
        try:
            widths = _file_widths(self.lens, defaults)
        except StarbenchError as error:
            self.note("clear apertures", f"left open where the file states none: {error}")
            return
        missing = self.open()
        self.close(widths)
        if missing:
            self._report_needed(missing, widths)
        self._uncross(widths)

    def _report_needed(self, surfaces: Sequence[int], widths: SemiDiameters) -> None:
        """Computed clear apertures, compared with those that the file's program drew, and lost light."""
        rows = self.rows
        text = ", ".join(f"{rows[i].number}: {self.lens.surfaces[i].semi_diameter_mm:.5g}" for i in surfaces)
        drawn = {i: radius for i in surfaces if (radius := rows[i].drawn_mm)}
        difference = {i: float(widths.semi_diameter_mm[i]) / radius - 1.0 for i, radius in drawn.items()}
        comparison = ""
        if difference:
            worst = max(difference, key=lambda i: abs(difference[i]) if np.isfinite(difference[i]) else np.inf)
            percent = max(100 * abs(difference[worst]), 1e-6)
            comparison = f"; within {percent:.2g} % of what the file's program drew"
            if not abs(difference[worst]) < DRAWN_DIFFERENCE:
                drawn_text = f"surface {rows[worst].number}: {drawn[worst]:.5g} mm"
                comparison = f"; the file's program shows other values: {drawn_text}"
        message = f"not stated, as wide as the light of the file's fields needs [mm]: {text}{comparison}"
        self.note("clear apertures", message)
        if widths.lost or widths.dark:
            fields = ", ".join(str(i + 1) for i in widths.dark)
            dark = f"no light of field {fields} passes the stop; " if widths.dark else ""
            lost = f"{widths.lost} of {widths.rays} marginal rays miss a surface or are totally reflected"
            self.note("fields", dark + lost)

    def _uncross(self, widths: SemiDiameters) -> None:
        """Close clear apertures to what light needs where surfaces meet outside the light."""
        for crossing in crossings(self.lens):
            needed = {i: float(widths.semi_diameter_mm[i]) for i in crossing.surfaces}
            if not min(needed.values()) < crossing.from_mm:
                continue
            rims = {i: self.lens.surfaces[i].semi_diameter_mm for i in needed if i != self.lens.stop_index}
            wide = {i: radius for i, radius in rims.items() if radius > MARGIN * needed[i]}
            self.close(widths, list(wide))
            for i, radius in wide.items():
                closed_mm = self.lens.surfaces[i].semi_diameter_mm
                closed = f"closed to {closed_mm:.6g} mm, which the light of the file's fields needs"
                self.note("clear aperture", f"{radius:.6g} mm, where it would cross the adjacent surface; {closed}", i)


def _of_program(imported: Imported, path: Path, environment: Environment | None, strict: bool) -> LensFile:
    """A file of a design program; clear apertures that it leaves out are computed."""
    where, rows, defaults, tables = str(path), imported.rows, imported.defaults, imported.tables
    notes: list[ReportLine] = []
    labels = tuple(f"surface {row.number} (line {row.line})" for row in rows)
    if not strict:
        tables, notes = _within_surfaces(tables, rows, labels, where)
    lens = lens_from_table(
        tables, where=where, folder=path.parent, environment=environment or defaults.environment, labels=labels
    )
    prescription = _Prescription(lens, tables, notes=notes)
    prescription.rows = {i: row for i, row in zip(prescription.numbers(), rows, strict=True) if i >= 0}
    near = not strict and bool(np.isfinite(defaults.object_mm))
    if near:
        prescription.take_drawn()
    elif not strict:
        prescription.take_needed(defaults)
    lens = prescription.lens
    accepted = idle_stop(lens)
    for fault in accepted:
        prescription.note("stop", fault, lens.stop_index)
    for crossing in crossings(lens) if near else ():
        accepted.append(crossing.message)
        prescription.note("clear aperture", f"{crossing.message}; kept, as the object is near", crossing.surfaces[0])
    _refuse([fault for fault in geometry_faults(lens) if strict or fault not in accepted], where)
    lines = sorted((*imported.report.lines, *prescription.notes), key=lambda line: line.line)
    report = replace(imported.report, lines=tuple(lines))
    return LensFile(lens=lens, tables=prescription.tables, report=report, defaults=defaults, labels=labels)


def _note(command: str, message: str, row: SurfaceRow | None) -> ReportLine:
    line, surface = (0, None) if row is None else (row.line, row.number)
    return ReportLine(line, command, surface, Status.APPROXIMATED, message, harmless=False)


def _within_surfaces(
    tables: dict[str, Any], rows: Sequence[SurfaceRow], labels: Sequence[str], where: str
) -> tuple[dict[str, Any], list[ReportLine]]:
    """The prescription without clear apertures that reach beyond the rim where their surface ends."""
    rims, notes, surfaces = rims_mm(tables, where, labels), [], []
    for table, row, rim in zip(tables["surface"], rows, rims, strict=True):
        radius = table.get("semi_diameter_mm", 0.0)
        if radius >= rim and not row.stop:
            reach = f"{radius:.6g} mm reaches beyond the rim where the surface ends, {rim:.6g} mm"
            notes.append(_note("clear aperture", f"{reach}: replaced by the radius that light needs", row))
            table = {k: v for k, v in table.items() if k != "semi_diameter_mm"}  # noqa: PLW2901
        surfaces.append(table)
    return {**tables, "surface": surfaces}, notes


def _file_widths(lens: LensSystem, defaults: FileDefaults) -> SemiDiameters:
    """Widths of the file's own light: its fields with their vignetting factors, its wavelengths from first to last."""
    fields = defaults.field_deg if len(defaults.field_deg) else np.zeros((1, 2))
    factors = defaults.vignetting if len(defaults.vignetting) else None
    low, high = lens.wavelength_range_nm
    waves = defaults.wavelength_nm[(defaults.wavelength_nm >= low) & (defaults.wavelength_nm <= high)]
    return beam_semi_diameters(lens, fields, np.unique([*waves, lens.design_wavelength_nm])[[0, -1]], factors)


def _with_glass_files(tables: dict[str, Any], folder: Path, where: str) -> dict[str, Any]:
    """The prescription with the numbers of the glasses that name a file: an AGF catalogue or refractiveindex.info's."""
    glasses = tables.get("glass")
    if not isinstance(glasses, Mapping):
        return tables  # refused by the prescription
    read = {}
    for name, table in glasses.items():
        if not isinstance(table, Mapping) or "file" not in table:
            continue
        for key, value in table.items():
            if key not in ("file", "name"):
                raise ConfigError(f"{where}: glass.{name}.{key} is not allowed together with file; only name is")
            if not isinstance(value, str):
                raise ConfigError(f"{where}: glass.{name}.{key} = {value!r}: text is needed, in quotation marks")
        try:
            read[name] = glass_table(read_glass(folder / table["file"], table.get("name", name)))
        except StarbenchError as error:
            raise ConfigError(f"{where}: glass.{name}.file: {error}") from None
    return {**tables, "glass": {**glasses, **read}} if read else tables


def _check_glasses(tables: Mapping[str, Any], where: str) -> None:
    """Refuse tables of glasses that no surface names or that hide a glass of the catalogue."""
    glasses, surfaces = tables.get("glass", {}), tables.get("surface", [])
    if not (isinstance(glasses, Mapping) and isinstance(surfaces, list)):
        return  # refused by the prescription
    named = {s.get("medium") for s in surfaces if isinstance(s, Mapping)}
    for name in glasses:
        if name not in named:
            raise ConfigError(f"{where}: no surface is of glass.{name}; leave the table out or name it as a medium")
        if name in list_glasses():
            raise ConfigError(
                f"{where}: glass.{name} has the name of a catalogue glass; choose another name, such as '{name}-melt'"
            )
