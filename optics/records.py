"""Arrays of records: copied, shape-checked, finite, write-locked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from optics.errors import DomainError

Record = TypeVar("Record")


def concatenated(parts: Sequence[Record], **others: Any) -> Record:
    """One record with the concatenated arrays of several of its kind."""
    kind: Any = type(parts[0])
    names = [field.name for field in fields(kind) if field.name not in others]
    joined: Record = kind(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}, **others)
    return joined


def locked(values: Any, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Contiguous, write-locked copy of ``values``."""
    array = np.array(values, dtype=dtype, order="C", copy=True)
    array.setflags(write=False)
    return array


def freeze(
    record: Any,
    name: str,
    *,
    shape: tuple[int | str, ...],
    dtype: DTypeLike = np.float64,
    finite: bool = True,
    sizes: dict[str, int] | None = None,
) -> NDArray[Any]:
    """Replace ``record.name`` by a checked, write-locked copy, and return it; for ``__post_init__`` of frozen records.

    A string in ``shape`` stands for a size that must agree wherever the same ``sizes``, filled on first use, is handed
    on. ``finite`` refuses NaN and infinity of floating-point types. DomainError on a wrong shape or value.
    """
    owner = type(record).__name__
    try:
        array = locked(getattr(record, name), dtype)
    except (TypeError, ValueError) as error:
        raise DomainError(f"{owner}.{name}: not convertible to an array of {np.dtype(dtype).name} ({error})") from None
    table = {} if sizes is None else sizes
    ok = array.ndim == len(shape)
    if ok:
        for axis, wanted in zip(array.shape, shape, strict=True):
            ok &= axis == (table.setdefault(wanted, axis) if isinstance(wanted, str) else wanted)
    if not ok:
        spelled = tuple(table.get(s, s) if isinstance(s, str) else s for s in shape)
        raise DomainError(f"{owner}.{name}: shape {array.shape} where {spelled} is needed")
    if finite and np.issubdtype(array.dtype, np.floating) and not np.all(np.isfinite(array)):
        bad = np.argwhere(~np.isfinite(array))[0].tolist()
        raise DomainError(f"{owner}.{name}: value at index {bad} is {array[tuple(bad)]}; finite values are needed")
    object.__setattr__(record, name, array)
    return array


def freeze_all(
    record: Any,
    *,
    dtype: DTypeLike = np.float64,
    finite: bool = True,
    sizes: dict[str, int] | None = None,
    **shapes: tuple[int | str, ...],
) -> None:
    """`freeze` of several fields, each with its shape; a name in a shape stands for the same size in all of them."""
    table = {} if sizes is None else sizes
    for name, shape in shapes.items():
        freeze(record, name, shape=shape, dtype=dtype, finite=finite, sizes=table)


def freeze_alike(record: Any, *names: str, shape: tuple[int | str, ...], finite: bool = True) -> None:
    """`freeze` of fields of one shape; a name in it stands for the same size in all of them."""
    sizes: dict[str, int] = {}
    for name in names:
        freeze(record, name, shape=shape, finite=finite, sizes=sizes)
