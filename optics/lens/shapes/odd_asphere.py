"""Odd asphere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from pydantic import FiniteFloat

from optics.arrays import ArrayNamespace
from optics.errors import DomainError
from optics.lens.shapes.base import require_finite
from optics.lens.shapes.revolution import Asphere, conic_profile


@dataclass(frozen=True, slots=True, kw_only=True)
class OddAsphere(Asphere):
    """Conic plus polynomial in r: ``terms[j]`` [mm^-j] times r^(1+j); the first, a cone's, has to be 0."""

    terms: tuple[FiniteFloat, ...] = ()
    kind: ClassVar[str] = "odd_asphere"

    def __post_init__(self) -> None:
        require_finite(self, "terms")
        if self.terms and self.terms[0] != 0.0:
            raise DomainError(f"OddAsphere.terms[0] = {self.terms[0]}: a cone (axicon) has no vertex; it has to be 0")
        Asphere.__post_init__(self)

    @property
    def curvature(self) -> float:
        """Vertex curvature [1/mm], to which the term in r^2 belongs."""
        return 1.0 / self.radius_mm + (2.0 * self.terms[1] if len(self.terms) > 1 else 0.0)

    def parameters(self) -> tuple[float, ...]:
        """Curvature of the conic [1/mm], conic constant, coefficients from r^2 on."""
        return (1.0 / self.radius_mm, self.conic, *self.terms[1:])

    @classmethod
    def profile(cls, p: Sequence[Any], r2: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any]:
        base, base_slope, inside = conic_profile(p[0], p[1], r2, xp)
        r, poly, slope = xp.sqrt(r2), r2 * 0.0, r2 * 0.0
        for j in reversed(range(len(p) - 2)):
            poly = poly * r + p[2 + j]  # sum a_j r^j, times r^2
            slope = slope * r + (1.0 + 0.5 * j) * p[2 + j]  # dz/d(r^2) = dz/dr / (2 r)
        return base + r2 * poly, base_slope + slope, inside

    def flipped(self) -> Self:
        terms = tuple(-a if a else a for a in self.terms)
        return replace(self, radius_mm=-self.radius_mm, terms=terms)

    def scaled(self, factor: float) -> Self:
        scaled = tuple(a * factor**-j for j, a in enumerate(self.terms))
        return replace(self, radius_mm=self.radius_mm * factor, terms=scaled)
