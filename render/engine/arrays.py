"""The ray trace's array namespace on Dr.Jit (`optics.arrays.ArrayNamespace`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any
from weakref import ref

from optics.arrays import FloatArray
from render.engine.jit import dr
from render.engine.upload import uploaded


class DrJitArrays:
    """Dr.Jit arrays of one float type.

    Lens parameters become evaluated arrays of size one: a kernel reads them from memory, so another lens of the same
    structure reuses the kernel. Literals would be baked into it.
    """

    def __init__(self, float_type: Any) -> None:
        self.float_type = float_type
        self._tables: dict[int, tuple[ref[FloatArray], Any]] = {}

    @staticmethod
    def sqrt(value: Any) -> Any:
        """Elementwise square root."""
        return dr.sqrt(value)

    @staticmethod
    def where(mask: Any, if_true: Any, if_false: Any) -> Any:
        """Elementwise selection."""
        return dr.select(mask, if_true, if_false)

    @staticmethod
    def maximum(value: Any, other: Any) -> Any:
        """Elementwise maximum."""
        return dr.maximum(value, other)

    @staticmethod
    def minimum(value: Any, other: Any) -> Any:
        """Elementwise minimum."""
        return dr.minimum(value, other)

    @staticmethod
    def whole(value: Any) -> Any:
        """Elementwise floor, as integers."""
        return dr.int32_array_t(type(value))(dr.floor(value))

    def table(self, values: FloatArray) -> Any:
        """The constants, flat; uploaded once for as long as they live."""
        held = self._tables.get(id(values))
        if held is None or held[0]() is not values:
            flat, key = uploaded(self.float_type, values), id(values)
            self._tables[key] = held = (ref(values, lambda _: self._tables.pop(key, None)), flat)
        return held[1]

    def take(self, table: Any, index: Any) -> Any:
        """Elements of the table."""
        return dr.gather(self.float_type, table, dr.uint32_array_t(type(index))(index))

    def parameters(self, theta: Iterable[float]) -> Sequence[Any]:
        """Lens parameters as evaluated arrays of size one."""
        return [dr.opaque(self.float_type, float(value)) for value in theta]
