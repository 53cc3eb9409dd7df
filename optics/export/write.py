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
    path = Path(path)
    suffix = path.suffix.lower()
    texts: dict[Path, str] = {}
    if suffix == ".toml":
        for fault in geometry_faults(file.lens):
            raise ConfigError(f"{path}: {fault} (allowed in .zmx and .seq, not in .toml: write one of these)")
        texts[path] = toml_lens(file.tables)
    elif suffix in (".zmx", ".seq"):
        sequenced = sequence(file)
        catalogue = "".join(c if c.isalnum() else "_" for c in path.stem).upper()
        if sequenced.file_glasses:
            texts[path.with_name(f"{catalogue}.AGF")] = agf_text(sequenced.file_glasses, f"glasses of {path.name}")
        if suffix == ".zmx":
            texts[path] = zmx_text(
                file, sequenced, (*([catalogue] if sequenced.file_glasses else []), *sequenced.catalogues)
            )
        else:
            texts[path] = seq_text(file, sequenced, catalogue, _entrance_pupil(file))
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
    lines = [f"{toml_key(key)} = {toml_value(value)}" for key, value in tables.items() if not _is_tables(value)]
    for key, value in tables.items():
        if not _is_tables(value):
            continue
        if not isinstance(value, Mapping):
            blocks = [(f"[[{toml_key(key)}]]", table) for table in value]
        elif value and all(isinstance(table, Mapping) for table in value.values()):
            blocks = [(f"[{toml_key(key)}.{toml_key(name)}]", table) for name, table in value.items()]
        else:
            blocks = [(f"[{toml_key(key)}]", value)]
        for head, table in blocks:
            lines += ["", head, *(f"{toml_key(k)} = {toml_value(v)}" for k, v in table.items() if v is not None)]
    return "\n".join(lines) + "\n"


def _is_tables(value: Any) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list | tuple) and bool(value) and all(isinstance(v, Mapping) for v in value)
    )
