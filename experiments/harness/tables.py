"""Result tables: one record for terminal, report and ECSV file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.harness.summary import Measured
from optics.errors import DomainError

if TYPE_CHECKING:
    import astropy.table
    import rich.console

Cell = str | bool | int | float | Measured | None

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# Displayed unit -> astropy's name
_UNIT_NAMES = {
    "px": "pix",
    "px²": "pix2",
    "e⁻": "electron",
    "e-": "electron",
    "DN": "adu",
    "″": "arcsec",
    '"': "arcsec",
    "°": "deg",
    "µm": "um",
    "μm": "um",
    "σ": "",
    "sigma": "",
    "%": "percent",
    "°/s": "deg/s",
    "°/s²": "deg/s2",
    "s²": "s2",
    "10⁻⁶/K": "1e-6/K",
}
_TELEPHONE_LETTERS = 50
"""Letters in a line of a table, 354 px wide."""
_MINUS = "\N{MINUS SIGN}"
_NOTHING = "\N{EN DASH}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column of a `Table`."""

    name: str  # Heading
    unit: str = ""  # Displayed under the heading
    key: str = ""  # Column name in the ECSV file; default: from name and unit
    # Format of plain floats, e.g. ".3f"; default: four significant digits. `Measured` values follow their uncertainty
    format: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows under headed columns."""

    columns: Sequence[Column | str]  # A bare string is a column without unit
    # Cells: text, number, bool, `Measured` (value ± uncertainty), or None for an empty cell
    rows: Sequence[Sequence[Cell]]
    caption: str = ""
    note: str = ""  # Small print under the table: kind of the uncertainties, sample size

    def __post_init__(self) -> None:
        columns = tuple(Column(name=column) if isinstance(column, str) else column for column in self.columns)
        object.__setattr__(self, "columns", columns)
        object.__setattr__(self, "rows", tuple(tuple(row) for row in self.rows))
        for number, row in enumerate(self.rows):
            if len(row) != len(columns):
                raise DomainError(
                    f"Table {self.caption!r}: row {number} has {len(row)} cells where {len(columns)} are needed"
                )

    @property
    def heads(self) -> tuple[Column, ...]:
        """The columns, all as `Column`."""
        return tuple(column for column in self.columns if isinstance(column, Column))

    @property
    def wide(self) -> bool:
        """Whether a telephone cannot show all columns, so that rows fold, every value with the head of its column.

        Lines break between words: a column is as wide as its longest word.
        """
        letters = 0
        for index, head in enumerate(self.heads):
            texts = [cell_text(row[index], head.format) for row in self.rows]
            texts = texts if self.numeric(index) else [word for text in texts for word in text.split()]
            letters += max(map(len, [*head.name.split(), head.unit, *texts]), default=0) + 2
        return letters > _TELEPHONE_LETTERS

    def numeric(self, index: int) -> bool:
        """Whether column ``index`` holds numbers only, and is set flush right."""
        cells = [row[index] for row in self.rows if row[index] is not None]
        return bool(cells) and not any(isinstance(cell, (str, bool, np.bool_)) for cell in cells)


def cell_text(cell: Any, format_spec: str = "") -> str:
    """A cell as displayed: real minus signs, powers of ten, value ± uncertainty, a dash for nothing."""
    match cell:
        case None:
            return ""
        case str():
            return cell
        case bool() | np.bool_():
            return "yes" if cell else "no"
        case Measured():
            return _measured(cell)
        case int() | np.integer():
            return f"{int(cell):,}".replace(",", "\N{THIN SPACE}").replace("-", _MINUS)
    value = float(cell)
    return _typeset(format(value, format_spec)) if format_spec and math.isfinite(value) else significant(value, 4)


def to_astropy(table: Table) -> astropy.table.Table:
    """The table in full precision, with units and a column ``KEY_error`` for cells with an uncertainty."""
    from astropy.table import Column as AstropyColumn
    from astropy.table import Table as AstropyTable

    result = AstropyTable(meta={"caption": table.caption, "note": table.note})
    for index, column in enumerate(table.heads):
        cells = [row[index] for row in table.rows]
        key = column.key or "_".join(re.findall(r"[a-z0-9]+", f"{column.name} {column.unit}".lower()))
        unit = _astropy_unit(column.unit)
        values = [cell.value if isinstance(cell, Measured) else cell for cell in cells]
        empty = math.nan if table.numeric(index) else ""
        result[key] = AstropyColumn([empty if value is None else value for value in values], unit=unit)
        if any(isinstance(cell, Measured) and cell.uncertainty is not None for cell in cells):
            errors = [getattr(cell, "uncertainty", None) for cell in cells]
            errors = [math.nan if error is None else error for error in errors]
            result[f"{key}_error"] = AstropyColumn(errors, unit=unit, description="1 sigma")
    return result


def write_ecsv(table: Table | astropy.table.Table, path: Path) -> None:
    """Write an ECSV file, which astropy, TOPCAT and any CSV reader that skips ``#`` can read."""
    columns = to_astropy(table) if isinstance(table, Table) else table
    # Importing colour-science switches NumPy's printing to its 1.13 style, 12 digits, which astropy then writes
    with np.printoptions(legacy=False):
        columns.write(path, format="ascii.ecsv", delimiter=",")


