"""Asphere of Forbes' mild kind, Qbfs: departure from a best-fit sphere or conic along its normal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, FiniteFloat

from optics.arrays import NUMPY, ArrayNamespace, FloatArray
from optics.forbes import bfs_from_q, bfs_sum
from optics.lens.shapes.base import Hit, require_finite, require_positive
from optics.lens.shapes.revolution import Curved, conic_path, conic_profile, conic_rim_mm, newton_hit, profile_sag


@dataclass(frozen=True, slots=True, kw_only=True)
class Qbfs(Curved):
    """Conic plus u^2 (1 - u^2) sqrt(1 + s^2) times the sum of ``q_mm[m]`` Qbfs_m(u^2) (Forbes 2007, eq. 3.1).

    u = r / ``norm_radius_mm``; s is the slope of the conic, sqrt(1 + s^2) = sqrt(1 - k c^2 r^2) / sqrt(1 - (1 + k) c^2
    r^2), which is Forbes' 1 / sqrt(1 - c^2 r^2) for a sphere. The conic meets the surface at the vertex and at u = 1.
    """

    radius_mm: float = math.inf
    norm_radius_mm: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    q_mm: tuple[FiniteFloat, ...] = ()
    conic: FiniteFloat = 0.0
    kind: ClassVar[str] = "qbfs"

    def __post_init__(self) -> None:
        require_finite(self, conic=self.conic, **{f"q_mm[{i}]": a for i, a in enumerate(self.q_mm)})
        require_positive(self, norm_radius_mm=self.norm_radius_mm)
        Curved.__post_init__(self)

    @property
    def rim_mm(self) -> float:
        """Largest radius of the conic [mm]."""
        return conic_rim_mm(self.radius_mm, self.conic)

    @property
    def curvature(self) -> float:
        """Vertex curvature [1/mm], that of the conic and that of the departure."""
        total, _ = bfs_sum(bfs_from_q(self.q_mm), 0.0)
        return 1.0 / self.radius_mm + 2.0 * float(total) / self.norm_radius_mm**2

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm] and constant of the conic, reciprocal square of the normalisation radius, coefficients."""
        return (1.0 / self.radius_mm, self.conic, self.norm_radius_mm**-2, *bfs_from_q(self.q_mm))

    @staticmethod
    def _profile(p: Sequence[Any], r2: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any]:
        """Sag, its derivative with respect to r^2, whether the conic reaches so far."""
        base, base_slope, inside = conic_profile(p[0], p[1], r2, xp)
        c2 = p[0] * p[0]
        over, under = xp.maximum(1.0 - p[1] * c2 * r2, 1e-12), xp.maximum(1.0 - (1.0 + p[1]) * c2 * r2, 1e-12)
        along = xp.sqrt(over / under)  # of the conic's meridian, per radius
        x = p[2] * r2
        total, slope = bfs_sum(p[3:], x)
        bump = x * (1.0 - x)
        bend = 0.5 * c2 * ((1.0 + p[1]) / under - p[1] / over)
        rise = p[2] * ((1.0 - 2.0 * x) * total + bump * slope) + bend * bump * total
        return base + bump * total * along, base_slope + rise * along, inside

    @staticmethod
    def intersect(p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        start = conic_path(p[0], p[1], x, y, d, xp)
        return newton_hit(lambda r2: Qbfs._profile(p, r2, xp), start, x, y, d, xp)

    def sag(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        return profile_sag(lambda r2: self._profile(self.parameters(), r2, NUMPY), x_mm, y_mm)

    def flipped(self) -> Self:
        return replace(self, radius_mm=-self.radius_mm, q_mm=tuple(-a for a in self.q_mm))
