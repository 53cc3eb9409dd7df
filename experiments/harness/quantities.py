"""The numbers of a result, each described once: values, uncertainty, sample size, dimensions, label, unit, format.

They are an `xarray.Dataset`. A number has one name, ``SECTION.FIELD``: variable of ``results.nc``, path below
``results`` in ``summary.json`` (`to_results`), and, as FIELD, column of the section's ECSV file. Figures, verdicts and
the text of a report may say FIELD alone for a field of their own section, or where only one section has it (`Outcome`).
Variables have ``long_name`` and ``units`` of the CF conventions (sec. 3.1 to 3.3); uncertainty and sample size are
ancillary variables (sec. 3.4) ``SECTION.FIELD_error`` and ``SECTION.FIELD_n``.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiments.harness.summary import Measured
from optics.errors import DomainError, unknown_name

if TYPE_CHECKING:
    import xarray as xr

IN_SUMMARY = 4000
"""Values of a quantity beyond which ``summary.json`` gives its shape and refers to ``results.nc``."""
_EXACT_INTEGERS = 2**53  # identifiers of stars are beyond what a float64 can tell apart

_SHOWN = {"arcsec": "″", "arcmin": "′", "deg": "°", "um": "µm", "e-": "e⁻", "e-/s": "e⁻/s", "sigma": "σ"}
_SHOWN |= {"percent": "%", "degC": "°C", "e-/DN": "e⁻/DN", "DN2": "DN²"}
_SHOWN |= {"deg/s": "°/s", "deg/s2": "°/s²", "s2": "s²", "1e-6/K": "10⁻⁶/K"}


def shown_unit(unit: str) -> str:
    """Printed form of a unit: "arcsec" is ″, "um" is µm."""
    return "" if unit.startswith("{") else _SHOWN.get(unit, unit)


class Quantities:
    """Collects described quantities.

    Examples
    --------
    >>> q = Quantities()
    >>> q.axis("axis", ["x", "y"], "Axis")
    >>> q.add("star.te_arcsec", [1.1, 1.2], "Temporal error", unit="arcsec", dims="axis", error=[0.1, 0.1], n=30)
    >>> to_results(q.dataset)["star"]["te_arcsec"]["value"]
    {'x': 1.1, 'y': 1.2}
    """

    def __init__(self) -> None:
        self.coordinates: dict[str, tuple[Any, ...]] = {}
        self._values: dict[str, tuple[Any, ...]] = {}
        self._sizes: dict[str, int] = {}

    @property
    def dataset(self) -> xr.Dataset:
        """All that was described."""
        import xarray as xr  # slow to import

        return xr.Dataset(self._values, self.coordinates)

    def axis(
        self,
        name: str,
        values: ArrayLike,
        label: str = "",
        *,
        unit: str = "",
        format: str = "",
        names: Mapping[Any, str] | Sequence[str] | None = None,
        units: Sequence[str] = (),
    ) -> None:
        """Describe a dimension; ``units`` are the units, one by one, of quantities along it whose unit is "{NAME}"."""
        coordinates = np.asarray(values)
        attrs = {"long_name": label or name, "units": unit, "format": format}
        self._sizes[name] = len(coordinates)
        self.coordinates[name] = (name, coordinates, attrs)
        if names is not None:
            shown = [names[v] for v in coordinates.tolist()] if isinstance(names, Mapping) else list(names)
            self.coordinates[f"{name}_label"] = (name, np.asarray(shown, dtype=object))
        if units:
            self.coordinates[f"{name}_unit"] = (name, np.asarray(units, dtype=object))

    def add(
        self,
        name: str,
        values: Any,
        label: str = "",
        *,
        unit: str = "",
        dims: str | Sequence[str] = (),
        error: ArrayLike | None = None,
        n: ArrayLike | None = None,
        format: str = "",
    ) -> None:
        """Describe the quantity ``SECTION.FIELD``."""
        if name in self._values or name in self.coordinates:
            raise DomainError(f"quantity {name!r} is described twice")
        names = tuple(dims.split()) if isinstance(dims, str) else tuple(dims)
        values, own_error, own_n, own_unit = _split(values)
        error, n = own_error if error is None else error, own_n if n is None else n
        array = np.asarray(values)
        if array.dtype.kind == "U":
            array = array.astype(object)
        if array.ndim != len(names):
            raise DomainError(f"quantity {name!r} has shape {array.shape} for dimensions {' '.join(names) or '(none)'}")
        attrs: dict[str, Any] = {"long_name": label or name, "units": unit or own_unit, "format": format}
        extra = {part: given for part, given in (("error", error), ("n", n)) if given is not None}
        if extra:
            attrs["ancillary_variables"] = " ".join(f"{name}_{part}" for part in extra)
        for dim, size in zip(names, array.shape, strict=True):
            if self._sizes.setdefault(dim, size) != size:
                raise DomainError(f"quantity {name!r} has {size} values along {dim}, which has {self._sizes[dim]}")
        self._values[name] = (names, array, attrs)
        for part, given in extra.items():
            try:
                full = np.broadcast_to(np.asarray(given, dtype=np.float64), array.shape)
            except ValueError as problem:
                raise DomainError(f"quantity {name!r}: {problem}") from None
            self._values[f"{name}_{part}"] = (names, full.copy(), {"ancillary_of": name})


def _split(values: Any) -> tuple[Any, Any, Any, str]:
    """Values, uncertainties, sample sizes and unit of nested sequences of `Measured`; others unchanged."""
    if hasattr(values, "dtype") and values.dtype != object:
        return np.asarray(values), None, None, ""
    array = np.empty((), dtype=object)
    if isinstance(values, Measured):
        array[()] = values
    else:
        array = np.array(values, dtype=object)
    if array.size == 0 or not all(isinstance(member, Measured) for member in array.flat):
        return values, None, None, ""

    def part(name: str) -> NDArray[np.float64]:
        numbers = [getattr(member, name) for member in array.flat]
        return np.array([np.nan if number is None else number for number in numbers], dtype=np.float64).reshape(
            array.shape
        )

    error, n = part("uncertainty"), part("n")
    return part("value"), error, n if np.isfinite(n).any() else None, array.flat[0].unit


@dataclass(frozen=True, slots=True)
class Quantity:
    """One quantity of a data set, or a part of it, as plain arrays."""

    name: str  # SECTION.FIELD, or the name of a dimension
    label: str
    unit: str
    format: str
    dims: tuple[str, ...]  # Names of the dimensions
    values: NDArray[Any]  # Numbers, text or bool
    error: NDArray[np.float64] | None  # Uncertainty and sample size
    n: NDArray[np.float64] | None

    @classmethod
    def of(cls, data: xr.Dataset, name: str) -> Quantity:
        """A variable or coordinate of a data set."""
        if name not in data.variables:
            raise unknown_name("quantity", name, [str(variable) for variable in data.variables])
        variable = data[name]
        attrs = variable.attrs
        error, n = (data[f"{name}_{part}"].values if f"{name}_{part}" in data else None for part in ("error", "n"))
        return cls(
            name,
            attrs.get("long_name", name),
            attrs.get("units", ""),
            attrs.get("format", ""),
            tuple(str(dim) for dim in variable.dims),
            variable.values,
            error,
            n,
        )

    @property
    def field(self) -> str:
        """Name within its section."""
        return self.name.rpartition(".")[2]

    @property
    def heading(self) -> str:
        """Label with unit, for the axis of a figure."""
        return f"{self.label} [{shown_unit(self.unit)}]" if self.unit else self.label

    def at(self, **index: int) -> Quantity:
        """The part at positions along some dimensions; those it does not have are passed over."""
        where = tuple(index.get(dim, slice(None)) for dim in self.dims)
        dims = tuple(dim for dim in self.dims if dim not in index)
        error, n = (None if part is None else np.asarray(part[where]) for part in (self.error, self.n))
        return replace(self, dims=dims, values=np.asarray(self.values[where]), error=error, n=n)

    def scalar(self) -> Any:
        """The one value: `Measured` where it has an uncertainty or a sample size, else a plain number, text or bool."""
        if self.dims:
            raise DomainError(f"quantity {self.name!r}: say which {', '.join(self.dims)}")
        value = self.values.item()
        if self.error is None and self.n is None:
            return value
        error = None if self.error is None or not np.isfinite(self.error) else float(self.error)
        n = None if self.n is None or not np.isfinite(self.n) else int(self.n)
        return Measured(value=value, unit=self.unit, uncertainty=error, n=n)


def names_of(data: xr.Dataset) -> list[str]:
    """Names of the quantities of a data set, in order; no coordinates, no ancillary variables."""
    return [str(name) for name, variable in data.data_vars.items() if "ancillary_of" not in variable.attrs]


def to_results(data: xr.Dataset) -> dict[str, Any]:
    """The ``results`` of ``summary.json``: SECTION -> FIELD -> unit, dimensions, value, uncertainty, sample size ``n``.

    Values nest in the order of ``dims``: objects along a dimension with text coordinates, lists along others, whose
    coordinates are `to_coordinates`. Of more than `IN_SUMMARY` values only the shape is given.
    """
    results: dict[str, Any] = {}
    for name in names_of(data):
        quantity = Quantity.of(data, name)
        section, _, field = name.rpartition(".")
        results.setdefault(section, {})[field] = _record(quantity, data)
    return results


def to_coordinates(data: xr.Dataset) -> dict[str, Any]:
    """The ``coordinates`` of ``summary.json``: dimension -> label, unit, values."""
    axes = {str(dim): Quantity.of(data, str(dim)) for dim in data.dims if dim in data.coords}
    return {dim: {"label": axis.label, "unit": axis.unit, "value": axis.values} for dim, axis in axes.items()}


def _record(quantity: Quantity, data: xr.Dataset) -> dict[str, Any]:
    record: dict[str, Any] = {"unit": _unit_of(quantity, data)} if quantity.values.dtype.kind in "iuf" else {}
    if quantity.dims:
        record["dims"] = list(quantity.dims)
    if quantity.values.size > IN_SUMMARY:
        return record | {"shape": quantity.values.shape, "file": "results.nc"}
    record["value"] = _nested(quantity.values, quantity.dims, data)
    if quantity.error is not None:
        record["uncertainty"] = _nested(quantity.error, quantity.dims, data)
    if quantity.n is not None:
        counts = np.unique(quantity.n)
        record["n"] = (
            int(counts[0]) if counts.size == 1 and np.isfinite(counts[0]) else _nested(quantity.n, quantity.dims, data)
        )
    return record


def _unit_of(quantity: Quantity, data: xr.Dataset) -> Any:
    """Unit, or the unit of each member along the dimension that has units of its own ("{DIMENSION}")."""
    dim = quantity.unit[1:-1]
    if quantity.unit != f"{{{dim}}}" or dim not in quantity.dims:
        return quantity.unit
    return dict(zip(_keys(data, dim) or (), data.coords[f"{dim}_unit"].values.tolist(), strict=True))


def _nested(values: NDArray[Any], dims: Sequence[str], data: xr.Dataset) -> Any:
    if not dims or not (keys := [_keys(data, dim) for dim in dims]) or not any(keys):
        return np.asarray(values).tolist()
    members = [_nested(member, dims[1:], data) for member in values]
    return members if keys[0] is None else dict(zip(keys[0], members, strict=True))


def _keys(data: xr.Dataset, dim: str) -> list[str] | None:
    """Text coordinates of a dimension; None for numbers, and for a dimension without coordinates."""
    if dim not in data.coords or data.coords[dim].dtype.kind not in "UO":
        return None
    return [str(key) for key in data.coords[dim].values]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What tables, figures, criteria and the report of an experiment are made from.

    A quantity is named SECTION.FIELD, or FIELD alone: the field of ``section``, or of the only section that has it.
    """

    config: Any  # Settings
    result: Any  # What ``run`` returned
    data: xr.Dataset  # Its quantities
    section: str = ""  # Section whose figure or verdict this is given to

    def name(self, name: str) -> str:
        """SECTION.FIELD of a quantity; the name of a dimension as it is; "" where the result has no such quantity."""
        if (qualified := f"{self.section}.{name}") in self.data.variables:
            return qualified
        matches = [full for full in names_of(self.data) if name in (full, full.rpartition(".")[2])]
        if len(matches) == 1 or name in self.data.variables:
            return matches[0] if len(matches) == 1 else name
        if matches:
            raise DomainError(f"quantity {name!r} is in several sections: {', '.join(matches)}")
        return ""

    def __contains__(self, name: str) -> bool:
        return bool(self.name(name))

    def quantity(self, name: str, **at: Any) -> Quantity:
        """A quantity, or its part at some coordinates (``method="cog"``; a position where a dimension has none)."""
        full = self.name(name) or name
        return Quantity.of(self.data, full).at(**{dim: self._position(full, dim, key) for dim, key in at.items()})

    def values(self, name: str, **at: Any) -> NDArray[Any]:
        """Values of the quantity."""
        return self.quantity(name, **at).values

    def errors(self, name: str, **at: Any) -> NDArray[np.float64]:
        """Uncertainties of the quantity; NaN where it has none."""
        quantity = self.quantity(name, **at)
        return np.full(quantity.values.shape, np.nan) if quantity.error is None else quantity.error

    def value(self, name: str, **at: Any) -> Any:
        """A single value: `Measured` where it has an uncertainty, otherwise plain."""
        return self.quantity(name, **at).scalar()

    def dims(self, name: str) -> tuple[str, ...]:
        """Dimensions of the quantity."""
        return self.quantity(name).dims

    def heading(self, name: str) -> str:
        """Label and unit of a quantity or a dimension, for the axis of a figure."""
        return self.quantity(name).heading

    def names(self, dim: str) -> list[str]:
        """Displayed names along a dimension."""
        label = f"{dim}_label"
        return [str(text) for text in self.data.coords[label if label in self.data.coords else dim].values]

    def label(self, dim: str, key: Any) -> str:
        """Displayed name of one coordinate of a dimension."""
        return self.labels(dim)[key]

    def labels(self, dim: str) -> dict[Any, str]:
        """Coordinates along a dimension, with what readers see of them."""
        return dict(zip(self.data.coords[dim].values.tolist(), self.names(dim), strict=True))

    def _position(self, name: str, dim: str, key: Any) -> int:
        if dim not in self.data[name].dims:
            raise unknown_name(f"dimension of quantity {name!r}:", dim, [str(d) for d in self.data[name].dims])
        if dim not in self.data.coords:
            return int(key)
        coordinates = self.data.coords[dim].values.tolist()
        if key not in coordinates:
            raise unknown_name(f"{dim} of quantity {name!r}:", str(key), [str(text) for text in coordinates])
        return coordinates.index(key)


