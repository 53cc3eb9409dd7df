"""Sweeps as text: a key of the configuration and its values.

``KEY=LOW:HIGH:POINTS`` is evenly spaced, ``KEY=LOW:HIGH:POINTS:log`` evenly in the logarithm, ``KEY=A,B,C`` a list.
"""

from __future__ import annotations

import math
import operator
import re
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from optics.errors import ConfigError, unknown_name
from optics.settings import alternatives
from optics.validate import allowed_range, parse_model

LARGEST = 200
"""Most points of a sweep."""
_FORM = "KEY=LOW:HIGH:POINTS is needed, e.g. defocus_mm=-0.2:0.2:9; or KEY=LOW:HIGH:POINTS:log, or KEY=A,B,C"
_NOT_SWEPT = frozenset({"seed", "trials", "draws", "sensor_seed", "adc_bits"})


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepRange:
    """Values of one number of the configuration."""

    key: str  # Dotted key
    values: tuple[float, ...]  # In order; whole numbers where the configuration has whole numbers


def leaf_keys(model: type[BaseModel], prefix: str = "") -> dict[str, FieldInfo]:
    """Dotted keys of all single numbers of a configuration, with their fields."""
    found: dict[str, FieldInfo] = {}
    for name, field in model.model_fields.items():
        annotation = field.annotation
        if tables := [part for part in alternatives(annotation) if _is_model(part)]:
            for table in tables:
                found |= leaf_keys(table, f"{prefix}{name}.")
        elif _number_of(annotation) is not None and name not in _NOT_SWEPT:
            found[prefix + name] = field
    return found


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _number_of(annotation: Any) -> type | None:
    """``float`` or ``int`` if the field holds one such number (or nothing, or a word in its place), else None."""
    several = typing.get_origin(annotation) not in (None, tuple, list)
    parts = typing.get_args(annotation) if several else (annotation,)
    plain = (getattr(one, "__origin__", one) for one in parts if typing.get_origin(one) is not Literal)
    kinds = {*plain} - {type(None)}
    return next(iter(kinds)) if kinds in ({float}, {int}) else None


def parse_sweep(text: str, keys: Mapping[str, FieldInfo]) -> SweepRange:
    """Read a sweep."""
    name, equals, values = text.partition("=")
    if not equals or not values.strip():
        raise ConfigError(f"sweep {text!r}: {_FORM}")
    key = _full_key(name.strip(), keys)
    points: NDArray[Any] = (_listed if "," in values else _spaced)(text, values)
    if _number_of(keys[key].annotation) is int:
        points = np.unique(np.rint(points).astype(int))
        if len(points) < 2:
            raise ConfigError(f"sweep {text!r}: {key} takes whole numbers, and the range holds fewer than two of them")
    return SweepRange(key=key, values=tuple(points.tolist()))


def _numbers(text: str, words: Sequence[str]) -> list[float]:
    try:
        found = [float(word) for word in words]
    except ValueError:
        raise ConfigError(f"sweep {text!r}: {' and '.join(map(repr, words))} must be numbers; {_FORM}") from None
    if not all(map(math.isfinite, found)):
        raise ConfigError(f"sweep {text!r}: all values must be finite numbers")
    return found


def _listed(text: str, values: str) -> NDArray[Any]:
    """Values of a list, in rising order."""
    points = np.unique(_numbers(text, [word.strip() for word in values.split(",")]))
    if not 2 <= len(points) <= LARGEST:
        raise ConfigError(f"sweep {text!r}: {len(points)} different values; 2 to {LARGEST} are needed")
    return points + 0.0  # no minus zero