def to_rich(table: Table, width: int = 80) -> rich.console.Group:
    """The table for a terminal; if it is too wide, parts below each other that repeat the first columns."""
    from rich import box
    from rich.console import Group
    from rich.table import Table as RichTable
    from rich.text import Text

    heads = [f"{column.name} [{column.unit}]" if column.unit else column.name for column in table.heads]
    cells = [
        [cell_text(cell, column.format) for cell, column in zip(row, table.heads, strict=True)] for row in table.rows
    ]
    parts = []
    for widths in _parts(table, heads, cells, width):
        part = RichTable(box=box.SIMPLE_HEAD, pad_edge=False)
        for index, letters in widths.items():
            part.add_column(Text(heads[index]), justify="right" if table.numeric(index) else "left", width=letters)
        for row in cells:
            part.add_row(*(Text(row[index]) for index in widths))
        parts.append(part)
    note = [Text(re.sub("[`*]", "", table.note), style="dim")] if table.note else []
    return Group(Text(table.caption, style="bold"), *parts, *note)


def _parts(table: Table, heads: Sequence[str], cells: Sequence[Sequence[str]], width: int) -> list[dict[int, int]]:
    """Columns of each part, with their widths: numbers stay on one line, words of texts and heads break."""
    columns = range(len(heads))
    texts = [[row[k] for row in cells] for k in columns]
    words = [[word for text in texts[k] for word in text.split()] for k in columns]
    full, least = (
        [max(map(len, (*heads[k].split(), *chosen[k])), default=1) for k in columns]
        for chosen in (texts, [texts[k] if table.numeric(k) else words[k] for k in columns])
    )

    def spare(widths: Iterable[int]) -> int:
        return width + 1 - sum(letters + 3 for letters in widths)

    first = next((k for k in columns if table.numeric(k)), 0) or 1
    parts = [list(columns[:first])]
    for k in columns[first:]:
        if len(parts[-1]) > first and spare(least[n] for n in (*parts[-1], k)) < 0:
            parts.append(list(columns[:first]))
        parts[-1].append(k)
    fitted = [{k: full[k] for k in part} for part in parts]
    for widths in fitted:
        while spare(widths.values()) < 0 and (narrower := [k for k in widths if widths[k] > least[k]]):
            widths[max(narrower, key=widths.__getitem__)] -= 1
    return fitted


def _astropy_unit(displayed: str) -> Any:
    """astropy's unit for a displayed one; an unknown one stays text."""
    from astropy.units import Unit

    return Unit(_UNIT_NAMES.get(displayed, displayed), parse_strict="silent") if displayed else None


def _typeset(text: str) -> str:
    """Real minus signs and powers of ten; no minus before a number that was rounded to zero."""
    text = re.sub(r"-(?=0(\.0*)?(?![\d.]))", "", text)
    mantissa, power, exponent = text.partition("e")
    if power:
        return f"{mantissa}×10{str(int(exponent)).translate(_SUPERSCRIPT)}".replace("-", _MINUS)
    return text.replace("-", _MINUS)


def significant(value: float, digits: int) -> str:
    """A number with a number of significant digits, set as in tables."""
    if not math.isfinite(value):
        return _NOTHING if math.isnan(value) else ("∞" if value > 0 else f"{_MINUS}∞")
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 6:
        return _typeset(f"{value:.{max(0, digits - 1 - exponent)}f}")
    return _typeset(f"{value:.{digits - 1}e}")


def _measured(cell: Measured) -> str:
    error = cell.uncertainty
    if not math.isfinite(cell.value):
        return _NOTHING
    if error is None or not math.isfinite(error) or error <= 0:
        return significant(cell.value, 4)
    last = math.floor(math.log10(error)) - 1  # two significant digits of the uncertainty
    if float(f"{error:.1e}") >= 10.0 ** (last + 2):
        last += 1
    leading = math.floor(math.log10(max(abs(cell.value), error)))
    if -4 <= leading < 6 and last <= 0:
        return _typeset(f"{cell.value:.{-last}f} ± {error:.{-last}f}")
    scale = 10.0**leading
    places = max(0, leading - last)
    power = f"×10{str(leading).translate(_SUPERSCRIPT)}"
    return _typeset(f"({cell.value / scale:.{places}f} ± {error / scale:.{places}f})") + power
