"""Points of the unit disk as a kernel asks for them: from a table, or computed where they are needed.

Sobol points are computed from their index, so the memory of a render does not grow with the number of rays: bit
reversal and the second Sobol dimension (Sobol 1967; its matrix is Pascal's triangle modulo 2), each under a nested
uniform scrambling (Owen 1995) by hashing (Laine & Karras 2011; Burley 2020, JCGT 9(4), 1; constants by N. Vegdahl,
"Building a better LK hash", 2021).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import numpy as np
from numpy.typing import NDArray

__all__ = ["PupilPoints", "SobolPoints", "TablePoints"]

FloatArray = NDArray[np.float64]


class PupilPoints(Protocol):
    """Where in the unit disk rays start, for every wavelength node."""

    @property
    def count(self) -> int:
        """Points per wavelength node."""

    @property
    def weight(self) -> FloatArray:
        """Weights (count,), sum 1."""

    def sample(self, types: Any, node: Any, point: Any) -> tuple[Any, Any, Any]:
        """Coordinates and weight of point ``point`` of wavelength node ``node``, in Dr.Jit arrays.

        Parameters
        ----------
        types : object
            Array types ``Float64`` and ``UInt32`` (``mitsuba`` or ``drjit.llvm``).
        node, point : UInt32
            Which.
        """


@dataclass(frozen=True, slots=True, eq=False)
class TablePoints:
    """Given points.

    Attributes
    ----------
    points : (k, p, 2)
        Unit-disk points of every wavelength node.
    weight : (p,)
        Weights, sum 1.
    """

    points: FloatArray
    weight: FloatArray

    @property
    def count(self) -> int:
        """Points per wavelength node."""
        return self.points.shape[1]

    def sample(self, types: Any, node: Any, point: Any) -> tuple[Any, Any, Any]:
        """Look the point up."""
        F, U = types.Float64, types.UInt32
        at = node * dr.opaque(U, self.count) + point
        x, y = (F(np.ascontiguousarray(self.points[..., axis].ravel())) for axis in (0, 1))
        return dr.gather(F, x, at), dr.gather(F, y, at), dr.gather(F, F(self.weight), point)


@dataclass(frozen=True, slots=True)
class SobolPoints:
    """Scrambled Sobol points: node j has points j 2^n ... (j+1) 2^n - 1 of one sequence, each of these sets a net.

    Attributes
    ----------
    log2_count : int
        n.
    seed : int
        Of the scrambling.
    """

    log2_count: int
    seed: int

    @property
    def count(self) -> int:
        """Points per wavelength node."""
        return 1 << self.log2_count

    @property
    def weight(self) -> FloatArray:
        """Equal weights (count,)."""
        return np.full(self.count, 1.0 / self.count)

    def square(self, types: Any, index: Any) -> tuple[Any, Any]:
        """Points ``index`` of the scrambled sequence in the unit square."""
        F, U = types.Float64, types.UInt32
        seeds = np.random.SeedSequence([self.seed, 0x50B01]).generate_state(2)
        reverse = dr.brev(index)
        second = reverse
        for shift, mask in ((16, 0xFFFF), (8, 0xFF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
            second = second ^ ((second & U(mask)) << shift)
        u = dr.brev(_nested(U, index, dr.opaque(U, int(seeds[0]))))
        v = dr.brev(_nested(U, dr.brev(second), dr.opaque(U, int(seeds[1]))))
        return (F(u) + 0.5) * 2.0**-32, (F(v) + 0.5) * 2.0**-32

    def sample(self, types: Any, node: Any, point: Any) -> tuple[Any, Any, Any]:
        """Compute the point."""
        U = types.UInt32
        u, v = self.square(types, (node << dr.opaque(U, self.log2_count)) + point)
        radius, (sine, cosine) = dr.sqrt(u), dr.sincos(2.0 * np.pi * v)
        return radius * cosine, radius * sine, dr.opaque(types.Float64, 1.0 / self.count)


def _nested(U: Any, x: Any, seed: Any) -> Any:
    """Hash in which a bit depends on the bits below it only: on reversed digits, a nested uniform scrambling."""
    x = x ^ (x * U(0x3D20ADEA))
    x = x + seed
    x = x * ((seed >> 16) | 1)
    x = x ^ (x * U(0x05526C56))
    return x ^ (x * U(0x53A22864))
