"""Cylinder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from pydantic import FiniteFloat

from optics.arrays import ArrayNamespace
from optics.lens.shapes.base import require_finite
from optics.lens.shapes.freeform import Freeform
from optics.lens.shapes.revolution import Curved, conic_profile, conic_rim_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class Cylinder(Freeform, Curved):
    """Conic section in y and z, straight along x."""

    conic: FiniteFloat = 0.0
    kind: ClassVar[str] = "cylinder"

    def __post_init__(self) -> None:
        require_finite(self, "radius_mm", "conic")
        Curved.__post_init__(self)

    @property
    def curvature(self) -> float:
        return 0.5 / self.radius_mm

    @property
    def rim_mm(self) -> float:
        return conic_rim_mm(self.radius_mm, self.conic)

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm], conic constant."""
        return (1.0 / self.radius_mm, self.conic)

    @classmethod
    def surface(cls, p: Sequence[Any], x: Any, y: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any, Any]:
        sag, slope, inside = conic_profile(p[0], p[1], y * y, xp)
        return sag + 0.0 * x, 0.0 * x, 2.0 * slope * y, inside
