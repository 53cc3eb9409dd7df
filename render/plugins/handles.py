"""Records in Mitsuba's scene dictionaries: properties hold no Python objects, so a handle stands for the record."""

from __future__ import annotations

from typing import Generic, TypeVar

from optics.errors import unknown_name

__all__ = ["Handles"]

_Record = TypeVar("_Record")
KEPT = 64
"""Records that are kept alive; of any more, the first ones are let go."""


class Handles(Generic[_Record]):
    """Handles of records of one kind.

    Parameters
    ----------
    kind : str
        What the records are, for messages.
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._records: dict[str, _Record] = {}

    def share(self, record: _Record) -> str:
        """Handle of a record, which is kept alive until `KEPT` others have been shared."""
        handle = f"{self.kind}-{id(record):x}"
        self._records.pop(handle, None)
        self._records[handle] = record
        while len(self._records) > KEPT:
            self._records.pop(next(iter(self._records)))
        return handle

    def find(self, handle: str) -> _Record:
        """Record of a handle.

        Raises
        ------
        ConfigError
            If there is none.
        """
        if handle not in self._records:
            raise unknown_name(f"{self.kind} handle", handle, self._records)
        return self._records[handle]
