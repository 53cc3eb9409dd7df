"""Lens files of any kind, with the report on what became of them and what they say beside the lens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from optics.errors import ConfigError
from optics.files.assemble import FileDefaults
from optics.files.read import SUFFIXES, import_lens, split_configuration
from optics.files.report import ImportReport
from optics.glass.media import Environment
from optics.lens.prescription import lens_from_table, lens_path, load_lens
from optics.lens.system import LensSystem
from optics.validate import read_toml

__all__ = ["LensFile", "read_lens_file"]


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
        What became of every line; None for a file of our own format.
    defaults : FileDefaults or None
        Fields, wavelengths, vignetting factors, aperture; None for a file of our own format.
    """

    lens: LensSystem
    tables: dict[str, Any]
    report: ImportReport | None = None
    defaults: FileDefaults | None = None


def read_lens_file(
    name_or_path: str | Path,
    *,
    environment: Environment | None = None,
    configuration: int | None = None,
    catalogues: Sequence[str | Path] = (),
    glasses: Mapping[str, str] | None = None,
    strict: bool = False,
) -> LensFile:
    """Read a lens file with all that is known of it.

    Parameters
    ----------
    name_or_path : str or path
        A Zemax (.zmx), CODE V (.seq) or TOML file, or a built-in name; ``zoom.zmx#2`` is its second configuration.
    environment : Environment, optional
        Temperature and pressure; those of the file if left out.
    configuration : int, optional
        Configuration or zoom position, from 1; the active one if left out.
    catalogues : sequence of path
        Glass catalogues (AGF); those beside the file are used too.
    glasses : mapping, optional
        Name in the file -> glass to take in its place.
    strict : bool
        Refuse whatever is not the same as in the file.

    Returns
    -------
    LensFile
        The lens, with the report of every line that was read, approximated or left out.

    Raises
    ------
    ConfigError
        One line per fault, with the line of the file.
    """
    name, marked = split_configuration(str(name_or_path))
    if not name.lower().endswith(SUFFIXES):
        if configuration is not None or catalogues or glasses:
            raise ConfigError(
                f"{name}: configurations, catalogues and glasses to replace belong to .zmx and .seq files"
            )
        return LensFile(lens=_in(name, environment), tables=read_toml(lens_path(name)))
    imported = import_lens(
        name,
        configuration=configuration if configuration is not None else marked,
        catalogues=catalogues,
        glasses=glasses,
        strict=strict,
    )
    lens = lens_from_table(
        imported.tables,
        where=name,
        folder=Path(name).parent,
        environment=environment or imported.defaults.environment,
    )
    return LensFile(lens=lens, tables=imported.tables, report=imported.report, defaults=imported.defaults)


def _in(name: str, environment: Environment | None) -> LensSystem:
    return load_lens(name) if environment is None else load_lens(name, environment=environment)
