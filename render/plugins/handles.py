"""Records in Mitsuba's scene dictionaries: handles or files in place of Python objects."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

import numpy as np

from optics.arrays import FloatArray
from optics.errors import ConfigError, unknown_name
from optics.record_files import read_record

_Record = TypeVar("_Record")
KEPT = 64
"""Records that are kept alive; of any more, the first ones are let go."""


class Handles(Generic[_Record]):
    """Handles of records of one kind."""

    def __init__(self, kind: type[_Record], name: str) -> None:
        self.kind, self.name = kind, name
        self._records: dict[str, _Record] = {}

    def share(self, record: _Record) -> str:
        """Handle of a record, which is kept alive until `KEPT` others have been shared."""
        handle = f"{self.name}-{id(record):x}"
        self._records.pop(handle, None)
        self._records[handle] = record
        while len(self._records) > KEPT:
            self._records.pop(next(iter(self._records)))
        return handle

    def find(self, handle: str) -> _Record:
        """Record of a handle."""
        if handle not in self._records:
            raise unknown_name(f"{self.name} handle", handle, self._records)
        return self._records[handle]

    def named(self, mi: Any, name: str) -> _Record:
        """Record of a handle or of a file (.json) that `optics.record_files.write_record` wrote."""
        return read_record(resolved(mi, name), self.kind) if name.endswith(".json") else self.find(name)


def resolved(mi: Any, name: str) -> str:
    """Path of a file that a scene names: in the folder of the scene file, or in the working directory."""
    return str(mi.file_resolver().resolve(name))


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
