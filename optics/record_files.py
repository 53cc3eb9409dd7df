"""Records of this project as JSON files with bit-exact round trip: frozen dataclasses, arrays, numbers, names.

A record is an object with ``record``, its class, and its fields; an array ``{"array": nested lists, "type": ...}``.
Numbers are written with all significant digits. Only records of this project are read.
"""

from __future__ import annotations

import importlib
import json
import math
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.interpolate import CubicSpline

from optics.errors import ConfigError

Record = TypeVar("Record")
PACKAGES = ("optics.", "render.")
NOT_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}


def write_record(path: str | Path, record: Any) -> None:
    """Write a record."""
    Path(path).write_text(json.dumps(_plain(record), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_record(path: str | Path, kind: type[Record]) -> Record:
    """Read a record of a kind."""
    try:
        record = _record(json.loads(Path(path).read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ImportError) as error:
        raise ConfigError(f"{path}: not a file that write_record wrote ({type(error).__name__}: {error})") from None
    if not isinstance(record, kind):
        raise ConfigError(f"{path} holds a {type(record).__name__}; a {kind.__name__} is needed")
    return record


def _plain(value: Any) -> Any:
    """The value in types of JSON."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return {"number": str(value)}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return _compound(value)


def _compound(value: Any) -> dict[str, Any]:
    """Object for a value that is no type of JSON."""
    if isinstance(value, np.ndarray):
        entries = value.tolist() if np.isfinite(value).all() else [_plain(v) for v in value.ravel().tolist()]
        written = {"array": entries, "type": value.dtype.name, "shape": list(value.shape)}
    elif isinstance(value, tuple | list):
        written = {"tuple": [_plain(v) for v in value]}
    elif isinstance(value, dict):
        written = {"dict": [[_plain(k), _plain(v)] for k, v in value.items()]}
    elif isinstance(value, CubicSpline):
        written = {"spline": _plain(value.x), "coefficients": _plain(value.c)}
    elif is_dataclass(value) and not isinstance(value, type):
        kind = type(value)
        named = {field.name: _plain(getattr(value, field.name)) for field in fields(value) if field.init}
        written = {"record": f"{kind.__module__}.{kind.__qualname__}", "fields": named}
    else:
        raise ConfigError(f"a {type(value).__name__} cannot be written into a file of records")
    return written


def _record(value: Any) -> Any:
    """Value of an entry of a file of records."""
    if not isinstance(value, dict):
        return value
    (kind,) = KINDS.keys() & value.keys()
    return KINDS[kind](value)


def _array(value: dict[str, Any]) -> Any:
    entries = value["array"]
    if any(isinstance(entry, dict) for entry in entries):  # a flat list, as it holds a number that is not finite
        entries = [_record(entry) for entry in entries]
    return np.array(entries, dtype=value["type"]).reshape(value["shape"])


def _spline(value: dict[str, Any]) -> CubicSpline:
    return CubicSpline.construct_fast(_record(value["coefficients"]), _record(value["spline"]), axis=0)


def _dataclass(value: dict[str, Any]) -> Any:
    module, _, name = value["record"].rpartition(".")
    kind: Any = getattr(importlib.import_module(module), name) if module.startswith(PACKAGES) else None
    if not (isinstance(kind, type) and is_dataclass(kind)):
        raise ValueError(f"{value['record']} is not a starbench record")
    return kind(**{key: _record(entry) for key, entry in value["fields"].items()})


KINDS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "number": lambda value: NOT_FINITE[value["number"]],
    "array": _array,
    "tuple": lambda value: tuple(_record(v) for v in value["tuple"]),
    "dict": lambda value: {_record(k): _record(v) for k, v in value["dict"]},
    "spline": _spline,
    "record": _dataclass,
}
"""Functions that read an object of a file, by its key."""
