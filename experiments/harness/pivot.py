"""Tables from quantities by dimensions in rows and columns; heads, units and formats come from the quantities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from experiments.harness.quantities import Quantity, positions, shown_unit
from experiments.harness.tables import Cell, Column, Table
from optics.errors import DomainError

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, slots=True, kw_only=True)
class Pivot:
    """Layout of a table of quantities."""

    columns: str  # Quantities, SECTION.FIELD, one column each, e.g. "star.dark_arcsec star.raw_arcsec"
    # Dimensions that run down, the last one fastest, each with a column of its coordinates, or of numbers 1, 2, 3 ...
    # where it has none; "" makes a single row
    rows: str = ""
    across: str = ""  # Dimensions that are spread over columns: quantity "sigma" with labels x, y becomes "σ x", "σ y"
    hidden: str = ""  # Dimensions of ``rows`` whose coordinates get no column
    # Dimension -> the coordinates that are shown, all of them for the others; or the one that the table is of, and
    # the dimension needs no column in it
    where: Mapping[str, Sequence[Any] | str] = field(default_factory=dict)
    section: str = ""  # Section of the table: ECSV columns are called FIELD, those of other sections SECTION.FIELD
    # Dimension -> ECSV column of its coordinates, where that is a field; by default the name of the dimension
    coordinates: Mapping[str, str] = field(default_factory=dict)
    caption: str = ""  # See `experiments.harness.tables.Table`
    note: str = ""


def pivot(data: xr.Dataset, spec: Pivot) -> Table:
    """The table of a specification."""
    rows, across = spec.rows.split(), spec.across.split()
    data = data.sel({dim: shown if isinstance(shown, str) else list(shown) for dim, shown in spec.where.items()})
    quantities = [Quantity.of(data, name) for name in spec.columns.split()]
    for quantity in quantities:
        missing = [dim for dim in quantity.dims if dim not in (*rows, *across)]
        if missing:
            raise DomainError(
                f"quantity {quantity.name!r} runs along {', '.join(missing)} too; name it in rows or across"
            )
    labelled = [dim for dim in rows if dim not in spec.hidden.split()]
    spread = _spread(data, across, quantities, spec.section)
    columns = [*(_head(data, dim, spec.coordinates.get(dim, dim)) for dim in labelled), *(part[0] for part in spread)]
    body: list[tuple[Cell, ...]] = []
    for index in positions(data.sizes, rows):
        leading = [_coordinate(data, dim, index[dim]) for dim in labelled]
        body.append((*leading, *(quantity.at(**index, **at).scalar() for _, quantity, at in spread)))
    return Table(columns=columns, rows=body, caption=spec.caption, note=spec.note)


def _head(data: xr.Dataset, dim: str, key: str) -> Column:
    if dim not in data.coords:
        return Column(name=dim)
    axis = Quantity.of(data, dim)
    return Column(name=axis.label, unit=shown_unit(axis.unit), format=axis.format, key=key)


def _coordinate(data: xr.Dataset, dim: str, at: int) -> Any:
    label = f"{dim}_label"
    if label in data.coords:
        return str(data.coords[label].values[at])
    return data.coords[dim].values[at].item() if dim in data.coords else at + 1


def _spread(
    data: xr.Dataset, across: Sequence[str], quantities: Sequence[Quantity], section: str
) -> list[tuple[Column, Quantity, Mapping[str, int]]]:
    """Column, quantity, and position along its spread dimensions; one column if it has none."""
    out: list[tuple[Column, Quantity, Mapping[str, int]]] = []
    for quantity in quantities:
        field = quantity.field if quantity.name == f"{section}.{quantity.field}" else quantity.name
        for index in positions(data.sizes, [dim for dim in across if dim in quantity.dims]):
            coordinates = [str(data.coords[dim].values[at]).replace(" ", "_") for dim, at in index.items()]
            name = " ".join([quantity.label, *(str(_coordinate(data, dim, at)) for dim, at in index.items())])
            key = "_".join([field, *coordinates])
            column = Column(name=name, unit=shown_unit(quantity.unit), key=key, format=quantity.format)
            out.append((column, quantity, index))
    return out