def write_netcdf(data: xr.Dataset, path: Path) -> None:
    """Write the quantities for users who analyse on: ``xarray.open_dataset("results.nc")``."""
    if not data.variables:
        return
    from xarray.backends import ScipyDataStore

    plain = data.copy()
    plain.attrs["Conventions"] = "CF-1.11"
    for name in list(plain.variables):
        attrs = plain[name].attrs
        plain[name].attrs = {key: attrs[key] for key in ("long_name", "units", "ancillary_variables") if attrs.get(key)}
        if plain[name].dtype.kind in "OU":
            plain[name] = plain[name].astype(str)
        elif plain[name].dtype.kind in "iu":  # netCDF 3 has no 64-bit integers
            exact = np.abs(plain[name].values).max(initial=0) <= _EXACT_INTEGERS
            plain[name] = plain[name].astype(np.float64 if exact else str)
    # to_netcdf, as a lock, imports all of Dask's clusters
    store = ScipyDataStore(str(path), mode="w", format="NETCDF3_64BIT", lock=False)
    plain.dump_to_store(store)
    store.close()


def positions(sizes: Mapping[Any, int], dims: Sequence[str]) -> list[dict[str, int]]:
    """All positions along some dimensions, the last one running fastest."""
    return [dict(zip(dims, index, strict=True)) for index in itertools.product(*(range(sizes[dim]) for dim in dims))]
