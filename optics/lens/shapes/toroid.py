"""Toroid: a profile in the y-z plane, turned about an axis parallel to y; a cylinder where that is far away."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from pydantic import FiniteFloat

from optics.arrays import ArrayNamespace
from optics.errors import DomainError
from optics.lens.shapes.base import require_finite
from optics.lens.shapes.freeform import Freeform
from optics.lens.shapes.revolution import Curved, conic_profile, conic_rim_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class Toroid(Freeform, Curved):
    """Conic plus ``terms[j]`` [mm^-(1+2j)] times y^(2+2j), turned about the line x = 0, z = ``rotation_radius_mm``."""

    radius_mm: float = math.inf
    conic: FiniteFloat = 0.0
    terms: tuple[FiniteFloat, ...] = ()
    rotation_radius_mm: float = math.inf
    kind: ClassVar[str] = "toroid"

    def __post_init__(self) -> None:
        require_finite(self, "conic", "terms")
        if self.rotation_radius_mm == 0.0 or math.isnan(self.rotation_radius_mm):
            raise DomainError(
                f"Toroid.rotation_radius_mm = {self.rotation_radius_mm}: a number other than zero is needed "
                "(inf for a cylinder)"
            )
        Curved.__post_init__(self)

    @property
    def curvature(self) -> float:
        profile = 1.0 / self.radius_mm + (2.0 * self.terms[0] if self.terms else 0.0)
        return 0.5 * (profile + 1.0 / self.rotation_radius_mm)

    @property
    def rim_mm(self) -> float:
        """Distance at which it ends along x or y, whichever is nearer [mm]."""
        return min(conic_rim_mm(self.radius_mm, self.conic), abs(self.rotation_radius_mm))

    def parameters(self) -> tuple[float, ...]:
        """Reciprocal radius of the turn [1/mm], curvature of the profile [1/mm], conic constant, its polynomial."""
        return (1.0 / self.rotation_radius_mm, 1.0 / self.radius_mm, self.conic, *self.terms)

    @classmethod
    def surface(cls, p: Sequence[Any], x: Any, y: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any, Any]:
        y2, turn = y * y, p[0]
        base, base_slope, inside = conic_profile(p[1], p[2], y2, xp)
        poly, slope = 0.0 * y2, 0.0 * y2
        for a in reversed(p[3:]):
            slope = slope * y2 + poly
            poly = poly * y2 + a
        f = base + y2 * poly
        fy = 2.0 * y * (base_slope + poly + y2 * slope)
        # z = R - sqrt((R - f)^2 - x^2), written so that R may be infinite
        reach = 1.0 - turn * f
        w2 = reach * reach - turn * turn * x * x
        w = xp.sqrt(xp.maximum(w2, 1e-12))
        sag = f + turn * x * x / (reach + w)
        return sag, turn * x / w, fy * reach / w, inside & (w2 > 0.0) & (reach > 0.0)

    def flipped(self) -> Self:
        return replace(
            self,
            radius_mm=-self.radius_mm,
            terms=tuple(-a for a in self.terms),
            rotation_radius_mm=-self.rotation_radius_mm,
        )

    def scaled(self, factor: float) -> Self:
        return replace(
            self,
            radius_mm=self.radius_mm * factor,
            terms=tuple(a * factor ** -(1 + 2 * j) for j, a in enumerate(self.terms)),
            rotation_radius_mm=self.rotation_radius_mm * factor,
        )
