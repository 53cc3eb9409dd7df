"""Reading of lens files. Content, not the file name, decides between Zemax and CODE V."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from optics.errors import ConfigError, StarbenchError
from optics.files.assemble import Imported, assemble
from optics.files.parsed_file import ParsedFile
from optics.files.seq import read_seq
from optics.files.zmx import read_zmx
from optics.textfile import TextFile, read_text

SUFFIXES = (".zmx", ".seq")
"""Endings of the lens files of other programs that are read."""
_CLOSED = {
    ".zmf": "an encrypted or binary stock-lens catalogue", ".zbb": "an encrypted black box", ".zar": "an archive",
    ".len": "a binary lens file of CODE V; save it as .seq", ".zos": "a binary file; save it as .zmx",
    ".otx": "a lens file of another program", ".osl": "a lens file of another program",
}  # fmt: skip
FOREIGN = (*SUFFIXES, *_CLOSED)
"""Endings of lens files of other programs, read or refused."""
MOST_LINES = 200_000


def split_configuration(name: str) -> tuple[str, int | None]:
    """Path and configuration of ``zoom.zmx#2``."""
    head, mark, tail = name.rpartition("#")
    if mark and tail.isascii() and tail.isdigit() and head.lower().endswith(SUFFIXES):
        return head, int(tail)
    return name, None


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """Options of reading; fields as in `optics.lens_file.read_lens_file`."""

    configuration: int | None = None
    catalogues: tuple[Path, ...] = ()
    glasses: Mapping[str, str] = field(default_factory=dict)
    strict: bool = False


def import_lens(path: Path, reading: Reading = Reading()) -> Imported:
    """Read a Zemax or CODE V file as a prescription."""
    if path.suffix.lower() in _CLOSED:
        raise ConfigError(f"{path}: {_CLOSED[path.suffix.lower()]}; .zmx, .seq and .toml are read")
    text = read_text(path, "a lens file")
    if len(text.lines) > MOST_LINES:
        raise ConfigError(
            f"{path}: {len(text.lines)} lines are too many for a lens file; at most {MOST_LINES} are read"
        )
    try:
        imported = assemble(_parsed(path, text, reading.configuration), reading.catalogues, reading.glasses)
    except StarbenchError as error:
        folder = f"{path.parent}/" if str(path.parent) != "." else ""
        raise type(error)("\n".join(folder + line for line in str(error).split("\n"))) from None
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        raise ConfigError(f"{path}: its numbers do not define a lens ({error})") from None
    if reading.strict:
        imported.report.require_exact()
    return imported


def _parsed(path: Path, text: TextFile, configuration: int | None) -> ParsedFile:
    firsts = [line.split()[0].upper() for line in text.lines if line.strip()]
    zemax, codev = (sum(word in words for word in firsts) for words in (("SURF", "CURV", "DISZ"), ("S", "SO", "SI")))
    suffix = path.suffix.lower()
    if zemax > codev or (zemax == codev and suffix == ".zmx"):
        return read_zmx(path, text, configuration)
    if codev or suffix == ".seq":
        return read_seq(path, text, configuration)
    raise ConfigError(f"{path.name}: neither a Zemax (.zmx) nor a CODE V (.seq) lens")
