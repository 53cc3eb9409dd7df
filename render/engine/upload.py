"""NumPy arrays as Dr.Jit arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["uploaded"]


LANES = 64
"""More than any kernel's vectors hold."""


def uploaded(kind: Any, values: NDArray[Any]) -> Any:
    """Values as a flat Dr.Jit array of a kind.

    Dr.Jit takes over NumPy's memory as it is, and kernels read whole vectors: beyond the last value too, where a page
    that is not mapped may begin. So there is room behind them.
    """
    flat = np.ascontiguousarray(values).ravel()
    if flat.size % LANES:
        room = np.zeros(flat.size + LANES, flat.dtype)
        room[: flat.size] = flat
        flat = room[: flat.size]
    return kind(flat)
