"""The ray trace's array namespace on Dr.Jit (`optics.arrays.ArrayNamespace`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any
from weakref import ref

from optics.arrays import FloatArray
from optics.rays.trace import Rays
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

    sqrt = staticmethod(dr.sqrt)
    where = staticmethod(dr.select)
    maximum = staticmethod(dr.maximum)
    minimum = staticmethod(dr.minimum)

    @staticmethod
    def whole(value: Any) -> Any:
        """Elementwise floor, as integers."""
        return dr.int32_array_t(type(value))(dr.floor(value))

    def table(self, values: FloatArray) -> Any:
        """The constants, flat; uploaded once for as long as they live."""
        key = id(values)
        source, flat = self._tables.get(key, (None, None))
        if source is None or source() is not values:
            flat = uploaded(self.float_type, values)
            self._tables[key] = ref(values, lambda _: self._tables.pop(key, None)), flat
        return flat

    def take(self, table: Any, index: Any) -> Any:
        """Elements of the table."""
        return dr.gather(self.float_type, table, dr.uint32_array_t(type(index))(index))

    def rays(self, position: Sequence[Any], direction: Sequence[Any], wavelength_nm: Any, width: int = 1) -> Rays:
        """Rays without a path and a fate yet."""
        status = dr.zeros(dr.int32_array_t(self.float_type), width)
        (x, y, z), (dx, dy, dz) = position, direction
        return Rays(
            x=x, y=y, z=z, dx=dx, dy=dy, dz=dz, wavelength_nm=wavelength_nm,
            opl_mm=self.float_type(0.0), status=status, failed_at=status - 1,
        )  # fmt: skip

    def parameters(self, theta: Iterable[float]) -> Sequence[Any]:
        """Lens parameters as evaluated arrays of size one."""
        return [dr.opaque(self.float_type, float(value)) for value in theta]
