"""Sphere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from optics.arrays import NUMPY, ArrayNamespace, FloatArray
from optics.lens.shapes.base import Hit, Shape, require_finite
from optics.lens.shapes.conic import Conic
from optics.lens.shapes.revolution import Curved, conic_profile, profile_sag


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere(Curved):
    """Sphere.

    Attributes
    ----------
    radius_mm : float
        Radius [mm]; positive when the centre of curvature lies on the +z side.
    """

    kind: ClassVar[str] = "sphere"

    def __post_init__(self) -> None:
        require_finite(self, "radius_mm")
        Curved.__post_init__(self)

    @property
    def rim_mm(self) -> float:
        return abs(self.radius_mm)

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm]."""
        return (self.curvature,)

    @staticmethod
    def intersect(p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        c = p[0]
        dx, dy, dz = d
        f = c * (x * x + y * y)
        g = dz - c * (x * dx + y * dy)
        disc = g * g - c * f
        cos_i = xp.sqrt(xp.maximum(disc, 0.0))
        s = f / (g + cos_i)
        x, y, z = x + s * dx, y + s * dy, s * dz
        nz = 1.0 - c * z
        return Hit(s, x, y, z, -(c * x), -(c * y), nz, cos_i, (disc > 0.0) & (g > 0.0) & (nz > 0.0))

    def sag(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        return profile_sag(lambda r2: conic_profile(self.curvature, 0.0, r2, NUMPY), x_mm, y_mm)

    def changed(self, name: str, by: float) -> Shape:
        """The sphere with another radius, or with a conic constant: then a conic."""
        if name == "conic":
            return Conic(radius_mm=self.radius_mm, conic=by)
        return Curved.changed(self, name, by)