def _spaced(text: str, values: str) -> NDArray[Any]:
    """Values of a range."""
    parts = [part.strip() for part in values.split(":")]
    even = len(parts) == 3
    if not even and (len(parts) != 4 or parts[3] != "log"):
        raise ConfigError(f"sweep {text!r}: {_FORM}")
    low, high = _numbers(text, parts[:2])
    if low == high:
        raise ConfigError(f"sweep {text!r}: the range from {low:g} to {high:g} is empty")
    if not re.fullmatch(r"\d+", parts[2]) or not 2 <= int(parts[2]) <= LARGEST:
        raise ConfigError(f"sweep {text!r}: {parts[2]!r} points; a whole number from 2 to {LARGEST} is needed")
    if even:
        digits = 12 - int(np.floor(np.log10(max(abs(low), abs(high)))))
        return np.asarray(np.round(np.linspace(low, high, int(parts[2])), digits) + 0.0)  # 0.15, and no minus zero
    if min(low, high) <= 0:
        raise ConfigError(f"sweep {text!r}: a logarithmic range holds positive numbers only")
    return np.array([float(f"{value:.12g}") for value in np.geomspace(low, high, int(parts[2]))])


def logarithmic(values: Sequence[float]) -> bool:
    """Whether values are spaced more evenly in the logarithm than plainly: how a figure shows them."""
    if len(values) < 3 or min(values) <= 0:
        return False
    plain, logs = np.diff(values), np.diff(np.log(values))
    return bool(np.std(logs) / abs(np.mean(logs)) < np.std(plain) / abs(np.mean(plain)) - 1e-6)


def _full_key(name: str, keys: Mapping[str, FieldInfo]) -> str:
    if name in keys:
        return name
    tails = [key for key in keys if key.endswith(f".{name}")]
    tails.sort(key=lambda key: key.count("."))
    if tails and (len(tails) == 1 or tails[0].count(".") < tails[1].count(".")):  # of the outer table
        return tails[0]
    if tails:
        raise ConfigError(f"sweep: {name!r} is ambiguous: {' and '.join(tails)}; name one of them")
    words = {key.rpartition(".")[2] for key in keys}
    raise unknown_name("parameter of the sweep", name, keys if "." in name else words)


_UNITS = {
    "e_per_s": "e-/s", "dn_per_e": "DN/e-", "arcsec_per_s": "arcsec/s", "deg_per_s": "deg/s", "s": "s", "us": "µs",
    "mm": "mm", "um": "um", "nm": "nm", "px": "px", "e": "e-", "c": "°C", "k": "K", "mag": "mag", "deg": "deg",
    "arcsec": "arcsec", "arcmin": "arcmin", "sigma": "sigma", "ppm": "ppm", "hz": "Hz", "percent": "percent",
}  # fmt: skip


_NAMES = {"f number": "F-number", "prnu": "PRNU", "dsnu": "DSNU"}


def quantity_of(key: str) -> tuple[str, str]:
    """Name of a key and its unit, by which its name ends: "instrument.exposure_s" is ("exposure", "s")."""
    words = key.rpartition(".")[2].split("_")
    ends = (n for n in range(1, len(words)) if "_".join(words[n:]) in _UNITS)
    end = next(ends, len(words))
    name = " ".join(words[:end])
    return _NAMES.get(name, name), _UNITS.get("_".join(words[end:]), "")


def check_range(model: type[BaseModel], sweep: SweepRange) -> None:
    """Refuse a sweep that leaves the allowed values of its parameter."""
    field = leaf_keys(model)[sweep.key]
    constrained: Any = Annotated[field.annotation, "", *field.metadata]
    takes = TypeAdapter[Any](constrained)
    for value in (min(sweep.values), max(sweep.values)):
        try:
            takes.validate_python(value)
        except ValidationError:
            bounds = allowed_range(field)
            raise ConfigError(f"sweep: {sweep.key} = {value:g} is not allowed; it must be {bounds}") from None


def value_at(config: BaseModel, key: str) -> Any:
    """The value at a dotted key."""
    return operator.attrgetter(key)(config)


def with_value(config: Any, key: str, value: Any) -> Any:
    """A copy of a configuration with another value at a dotted key; checked again."""
    values = node = config.model_dump()
    *tables, last = key.split(".")
    for word in tables:
        if not isinstance(node[word], dict):
            raise ConfigError(f"{key}: {word} is {node[word]!r}, not a table with this key")
        node = node[word]
    node[last] = value
    return parse_model(type(config), values, key)
