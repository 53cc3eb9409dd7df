"""Array types, and the array operations by which one source of the ray trace runs on NumPy and on Dr.Jit.

Arithmetic, comparison and mask operators are common to both libraries. The Dr.Jit counterpart of the functions here is
`render.engine.arrays.DrJitArrays`, which this module does not import.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class ArrayNamespace(Protocol):
    """Array operations of the trace."""

    def sqrt(self, value: Any) -> Any:
        """Elementwise square root."""

    def where(self, mask: Any, if_true: Any, if_false: Any) -> Any:
        """Elementwise selection."""

    def maximum(self, value: Any, other: Any) -> Any:
        """Elementwise maximum."""

    def minimum(self, value: Any, other: Any) -> Any:
        """Elementwise minimum."""

    def whole(self, value: Any) -> Any:
        """Elementwise floor, as integers."""

    def table(self, values: FloatArray) -> Any:
        """Flat copy of constants that `take` reads."""

    def take(self, table: Any, index: Any) -> Any:
        """Elements of a `table`."""

    def parameters(self, theta: Iterable[float]) -> Sequence[Any]:
        """Lens parameters in the form used by the arithmetic."""


class NumpyArrays:
    """NumPy float64; parameters stay Python floats."""

    @staticmethod
    def sqrt(value: Any) -> Any:
        """Elementwise square root."""
        return np.sqrt(value)

    @staticmethod
    def where(mask: Any, if_true: Any, if_false: Any) -> Any:
        """Elementwise selection."""
        return np.where(mask, if_true, if_false)

    @staticmethod
    def maximum(value: Any, other: Any) -> Any:
        """Elementwise maximum."""
        return np.maximum(value, other)

    @staticmethod
    def minimum(value: Any, other: Any) -> Any:
        """Elementwise minimum."""
        return np.minimum(value, other)

    @staticmethod
    def whole(value: Any) -> Any:
        """Elementwise floor, as integers."""
        return np.floor(value).astype(np.int64)

    @staticmethod
    def table(values: FloatArray) -> Any:
        """The constants, flat."""
        return values.ravel()

    @staticmethod
    def take(table: Any, index: Any) -> Any:
        """Elements of the table."""
        return table[index]

    @staticmethod
    def parameters(theta: Iterable[float]) -> Sequence[Any]:
        """Lens parameters as Python floats."""
        return [float(value) for value in theta]


NUMPY = NumpyArrays()
