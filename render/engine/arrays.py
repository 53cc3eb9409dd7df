"""The ray trace's array namespace on Dr.Jit (`optics.arrays.ArrayNamespace`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from render.engine.jit import dr

__all__ = ["DrJitArrays"]


class DrJitArrays:
    """Dr.Jit arrays of one float type.

    Lens parameters become evaluated arrays of size one: a kernel reads them from memory, so another lens of the same
    structure reuses the kernel. Literals would be baked into it.

    Parameters
    ----------
    float_type : type
        ``drjit.llvm.Float64``, ``drjit.cuda.ad.Float64``, ...
    """

    def __init__(self, float_type: Any) -> None:
        self.float_type = float_type

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

    def parameters(self, theta: Iterable[float]) -> Sequence[Any]:
        """Lens parameters as evaluated arrays of size one."""
        return [dr.opaque(self.float_type, float(value)) for value in theta]
