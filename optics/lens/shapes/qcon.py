"""Asphere of Forbes' strong kind, Qcon."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, FiniteFloat

from optics.arrays import ArrayNamespace
from optics.forbes import qcon_sum
from optics.lens.shapes.base import require_finite, require_positive
from optics.lens.shapes.revolution import Asphere, conic_profile


@dataclass(frozen=True, slots=True, kw_only=True)
class Qcon(Asphere):
    """Conic plus u^4 times the sum of ``q_mm[m]`` Qcon_m(u^2), u = r / ``norm_radius_mm`` (Forbes 2007, eq. 2.2)."""

    norm_radius_mm: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    q_mm: tuple[FiniteFloat, ...] = ()
    kind: ClassVar[str] = "qcon"

    def __post_init__(self) -> None:
        require_finite(self, **{f"q_mm[{i}]": a for i, a in enumerate(self.q_mm)})
        require_positive(self, norm_radius_mm=self.norm_radius_mm)
        Asphere.__post_init__(self)

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm], conic constant, reciprocal square of the normalisation radius, coefficients."""
        return (self.curvature, self.conic, self.norm_radius_mm**-2, *self.q_mm)

    @classmethod
    def profile(cls, p: Sequence[Any], r2: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any]:
        base, base_slope, inside = conic_profile(p[0], p[1], r2, xp)
        x = p[2] * r2
        total, slope = qcon_sum(p[3:], x)
        return base + x * x * total, base_slope + p[2] * x * (2.0 * total + x * slope), inside

    def flipped(self) -> Self:
        return replace(self, radius_mm=-self.radius_mm, q_mm=tuple(-a for a in self.q_mm))
