"""Writer of a lens as TOML, .zmx or .seq, chosen by the file suffix."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from optics.errors import ConfigError
from optics.export.seq import seq_text
from optics.export.sequence import agf_text, sequence
from optics.export.zmx import zmx_text
from optics.lens.geometry import geometry_faults
from optics.lens.measured import MeasuredLens, measured_table
from optics.lens_file import LensFile
from optics.rays.paraxial import axial_paraxial
from optics.textfile import toml_key, toml_value, write_text


def write_lens(file: LensFile, path: str | Path) -> tuple[Path, ...]:
    """Write a lens file; read again it gives the same rays."""
    place = Path(path)
    suffix = place.suffix.lower()
    texts: dict[Path, str] = {}
    if suffix == ".toml":
        for fault in geometry_faults(file.lens):
            raise ConfigError(f"{path}: {fault} (allowed in .zmx and .seq, not in .toml: write one of these)")
        texts[place] = toml_lens(file.tables)
    elif suffix in (".zmx", ".seq"):
        made = sequence(file)
        catalogue = "".join(c if c.isalnum() else "_" for c in place.stem).upper()
        if made.own:
            texts[place.with_name(f"{catalogue}.AGF")] = agf_text(made.own, f"glasses of {place.name}")
        if suffix == ".zmx":
            texts[place] = zmx_text(file, made, (*([catalogue] if made.own else []), *made.catalogues))
        else:
            texts[place] = seq_text(file, made, catalogue, _entrance_pupil(file))
    else:
        raise ConfigError(f"{path}: lenses are written as .toml, .zmx or .seq")
    return tuple(write_text(target, text) for target, text in texts.items())


def write_measured_lens(lens: MeasuredLens, path: str | Path) -> Path:
    """Write the file of a measured lens (`optics.lens.measured`), a ``.toml``; `load_lens` reads it."""
    if Path(path).suffix.lower() != ".toml":
        raise ConfigError(f"{path}: measured lenses are written as .toml")
    return write_text(path, toml_lens(measured_table(lens)))


def _entrance_pupil(file: LensFile) -> float:
    """Diameter of the paraxial entrance pupil [mm]."""
    if file.defaults is not None and math.isfinite(file.defaults.entrance_pupil_mm):
        return file.defaults.entrance_pupil_mm
    radius = axial_paraxial(file.lens, file.lens.design_wavelength_nm).entrance_pupil_radius_mm
    if not math.isfinite(radius):
        raise ConfigError(f"lens {file.lens.name!r} is telecentric on the object side; .seq needs an entrance pupil")
    return 2.0 * radius


def toml_lens(tables: Mapping[str, Any]) -> str:
    """A prescription as TOML text."""
    plain = {k: v for k, v in tables.items() if not _is_tables(v)}
    lines = [f"{toml_key(key)} = {toml_value(value)}" for key, value in plain.items()]
    for key, value in tables.items():
        if isinstance(value, Mapping):
            inner = {k: v for k, v in value.items() if isinstance(v, Mapping)}
            if inner and len(inner) == len(value):
                for name, table in inner.items():
                    lines += ["", f"[{toml_key(key)}.{toml_key(name)}]", *_lines(table)]
            else:
                lines += ["", f"[{toml_key(key)}]", *_lines(value)]
        elif _is_tables(value):
            for table in value:
                lines += ["", f"[[{toml_key(key)}]]", *_lines(table)]
    return "\n".join(lines) + "\n"


def _is_tables(value: Any) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list | tuple) and bool(value) and all(isinstance(v, Mapping) for v in value)
    )


def _lines(table: Mapping[str, Any]) -> list[str]:
    return [f"{toml_key(key)} = {toml_value(value)}" for key, value in table.items() if value is not None]
