"""Biconic."""

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
from optics.lens.shapes.revolution import conic_rim_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class Biconic(Freeform):
    """z = (cx x^2 + cy y^2) / (1 + sqrt(1 - (1 + kx) cx^2 x^2 - (1 + ky) cy^2 y^2)); radii may be infinite."""

    radius_x_mm: float = math.inf
    radius_y_mm: float = math.inf
    conic_x: FiniteFloat = 0.0
    conic_y: FiniteFloat = 0.0
    kind: ClassVar[str] = "biconic"

    def __post_init__(self) -> None:
        require_finite(self, "conic_x", "conic_y")
        for name in ("radius_x_mm", "radius_y_mm"):
            radius = getattr(self, name)
            if radius == 0.0 or math.isnan(radius):
                raise DomainError(f"Biconic.{name} = {radius}: a number other than zero is needed (inf for none)")

    @property
    def curvature(self) -> float:
        return 0.5 / self.radius_x_mm + 0.5 / self.radius_y_mm

    @property
    def rim_mm(self) -> float:
        """Distance at which it ends along x or y, whichever is nearer [mm]."""
        return min(conic_rim_mm(self.radius_x_mm, self.conic_x), conic_rim_mm(self.radius_y_mm, self.conic_y))

    def parameters(self) -> tuple[float, ...]:
        """Curvatures [1/mm] and conic constants along x, y."""
        return (1.0 / self.radius_x_mm, 1.0 / self.radius_y_mm, self.conic_x, self.conic_y)

    @classmethod
    def surface(cls, p: Sequence[Any], x: Any, y: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any, Any]:
        cx, cy, kx, ky = p
        w2 = 1.0 - (1.0 + kx) * cx * cx * x * x - (1.0 + ky) * cy * cy * y * y
        w = xp.sqrt(xp.maximum(w2, 1e-12))
        below = 1.0 / (1.0 + w)
        sag = (cx * x * x + cy * y * y) * below
        rest = sag * below / w
        along_x = cx * x * (2.0 * below + (1.0 + kx) * cx * rest)
        along_y = cy * y * (2.0 * below + (1.0 + ky) * cy * rest)
        return sag, along_x, along_y, w2 > 0.0

    def flipped(self) -> Self:
        return replace(self, radius_x_mm=-self.radius_x_mm, radius_y_mm=-self.radius_y_mm)

    def scaled(self, factor: float) -> Self:
        return replace(self, radius_x_mm=self.radius_x_mm * factor, radius_y_mm=self.radius_y_mm * factor)
