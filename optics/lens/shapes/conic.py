"""Conicoid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from pydantic import FiniteFloat

from optics.arrays import NUMPY, ArrayNamespace, FloatArray
from optics.lens.shapes.base import Hit, require_finite
from optics.lens.shapes.revolution import Curved, conic_profile, conic_rim_mm, profile_sag


@dataclass(frozen=True, slots=True, kw_only=True)
class Conic(Curved):
    """Conicoid: k < -1 hyperboloid, -1 paraboloid, -1 < k < 0 prolate, 0 sphere, > 0 oblate ellipsoid.

    Attributes
    ----------
    radius_mm : float
        Vertex radius [mm]; positive when the centre of curvature lies on the +z side.
    conic : float
        Conic constant k.
    """

    conic: FiniteFloat
    kind: ClassVar[str] = "conic"

    def __post_init__(self) -> None:
        require_finite(self, "radius_mm", "conic")
        Curved.__post_init__(self)

    @property
    def rim_mm(self) -> float:
        return conic_rim_mm(self.radius_mm, self.conic)

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm], conic constant."""
        return (self.curvature, self.conic)

    @staticmethod
    def intersect(p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        c, k = p[0], p[1]
        dx, dy, dz = d
        f = c * (x * x + y * y)
        g = dz - c * (x * dx + y * dy)
        disc = g * g - c * (1.0 + k * dz * dz) * f
        root = xp.sqrt(xp.maximum(disc, 0.0))
        s = f / (g + root)
        x, y, z = x + s * dx, y + s * dy, s * dz
        nx, ny, nz = -(c * x), -(c * y), 1.0 - (1.0 + k) * c * z
        scale = 1.0 / xp.sqrt(nx * nx + ny * ny + nz * nz)
        valid = (disc > 0.0) & (g > 0.0) & (nz > 0.0)
        return Hit(s, x, y, z, nx * scale, ny * scale, nz * scale, root * scale, valid)

    def sag(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        return profile_sag(lambda r2: conic_profile(self.curvature, self.conic, r2, NUMPY), x_mm, y_mm)
