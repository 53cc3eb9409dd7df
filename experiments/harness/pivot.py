"""Tables from quantities by dimensions in rows and columns; heads, units and formats come from the quantities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from experiments.harness.quantities import Quantity, positions, shown_unit
from experiments.harness.tables import Cell, Column, Table
from optics.errors import DomainError

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, slots=True, kw_only=True)
class Pivot:
    """Layout of a table of quantities."""

    columns: str  # Quantities, one column each, e.g. "dark_arcsec raw_arcsec"
    # Dimensions that run down, the last one fastest, each with a column of its coordinates, or of numbers 1, 2, 3 ...
    # where it has none; "" makes a single row
    rows: str = ""
    across: str = ""  # Dimensions that are spread over columns: quantity "sigma" with labels x, y becomes "σ x", "σ y"
    hidden: str = ""  # Dimensions of ``rows`` whose coordinates get no column
    plain: str = ""  # Quantities of ``columns`` that are shown without their uncertainty
    # Dimension -> the coordinates that are shown, all of them for the others; or the one that the table is of, and
    # the dimension needs no place in it
    where: Mapping[str, Sequence[Any] | str] = field(default_factory=dict)
    # Key of a column -> the name, unit, key or format that it has in this table instead of the quantity's own
    heads: Mapping[str, Column] = field(default_factory=dict)
    caption: str = ""  # See `experiments.harness.tables.Table`
    note: str = ""


def pivot(data: xr.Dataset, spec: Pivot) -> Table:
    """The table of a specification."""
    rows, across = spec.rows.split(), spec.across.split()
    data = data.sel({dim: shown if isinstance(shown, str) else list(shown) for dim, shown in spec.where.items()})
    quantities = [Quantity.of(data, name) for name in spec.columns.split()]
    quantities = [replace(one, error=None, n=None) if one.name in spec.plain.split() else one for one in quantities]
    for one in quantities:
        left = [dim for dim in one.dims if dim not in (*rows, *across)]
        if left:
            raise DomainError(f"quantity {one.name!r} runs along {', '.join(left)} too; name it in rows or across")
    heads = [_head(data, dim) for dim in rows if dim not in spec.hidden.split()]
    spread = _spread(data, across, quantities)
    columns = [*heads, *(_headed(column, spec.heads) for column, _, _ in spread)]
    body: list[tuple[Cell, ...]] = []
    for place in positions(data.sizes, rows):
        leading = [_coordinate(data, dim, place[dim]) for dim in rows if dim not in spec.hidden.split()]
        body.append((*leading, *(one.at(**place, **at).scalar() for _, one, at in spread)))
    return Table(columns=columns, rows=body, caption=spec.caption, note=spec.note)


def _headed(column: Column, heads: Mapping[str, Column]) -> Column:
    own = heads.get(column.key, column)
    given = {part: getattr(own, part) for part in ("name", "unit", "key", "format") if getattr(own, part)}
    return replace(column, **given)


def _head(data: xr.Dataset, dim: str) -> Column:
    if dim not in data.coords:
        return Column(name=dim)
    one = Quantity.of(data, dim)
    key = data.coords[dim].attrs.get("key", "")
    return Column(name=one.label, unit=shown_unit(one.unit), format=one.format, key=key)


def _coordinate(data: xr.Dataset, dim: str, at: int) -> Any:
    label = f"{dim}_label"
    if label in data.coords:
        return str(data.coords[label].values[at])
    return data.coords[dim].values[at].item() if dim in data.coords else at + 1


def _spread(
    data: xr.Dataset, across: Sequence[str], quantities: Sequence[Quantity]
) -> list[tuple[Column, Quantity, Mapping[str, int]]]:
    """Column, quantity, and place along its spread dimensions; one column if it has none."""
    out: list[tuple[Column, Quantity, Mapping[str, int]]] = []
    for one in quantities:
        for place in positions(data.sizes, [dim for dim in across if dim in one.dims]):
            keys = {dim: str(data.coords[dim].values[at]).replace(" ", "_") for dim, at in place.items()}
            name = " ".join([one.label, *(str(_coordinate(data, dim, at)) for dim, at in place.items())])
            code = one.key.format(**keys) if "{" in one.key and keys else "_".join([one.key, *keys.values()])
            out.append((Column(name=name, unit=shown_unit(one.unit), key=code, format=one.format), one, place))
    return out
