"""Sweeps as text: a key of the configuration and its values.

``KEY=LOW:HIGH:POINTS`` is evenly spaced, ``KEY=LOW:HIGH:POINTS:log`` evenly in the logarithm, ``KEY=A,B,C`` a list.
"""

from __future__ import annotations

import math
import operator
import re
import typing
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from optics.errors import ConfigError, unknown_name
from optics.settings import annotated
from optics.validate import allowed_range, dotted_fields, full_key, parse_model

LARGEST = 200
"""Most points of a sweep."""
_FORM = "KEY=LOW:HIGH:POINTS is needed, e.g. defocus_mm=-0.2:0.2:9; or KEY=LOW:HIGH:POINTS:log, or KEY=A,B,C"
_NOT_SWEPT = frozenset({"seed", "trials", "draws", "sensor_seed", "adc_bits"})


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepRange:
    """Values of one number of the configuration."""

    key: str  # Dotted key
    values: tuple[float, ...]  # In order; whole numbers where the configuration has whole numbers


def leaf_keys(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Dotted keys of all single numbers of a configuration, with their fields."""
    return {
        key: field
        for key, field in dotted_fields(model).items()
        if _number_of(field.annotation) is not None and key.rpartition(".")[2] not in _NOT_SWEPT
    }


def _number_of(annotation: Any) -> type | None:
    """``float`` or ``int`` if the field holds one such number (or nothing, or a word in its place), else None."""
    several = typing.get_origin(annotation) not in (None, tuple, list)
    parts = typing.get_args(annotation) if several else (annotation,)
    plain = (getattr(part, "__origin__", part) for part in parts if typing.get_origin(part) is not Literal)
    kinds = {*plain} - {type(None)}
    return next(iter(kinds)) if kinds in ({float}, {int}) else None


def parse_sweep(text: str, model: type[BaseModel], not_swept: Collection[str] = ()) -> SweepRange:
    """Sweep of a configuration; ``not_swept``: tables that no prediction depends on.

    Raises
    ------
    ConfigError
        Unknown or ambiguous key, a key without a number, a malformed range, or values that the key does not allow.
    """
    try:
        name, _, values = text.partition("=")
        if not values.strip():
            raise ConfigError(_FORM)
        key = full_key(model, name.strip())
        return SweepRange(key=key, values=_values(values, key, _swept_field(model, key, not_swept)))
    except ConfigError as error:
        raise ConfigError(f"--sweep {text}: {error}") from None


def _swept_field(model: type[BaseModel], key: str, not_swept: Collection[str]) -> FieldInfo:
    numbers = leaf_keys(model)
    if key.partition(".")[0] in not_swept:
        raise ConfigError(f"the prediction does not depend on {key}")
    if key not in numbers:
        if key in dotted_fields(model):
            raise ConfigError(f"{key} cannot be swept; a key with one number is needed")
        raise unknown_name("key", key, numbers if "." in key else {number.rpartition(".")[2] for number in numbers})
    return numbers[key]


def _values(text: str, key: str, field: FieldInfo) -> tuple[float, ...]:
    """Values of a range or list that the field allows."""
    points: NDArray[Any] = (_listed if "," in text else _spaced)(text)
    if _number_of(field.annotation) is int:
        points = np.unique(np.rint(points).astype(int))
        if len(points) < 2:
            raise ConfigError(f"{key} takes whole numbers, and the range holds fewer than two of them")
    values = tuple(points.tolist())
    for value in (min(values), max(values)):
        try:
            TypeAdapter[Any](annotated(field)).validate_python(value)
        except ValidationError:
            raise ConfigError(f"{key} = {value:g} is out of range (allowed: {allowed_range(field)})") from None
    return values


def _numbers(words: Sequence[str]) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        raise ConfigError(f"{' and '.join(map(repr, words))} must be numbers; {_FORM}") from None
    if not all(map(math.isfinite, numbers)):
        raise ConfigError("all values must be finite numbers")
    return numbers


def _listed(text: str) -> NDArray[Any]:
    """Values of a list, in rising order."""
    points = np.unique(_numbers([word.strip() for word in text.split(",")]))
    if not 2 <= len(points) <= LARGEST:
        raise ConfigError(f"{len(points)} different values; 2 to {LARGEST} are needed")
    return points + 0.0  # no minus zero


def _spaced(text: str) -> NDArray[Any]:
    """Values of a range."""
    parts = [part.strip() for part in text.split(":")]
    linear = len(parts) == 3
    if not linear and (len(parts) != 4 or parts[3] != "log"):
        raise ConfigError(_FORM)
    low, high = _numbers(parts[:2])
    if low == high:
        raise ConfigError(f"the range from {low:g} to {high:g} is empty")
    if not re.fullmatch(r"\d+", parts[2]) or not 2 <= int(parts[2]) <= LARGEST:
        raise ConfigError(f"{parts[2]!r} points; a whole number from 2 to {LARGEST} is needed")
    if linear:
        digits = 12 - int(np.floor(np.log10(max(abs(low), abs(high)))))
        return np.asarray(np.round(np.linspace(low, high, int(parts[2])), digits) + 0.0)  # 0.15, and no minus zero
    if min(low, high) <= 0:
        raise ConfigError("a logarithmic range holds positive numbers only")
    return np.array([float(f"{value:.12g}") for value in np.geomspace(low, high, int(parts[2]))])


def logarithmic(values: Sequence[float]) -> bool:
    """Whether values are spaced more evenly in the logarithm than plainly: how a figure shows them."""
    if len(values) < 3 or min(values) <= 0:
        return False
    plain, logs = np.diff(values), np.diff(np.log(values))
    return bool(np.std(logs) / abs(np.mean(logs)) < np.std(plain) / abs(np.mean(plain)) - 1e-6)


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


def value_at(config: BaseModel, key: str) -> Any:
    """The value at a dotted key."""
    return operator.attrgetter(key)(config)


def with_value(config: Any, key: str, value: Any) -> Any:
    """A copy of a configuration with another value at a dotted key; checked again."""
    values = table = config.model_dump()
    *names, last = key.split(".")
    for name in names:
        if not isinstance(table[name], dict):
            raise ConfigError(f"{key}: {name} is {table[name]!r}, not a table with this key")
        table = table[name]
    table[last] = value
    return parse_model(type(config), values, lambda location, sentence: sentence)
