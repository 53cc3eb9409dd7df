"""Records in Mitsuba's scene dictionaries: handles or files in place of Python objects."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

import numpy as np

from optics.arrays import FloatArray
from optics.errors import ConfigError, unknown_name
from optics.record_files import read_record
from render.engine import Engine

_Record = TypeVar("_Record")
MOST_RECORDS = 64
"""Records that are kept alive; of any more, the first ones are released."""


class Handles(Generic[_Record]):
    """Handles of records of one kind."""

    def __init__(self, kind: type[_Record], name: str) -> None:
        self.kind, self.name = kind, name
        self._records: dict[str, _Record] = {}

    def share(self, record: _Record) -> str:
        """Handle of a record, which is kept alive until `MOST_RECORDS` others have been shared."""
        handle = f"{self.name}-{id(record):x}"
        self._records.pop(handle, None)
        self._records[handle] = record
        while len(self._records) > MOST_RECORDS:
            self._records.pop(next(iter(self._records)))
        return handle

    def named(self, name: str) -> _Record:
        """Record of a handle or of a file (.json) that `optics.record_files.write_record` wrote."""
        if name.endswith(".json"):
            return read_record(resolved(name), self.kind)
        if name not in self._records:
            raise unknown_name(f"{self.name} handle", name, self._records)
        return self._records[name]


def resolved(name: str) -> str:
    """Path of a file that a scene names: in the folder of the scene file, or in the working directory."""
    return str(Engine.active().mitsuba.file_resolver().resolve(name))


def rotation_of(props: Any, plugin: str) -> FloatArray | None:
    """Property ``rotation``: nine numbers, row by row, as a tensor or written out; None without."""
    if "rotation" not in props:
        return None
    value = props["rotation"]
    try:
        numbers = [float(v) for v in value.replace(",", " ").split()] if isinstance(value, str) else value
        return np.array(numbers, dtype=float).reshape(3, 3)
    except ValueError:
        raise ConfigError(f"{plugin}: rotation needs nine numbers, row by row") from None
