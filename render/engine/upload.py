"""NumPy arrays as Dr.Jit arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LANES = 64
"""More than any kernel's vectors hold."""


def uploaded(kind: Any, values: NDArray[Any]) -> Any:
    """Values as a flat Dr.Jit array of a kind.

    Dr.Jit takes over NumPy's memory, and kernels read whole vectors, also beyond the last value, where a page that is
    not mapped may begin. The memory is therefore padded.
    """
    flat = np.ascontiguousarray(values).ravel()
    if flat.size % LANES:
        flat = np.pad(flat, (0, LANES))[: flat.size]
    return kind(flat)
