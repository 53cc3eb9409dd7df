"""Aspheres of Forbes (2007, Opt. Express 15, 5218): mild ones, Qbfs, and strong ones, Qcon."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from pydantic import FiniteFloat

from optics.arrays import ArrayNamespace
from optics.forbes import bfs_from_q, bfs_sum, qcon_sum
from optics.lens.shapes.base import require_finite, require_positive
from optics.lens.shapes.revolution import Asphere, conic_profile
from optics.validate import Positive


@dataclass(frozen=True, slots=True, kw_only=True)
class _ForbesAsphere(Asphere):
    """Conic plus a departure by polynomials Q_m(u^2), u = r / ``norm_radius_mm``, with coefficients ``q_mm[m]``."""

    norm_radius_mm: Positive
    q_mm: tuple[FiniteFloat, ...] = ()

    def __post_init__(self) -> None:
        require_finite(self, "q_mm")
        require_positive(self, "norm_radius_mm")
        Asphere.__post_init__(self)

    def flipped(self) -> Self:
        return replace(self, radius_mm=-self.radius_mm, q_mm=tuple(-a for a in self.q_mm))


@dataclass(frozen=True, slots=True, kw_only=True)
class Qcon(_ForbesAsphere):
    """Conic plus u^4 times the sum of ``q_mm[m]`` Qcon_m(u^2), u = r / ``norm_radius_mm`` (Forbes 2007, eq. 2.2)."""

    kind: ClassVar[str] = "qcon"

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm], conic constant, reciprocal square of the normalisation radius, coefficients."""
        return (self.curvature, self.conic, self.norm_radius_mm**-2, *self.q_mm)

    @classmethod
    def profile(cls, p: Sequence[Any], r2: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any]:
        base, base_slope, inside = conic_profile(p[0], p[1], r2, xp)
        x = p[2] * r2
        total, slope = qcon_sum(p[3:], x)
        return base + x * x * total, base_slope + p[2] * x * (2.0 * total + x * slope), inside


@dataclass(frozen=True, slots=True, kw_only=True)
class Qbfs(_ForbesAsphere):
    """Conic plus u^2 (1 - u^2) sqrt(1 + s^2) times the sum of ``q_mm[m]`` Qbfs_m(u^2) (Forbes 2007, eq. 3.1).

    u = r / ``norm_radius_mm``; s is the slope of the conic, sqrt(1 + s^2) = sqrt(1 - k c^2 r^2) / sqrt(1 - (1 + k) c^2
    r^2), which is Forbes' 1 / sqrt(1 - c^2 r^2) for a sphere. The conic meets the surface at the vertex and at u = 1.
    """

    kind: ClassVar[str] = "qbfs"

    @property
    def curvature(self) -> float:
        """Vertex curvature [1/mm], that of the conic and that of the departure."""
        total, _ = bfs_sum(bfs_from_q(self.q_mm), 0.0)
        return 1.0 / self.radius_mm + 2.0 * float(total) / self.norm_radius_mm**2

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm] and constant of the conic, reciprocal square of the normalisation radius, coefficients."""
        return (1.0 / self.radius_mm, self.conic, self.norm_radius_mm**-2, *bfs_from_q(self.q_mm))

    @classmethod
    def profile(cls, p: Sequence[Any], r2: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any]:
        base, base_slope, inside = conic_profile(p[0], p[1], r2, xp)
        c2 = p[0] * p[0]
        over, under = xp.maximum(1.0 - p[1] * c2 * r2, 1e-12), xp.maximum(1.0 - (1.0 + p[1]) * c2 * r2, 1e-12)
        stretch = xp.sqrt(over / under)  # sqrt(1 + s^2)
        x = p[2] * r2
        total, slope = bfs_sum(p[3:], x)
        weight = x * (1.0 - x)  # u^2 (1 - u^2)
        stretch_slope = 0.5 * c2 * ((1.0 + p[1]) / under - p[1] / over)  # d ln(stretch) / d(r^2)
        departure_slope = p[2] * ((1.0 - 2.0 * x) * total + weight * slope) + stretch_slope * weight * total
        return base + weight * total * stretch, base_slope + departure_slope * stretch, inside
