"""Text files in any encoding, of this and other programs; faults are one-line errors."""

from __future__ import annotations

import codecs
import math
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from optics.errors import ConfigError

LARGEST_BYTES = 32 * 2**20
"""Lens files have kilobytes, glass catalogues up to some megabytes."""

_INVALID = ("\ufffd", *(chr(c) for c in range(32) if chr(c) not in "\t\n\r\f\x1a"))
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


@dataclass(frozen=True, slots=True)
class TextFile:
    """Lines of a text file, without their ends, and the encoding they were read with."""

    lines: tuple[str, ...]
    encoding: str


def read_text(path: str | Path, what: str) -> TextFile:
    """Read a text file in UTF-8, UTF-16, UTF-32 (with or without a byte order mark) or ISO-8859-1."""
    if "\0" in str(path):
        raise ConfigError(f"{str(path)!r}: a file name cannot hold a NUL character")
    file = Path(path)
    try:
        if not file.exists():
            raise ConfigError(f"{path}: no such file")
        if not file.is_file():
            raise ConfigError(f"{path}: not a regular file; {what} is needed")
        size = file.stat().st_size
        if size > LARGEST_BYTES:
            raise ConfigError(
                f"{path}: {size / 2**20:.0f} MiB are too many for {what}; at most {LARGEST_BYTES // 2**20} MiB are read"
            )
        data = file.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from None
    if not data.strip():
        raise ConfigError(f"{path}: the file is empty")
    encoding = _encoding(data)
    text = data.decode(encoding, errors="replace")
    invalid = sum(text.count(c) for c in _INVALID)
    if invalid > 0.01 * len(text):
        raise ConfigError(f"{path}: not a text file ({invalid} of {len(text)} characters are invalid in {encoding})")
    text = text.replace("\0", " ").replace("\r\n", "\n").replace("\r", "\n")
    return TextFile(lines=tuple(text.split("\n")), encoding=encoding)


def _encoding(data: bytes) -> str:
    for mark, name in _MARKS:
        if data.startswith(mark):
            return name
    head = data[:4096]
    even, odd = head[0::2].count(0), head[1::2].count(0)
    if odd > 0.4 * len(head) / 2 > even:
        return "utf-16-le"
    if even > 0.4 * len(head) / 2 > odd:
        return "utf-16-be"
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return "iso-8859-1"
    return "utf-8"


def two_columns(
    lines: Sequence[str], shown: str, needed: str
) -> tuple[list[tuple[int, list[str]]], list[tuple[float, float]]]:
    """Heads (number of the line, its cells) and rows of two numbers, separated by commas, semicolons or blanks.

    Lines that begin with ``#`` and further columns are left out; a line of words among the numbers is an error.
    """
    heads: list[tuple[int, list[str]]] = []
    rows: list[tuple[float, float]] = []
    for number, line in enumerate(lines, start=1):
        cells = [cell for cell in re.split(r"[;,\s]+", line.strip()) if cell]
        if not cells or cells[0].startswith("#"):
            continue
        try:
            first, second = map(float, cells[:2])
        except ValueError:
            if rows:
                raise ConfigError(f"{shown}, line {number}: {line.strip()!r}: {needed} are needed") from None
            heads.append((number, cells))
            continue
        if not (math.isfinite(first) and math.isfinite(second)):
            raise ConfigError(f"{shown}, line {number}: {line.strip()!r}: a number is NaN or infinite")
        rows.append((first, second))
    return heads, rows


def write_text(path: str | Path, text: str) -> Path:
    """Write a text file in UTF-8, the same bytes on every system; it appears complete or not at all."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_text(text, encoding="utf-8", newline="\n")
        os.replace(temporary, path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        with suppress(OSError):
            temporary.unlink()
    return path


def toml_key(key: str) -> str:
    """A key as TOML, quoted where it has to be."""
    return key if key and all(c.isascii() and (c.isalnum() or c in "_-") for c in key) else toml_value(key)


def toml_value(value: Any) -> str:
    """A number, text, truth value, list or table of them as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        inner = ", ".join(f"{toml_key(k)} = {toml_value(v)}" for k, v in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in escaped) + '"'
    if isinstance(value, int):
        return str(value)
    number = float(value)
    return repr(number) if math.isfinite(number) else ("nan" if math.isnan(number) else f"{'-' * (number < 0)}inf")
