"""Even asphere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from pydantic import FiniteFloat

from optics.arrays import ArrayNamespace
from optics.lens.shapes.base import Shape, require_finite
from optics.lens.shapes.conic import Conic
from optics.lens.shapes.plane import Plane
from optics.lens.shapes.revolution import Asphere, conic_profile
from optics.lens.shapes.sphere import Sphere


@dataclass(frozen=True, slots=True, kw_only=True)
class EvenAsphere(Asphere):
    """Conic plus even polynomial.

    Attributes
    ----------
    radius_mm : float
        Vertex radius [mm]; may be infinite.
    conic : float
        Conic constant.
    asphere : tuple of float
        ``asphere[j]`` [mm^-(3+2j)] times r^(4+2j).
    """

    asphere: tuple[FiniteFloat, ...] = ()
    kind: ClassVar[str] = "even_asphere"

    def __post_init__(self) -> None:
        require_finite(self, "asphere")
        Asphere.__post_init__(self)

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm], conic constant, polynomial coefficients."""
        return (self.curvature, self.conic, *self.asphere)

    @classmethod
    def profile(cls, p: Sequence[Any], r2: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any]:
        base, base_slope, inside = conic_profile(p[0], p[1], r2, xp)
        poly, slope = r2 * 0.0, r2 * 0.0
        for a in reversed(p[2:]):
            slope = slope * r2 + poly
            poly = poly * r2 + a
        # poly(r2) = sum a_j r2^j; the sag term is r2^2 poly
        return base + r2 * r2 * poly, base_slope + 2.0 * r2 * poly + r2 * r2 * slope, inside

    def flipped(self) -> Self:
        return replace(self, radius_mm=-self.radius_mm, asphere=tuple(-a for a in self.asphere))

    def scaled(self, factor: float) -> Self:
        scaled = tuple(a * factor ** -(3 + 2 * j) for j, a in enumerate(self.asphere))
        return replace(self, radius_mm=self.radius_mm * factor, asphere=scaled)

    def simplest(self) -> Shape:
        """The conic, sphere or plane that it is without a polynomial."""
        if self.asphere:
            return self
        if math.isinf(self.radius_mm):
            return Plane()
        return Conic(radius_mm=self.radius_mm, conic=self.conic) if self.conic else Sphere(radius_mm=self.radius_mm)
