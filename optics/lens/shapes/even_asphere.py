"""Even asphere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from pydantic import FiniteFloat

from optics.arrays import NUMPY, ArrayNamespace, FloatArray
from optics.lens.shapes.base import Hit, Shape, require_finite
from optics.lens.shapes.conic import Conic, conic_rim_mm
from optics.lens.shapes.plane import Plane
from optics.lens.shapes.revolution import Curved, conic_profile, newton_hit, profile_sag
from optics.lens.shapes.sphere import Sphere

__all__ = ["EvenAsphere"]


@dataclass(frozen=True, slots=True, kw_only=True)
class EvenAsphere(Curved):
    """Conic plus even polynomial: ``asphere[j]`` [mm^-(3+2j)] times r^(4+2j); ``radius_mm`` may be infinite."""

    radius_mm: float = math.inf
    conic: FiniteFloat = 0.0
    asphere: tuple[FiniteFloat, ...] = ()
    kind: ClassVar[str] = "even_asphere"

    def __post_init__(self) -> None:
        require_finite(self, conic=self.conic, **{f"asphere[{i}]": a for i, a in enumerate(self.asphere)})
        Curved.__post_init__(self)

    @property
    def rim_mm(self) -> float:
        """Where the conic ends [mm]."""
        return conic_rim_mm(self.radius_mm, self.conic)

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm], conic constant, polynomial coefficients."""
        return (self.curvature, self.conic, *self.asphere)

    @staticmethod
    def _profile(p: Sequence[Any], r2: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any]:
        """Sag, its derivative with respect to r^2, whether the conic reaches so far."""
        base, base_slope, inside = conic_profile(p[0], p[1], r2, xp)
        poly, slope = r2 * 0.0, r2 * 0.0
        for a in reversed(p[2:]):
            slope = slope * r2 + poly
            poly = poly * r2 + a
        # poly(r2) = sum a_j r2^j; the sag term is r2^2 poly
        return base + r2 * r2 * poly, base_slope + 2.0 * r2 * poly + r2 * r2 * slope, inside

    @staticmethod
    def intersect(p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        """Intersect rays that stand on the vertex plane; parameters: c, k, a4, a6, ..."""
        start = Conic.intersect(p, x, y, d, xp).path
        return newton_hit(lambda r2: EvenAsphere._profile(p, r2, xp), start, x, y, d, xp)

    def sag(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Sag [mm]; NaN beyond the rim."""
        return profile_sag(lambda r2: EvenAsphere._profile(self.parameters(), r2, NUMPY), x_mm, y_mm)

    def flipped(self) -> Self:
        """The surface seen from behind."""
        return replace(self, radius_mm=-self.radius_mm, asphere=tuple(-a for a in self.asphere))

    def scaled(self, factor: float) -> Self:
        """The surface expanded uniformly."""
        scaled = tuple(a * factor ** -(3 + 2 * j) for j, a in enumerate(self.asphere))
        return replace(self, radius_mm=self.radius_mm * factor, asphere=scaled)

    def simplest(self) -> Shape:
        """The conic, sphere or plane that it is without a polynomial."""
        if self.asphere:
            return self
        if math.isinf(self.radius_mm):
            return Plane()
        return Conic(radius_mm=self.radius_mm, conic=self.conic) if self.conic else Sphere(radius_mm=self.radius_mm)
