"""Records of this project as JSON files that come back bit by bit: frozen dataclasses, arrays, numbers, names.

A record is an object with ``record``, its class, and its fields; an array ``{"array": nested lists, "type": ...}``.
Numbers are written with as many digits as bring them back. Only records of this project are read.
"""

from __future__ import annotations

import importlib
import json
import math
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.interpolate import CubicSpline

from optics.errors import ConfigError

__all__ = ["read_record", "write_record"]

Record = TypeVar("Record")
PACKAGES = ("optics.", "render.")
ODD = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}


def write_record(path: str | Path, record: Any) -> None:
    """Write a record.

    Raises
    ------
    ConfigError
        A field of a type that is not known here.
    """
    Path(path).write_text(json.dumps(_plain(record), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_record(path: str | Path, kind: type[Record]) -> Record:
    """Read a record of a kind.

    Raises
    ------
    ConfigError
        No such file, or something else in it.
    """
    try:
        record = _record(json.loads(Path(path).read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ImportError) as error:
        raise ConfigError(f"{path}: not a file that write_record wrote ({type(error).__name__}: {error})") from None
    if not isinstance(record, kind):
        raise ConfigError(f"{path} holds a {type(record).__name__}; a {kind.__name__} is needed")
    return record


def _plain(value: Any) -> Any:
    """What JSON can hold."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"number": str(value)}
    if isinstance(value, np.ndarray):
        entries = value.tolist() if np.isfinite(value).all() else [_plain(v) for v in value.ravel().tolist()]
        return {"array": entries, "type": value.dtype.name, "shape": list(value.shape)}
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, tuple | list):
        return {"tuple": [_plain(v) for v in value]}
    if isinstance(value, dict):
        return {"dict": [[_plain(k), _plain(v)] for k, v in value.items()]}
    if isinstance(value, CubicSpline):
        return {"spline": _plain(value.x), "coefficients": _plain(value.c)}
    if is_dataclass(value) and not isinstance(value, type):
        kind = type(value)
        named = {one.name: _plain(getattr(value, one.name)) for one in fields(value) if one.init}
        return {"record": f"{kind.__module__}.{kind.__qualname__}", "fields": named}
    raise ConfigError(f"a {type(value).__name__} cannot be written into a file of records")


def _record(value: Any) -> Any:
    """What was written."""
    if not isinstance(value, dict):
        return value
    if "number" in value:
        return ODD[value["number"]]
    if "array" in value:
        flat = [_record(v) for v in value["array"]] if _odd(value["array"]) else value["array"]
        return np.array(flat, dtype=value["type"]).reshape(value["shape"])
    if "tuple" in value:
        return tuple(_record(v) for v in value["tuple"])
    if "dict" in value:
        return {_record(k): _record(v) for k, v in value["dict"]}
    if "spline" in value:
        return CubicSpline.construct_fast(_record(value["coefficients"]), _record(value["spline"]), axis=0)
    module, _, name = value["record"].rpartition(".")
    if not module.startswith(PACKAGES):
        raise ValueError(f"{value['record']} is no record of this project")
    kind = getattr(importlib.import_module(module), name)
    if not is_dataclass(kind):
        raise ValueError(f"{value['record']} is no record")
    return kind(**{key: _record(entry) for key, entry in value["fields"].items()})


def _odd(entries: Any) -> bool:
    """Whether a flat list holds numbers that JSON has no word for."""
    return isinstance(entries, list) and any(isinstance(entry, dict) for entry in entries)
