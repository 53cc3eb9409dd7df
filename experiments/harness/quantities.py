"""The numbers of a result, each described once: values, uncertainty, sample size, dimensions, label, unit, format.

They are an `xarray.Dataset` whose variables have ``long_name`` and ``units`` of the CF conventions (sec. 3.1 to 3.3);
uncertainty and sample size of a variable are ancillary variables (sec. 3.4) ``NAME_error`` and ``NAME_n``. From this
description follow ``summary.json`` (`to_results`), tables (`experiments.harness.pivot`), the axes of figures, the
numbers in the text of a report (`Outcome`), and ``results.nc``.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiments.harness.summary import Measured
from optics.errors import ConfigError, DomainError, unknown_name

if TYPE_CHECKING:
    import xarray as xr

Places = str | Mapping[str, str | Sequence[str]]
WHOLE = "*"
_EXACT_INTEGERS = 2**53  # identifiers of stars are beyond what a float64 can tell apart

_SHOWN = {"arcsec": "″", "arcmin": "′", "deg": "°", "um": "µm", "e-": "e⁻", "e-/s": "e⁻/s", "sigma": "σ"}
_SHOWN |= {"percent": "%", "degC": "°C", "e-/DN": "e⁻/DN"}
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
    >>> q.add("te_arcsec", [1.1, 1.2], "Temporal error", unit="arcsec", dims="axis", error=[0.1, 0.1], n=30)
    >>> to_results(q.dataset)["te_arcsec"]["x"]
    Measured(value=1.1, unit='arcsec', uncertainty=0.1, n=30)
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
        key: str = "",
        names: Mapping[Any, str] | Sequence[str] | None = None,
        units: Sequence[str] = (),
    ) -> None:
        """Describe a dimension; ``units`` are the units, one by one, of quantities along it whose unit is "{NAME}"."""
        coordinates = np.asarray(values)
        attrs = {"long_name": label or name, "units": unit, "format": format, "key": key}
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
        key: str | None = None,
        json: Places | None = None,
        json_error: Places = "",
    ) -> None:
        """Describe a quantity."""
        if name in self._values or name in self.coordinates:
            raise DomainError(f"quantity {name!r} is described twice")
        names = tuple(dims.split()) if isinstance(dims, str) else tuple(dims)
        values, found_error, found_n, found_unit = _split(values)
        error, n = (found if given is None else given for given, found in ((error, found_error), (n, found_n)))
        array = np.asarray(values)
        if array.dtype.kind == "U":
            array = array.astype(object)
        if array.ndim != len(names):
            raise DomainError(f"quantity {name!r} has shape {array.shape} for dimensions {' '.join(names) or '(none)'}")
        attrs: dict[str, Any] = {"long_name": label or name, "units": unit or found_unit, "format": format}
        attrs |= {"key": name if key is None else key, "json": name if json is None else json}
        extra = {part: given for part, given in (("error", error), ("n", n)) if given is not None}
        if extra:
            attrs["ancillary_variables"] = " ".join(f"{name}_{part}" for part in extra)
        for dim, size in zip(names, array.shape, strict=True):
            if self._sizes.setdefault(dim, size) != size:
                raise DomainError(f"quantity {name!r} has {size} values along {dim}, which has {self._sizes[dim]}")
        self._values[name] = (names, array, attrs)
        for part, given in extra.items():
            try:
                whole = np.broadcast_to(np.asarray(given, dtype=np.float64), array.shape)
            except ValueError as problem:
                raise DomainError(f"quantity {name!r}: {problem}") from None
            own = {"json": json_error} if part == "error" else {}
            self._values[f"{name}_{part}"] = (names, whole.copy(), {"ancillary_of": name, **own})


def _split(values: Any) -> tuple[Any, Any, Any, str]:
    """Values, uncertainties, sample sizes and unit of nested sequences of `Measured`; others unchanged."""
    if hasattr(values, "dtype") and values.dtype != object:
        return np.asarray(values), None, None, ""
    array = np.empty((), dtype=object)
    if isinstance(values, Measured):
        array[()] = values
    else:
        array = np.array(values, dtype=object)
    if array.size == 0 or not all(isinstance(one, Measured) for one in array.flat):
        return values, None, None, ""

    def part(name: str) -> NDArray[np.float64]:
        found = [getattr(one, name) for one in array.flat]
        return np.array([np.nan if v is None else v for v in found], dtype=np.float64).reshape(array.shape)

    error, n = part("uncertainty"), part("n")
    return part("value"), error, n if np.isfinite(n).any() else None, array.flat[0].unit


@dataclass(frozen=True, slots=True)
class Quantity:
    """One quantity of a data set, or a part of it, as plain arrays."""

    name: str  # As described (`Quantities.add`)
    label: str
    unit: str
    format: str
    key: str
    json: Places  # As described
    dims: tuple[str, ...]  # Names of the dimensions
    values: NDArray[Any]  # Numbers, text or bool
    error: NDArray[np.float64] | None  # Uncertainty and sample size
    n: NDArray[np.float64] | None

    @classmethod
    def of(cls, data: xr.Dataset, name: str) -> Quantity:
        """A variable or coordinate of a data set."""
        if name not in data.variables:
            raise unknown_name("quantity", name, [str(one) for one in data.variables])
        variable = data[name]
        told = variable.attrs
        error, n = (data[f"{name}_{part}"].values if f"{name}_{part}" in data else None for part in ("error", "n"))
        return cls(
            name,
            told.get("long_name", name),
            told.get("units", ""),
            told.get("format", ""),
            told.get("key", name),
            told.get("json", ""),
            tuple(str(dim) for dim in variable.dims),
            variable.values,
            error,
            n,
        )

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
    return [str(name) for name, one in data.data_vars.items() if "ancillary_of" not in one.attrs]


def to_results(data: xr.Dataset) -> dict[str, Any]:
    """The ``results`` of ``summary.json``: every quantity at the place that its description names."""
    out: dict[str, Any] = {}
    for name in names_of(data):
        one = Quantity.of(data, name)
        parts = [(one.json, one)]
        if one.error is not None and (apart := data[f"{name}_error"].attrs.get("json")):
            plain = replace(one, error=None, n=None)
            parts = [(one.json, plain), (apart, replace(plain, values=one.error))]
        for json, whole in parts:
            for place, part in _apart(json, whole, data):
                out = _merged(out, _placed(place.split("."), part, data))
    return out


def _apart(json: Places, one: Quantity, data: xr.Dataset) -> list[tuple[str, Quantity]]:
    """Parts of a quantity that have places of their own."""
    if isinstance(json, str):
        return [(json, one)] if json else []
    dim = one.dims[0]
    known = _keys(data, dim) or []
    parts: list[tuple[str, Quantity]] = []
    for key, places in json.items():
        if key not in (WHOLE, *known):
            raise unknown_name(f"{dim} of quantity {one.name!r}:", key, known)
        part = one if key == WHOLE else one.at(**{dim: known.index(key)})
        parts += [(place, part) for place in ([places] if isinstance(places, str) else places)]
    return parts


def _placed(path: Sequence[str], one: Quantity, data: xr.Dataset) -> dict[str, Any]:
    """A quantity at its place, in nested records that hold nothing else."""
    matched = re.fullmatch(r"(\w*)((?:\[\w+\])*)", path[0])
    if matched is None or not path[0]:
        raise ConfigError(f"quantity {one.name!r}: {path[0]!r} in json is not NAME, NAME[DIMENSION]... or [DIMENSION]")
    dims = re.findall(r"\w+", matched[2])
    for dim in dims:
        if dim not in one.dims:
            raise unknown_name(f"dimension of quantity {one.name!r}:", dim, one.dims)
    if len(path) > 1:
        spread = _spread(dims, one, data, lambda part: _placed(path[1:], part, data))
    else:
        dims += [dim for dim in one.dims if dim not in dims]
        spread = _spread(dims, one, data, Quantity.scalar)
    if matched[1]:
        return {matched[1]: spread}
    if not isinstance(spread, dict):
        raise ConfigError(f"quantity {one.name!r}: {path[0]!r} in json stands for no records; put a name before it")
    return spread


def _spread(dims: Sequence[str], one: Quantity, data: xr.Dataset, inner: Callable[[Quantity], Any]) -> Any:
    """Records or lists along dimensions, with ``inner`` of each part in them."""
    if not dims:
        return inner(one)
    keys = _keys(data, dims[0])
    members = [one.at(**{dims[0]: n}) for n in range(data.sizes[dims[0]])]
    if one.unit == f"{{{dims[0]}}}":
        units = data.coords[f"{dims[0]}_unit"].values
        members = [replace(member, unit=str(unit)) for member, unit in zip(members, units, strict=True)]
    parts = [_spread(dims[1:], member, data, inner) for member in members]
    return parts if keys is None else dict(zip(keys, parts, strict=True))


def _merged(old: Any, new: Any) -> Any:
    """Two nestings as one; where both have a value, the new one."""
    if isinstance(old, dict) and isinstance(new, dict):
        return old | {key: _merged(old.get(key), value) for key, value in new.items()}
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        return [_merged(*pair) for pair in zip(old, new, strict=True)]
    return new


def _keys(data: xr.Dataset, dim: str) -> list[str] | None:
    """Keys of the records along a dimension; None for one of numbers or without coordinates, which makes a list."""
    if dim not in data.coords or data.coords[dim].dtype.kind not in "UO":
        return None
    return [str(key) for key in data.coords[dim].values]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What tables, figures, criteria and the report of an experiment are made from."""

    config: Any  # Settings
    result: Any  # What ``run`` returned
    data: xr.Dataset  # Its quantities

    def quantity(self, name: str, **at: Any) -> Quantity:
        """A quantity, or its part at some coordinates (``method="cog"``; a position where a dimension has none)."""
        return Quantity.of(self.data, name).at(**{dim: self._position(name, dim, key) for dim, key in at.items()})

    def values(self, name: str, **at: Any) -> NDArray[Any]:
        """Values of the quantity."""
        return self.quantity(name, **at).values

    def errors(self, name: str, **at: Any) -> NDArray[np.float64]:
        """Uncertainties of the quantity; NaN where it has none."""
        one = self.quantity(name, **at)
        return np.full(one.values.shape, np.nan) if one.error is None else one.error

    def value(self, name: str, **at: Any) -> Any:
        """A single value: `Measured` where it has an uncertainty, otherwise plain."""
        return self.quantity(name, **at).scalar()

    def heading(self, name: str) -> str:
        """Label and unit of a quantity or a dimension, for the axis of a figure."""
        return Quantity.of(self.data, name).heading

    def names(self, dim: str) -> list[str]:
        """Displayed names along a dimension."""
        label = f"{dim}_label"
        return [str(one) for one in self.data.coords[label if label in self.data.coords else dim].values]

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
        known = self.data.coords[dim].values.tolist()
        if key not in known:
            raise unknown_name(f"{dim} of quantity {name!r}:", str(key), [str(one) for one in known])
        return known.index(key)


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
