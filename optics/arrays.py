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

    sqrt, where = staticmethod(np.sqrt), staticmethod(np.where)
    maximum, minimum = staticmethod(np.maximum), staticmethod(np.minimum)

    @staticmethod
    def whole(value: Any) -> Any:
        return np.floor(value).astype(np.int64)

    @staticmethod
    def table(values: FloatArray) -> Any:
        return values.ravel()

    @staticmethod
    def take(table: Any, index: Any) -> Any:
        return table[index]

    @staticmethod
    def parameters(theta: Iterable[float]) -> Sequence[Any]:
        return [float(value) for value in theta]


NUMPY = NumpyArrays()
