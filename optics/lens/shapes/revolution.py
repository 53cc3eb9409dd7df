r"""Surfaces of revolution on a conic.

Sag, with curvature :math:`c = 1/R`, conic constant :math:`k` and :math:`r^2 = x^2 + y^2`:

.. math:: z(r) = \frac{c r^2}{1 + \sqrt{1 - (1 + k) c^2 r^2}} + p(r^2)

A ray is brought to the plane z = 0 of the vertex first; from there the path to the conic is the small root
:math:`s = F / (G + \sqrt{G^2 - A F})` with :math:`A = c (1 + k N^2)`, :math:`G = N - c (x L + y M)`, :math:`F = c r^2`
(Spencer & Murty 1962, J. Opt. Soc. Am. 52, 672; Welford 1986, ch. 4), a form free of cancellation that is continuous
through the plane. Newton steps add what p brings.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from pydantic import FiniteFloat

from optics.arrays import NUMPY, ArrayNamespace, FloatArray
from optics.errors import DomainError
from optics.lens.shapes.base import Hit, Shape, require_finite

NEWTON_STEPS = 6
NEWTON_RESIDUAL_MM = 1e-10

Profile = Callable[[Any], tuple[Any, Any, Any]]
"""r^2 -> sag, its derivative with respect to r^2, whether the surface reaches so far."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Curved(Shape):
    """A shape with a vertex radius; positive when the centre of curvature lies on the +z side."""

    radius_mm: float

    def __post_init__(self) -> None:
        if self.radius_mm == 0.0 or math.isnan(self.radius_mm):
            raise DomainError(f"radius_mm = {self.radius_mm}: a number other than zero is needed (inf for a plane)")

    @property
    def curvature(self) -> float:
        return 1.0 / self.radius_mm

    def flipped(self) -> Self:
        return replace(self, radius_mm=-self.radius_mm)

    def scaled(self, factor: float) -> Self:
        """The surface expanded uniformly; a kind with numbers that are no lengths (fields ``..._mm``) has its own."""
        grown: dict[str, Any] = {}
        for name in (field.name for field in fields(self) if field.name.endswith("_mm")):
            length = getattr(self, name)
            grown[name] = tuple(a * factor for a in length) if isinstance(length, tuple) else length * factor
        return replace(self, **grown)

    def changed(self, name: str, by: float) -> Shape:
        """The surface with ``by`` added to one number; a radius must stay finite and on its side."""
        if name == "radius_mm":
            if math.isinf(self.radius_mm):
                raise DomainError("it is a plane, whose radius cannot be changed")
            if not self.radius_mm * (self.radius_mm + by) > 0:
                raise DomainError(f"radius {self.radius_mm} mm changed by {by} mm changes sign; use a smaller change")
        return Shape.changed(self, name, by)


def conic_rim_mm(radius_mm: float, conic: float) -> float:
    """Distance from the axis at which a conicoid ends [mm]."""
    return abs(radius_mm) / math.sqrt(1.0 + conic) if conic > -1.0 else math.inf


def conic_path(c: Any, k: Any, x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Any:
    """Path from the vertex plane to a conic [mm], a start for what lies near it; any number where it is missed."""
    f = c * (x * x + y * y)
    g = d[2] - c * (x * d[0] + y * d[1])
    disc = g * g - c * (1.0 + k * d[2] * d[2]) * f
    return f / (g + xp.sqrt(xp.maximum(disc, 0.0)))


def conic_profile(c: Any, k: Any, r2: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any]:
    """Conic of curvature c and conic constant k: sag, its derivative with respect to r^2, whether it reaches so far."""
    w2 = 1.0 - (1.0 + k) * c * c * r2
    w = xp.sqrt(xp.maximum(w2, 1e-12))
    return c * r2 / (1.0 + w), 0.5 * c / w, w2 > 0.0


def profile_sag(profile: Profile, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Sag [mm] of a profile on NumPy arrays; NaN where it does not reach."""
    r2 = np.asarray(x_mm, float) ** 2 + np.asarray(y_mm, float) ** 2
    sag, _, inside = profile(r2)
    return np.where(inside, sag, np.nan)


def newton_hit(profile: Profile, start: Any, x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
    """Intersect rays on the vertex plane with a profile; ``start`` is the path [mm] to begin with, as to the conic."""
    dx, dy, dz = d
    s = start
    for _ in range(NEWTON_STEPS):
        px, py = x + s * dx, y + s * dy
        sag, slope, _ = profile(px * px + py * py)
        s = s + (sag - s * dz) / (dz - 2.0 * slope * (px * dx + py * dy))
    px, py, pz = x + s * dx, y + s * dy, s * dz
    sag, slope, inside = profile(px * px + py * py)
    nx, ny = -2.0 * slope * px, -2.0 * slope * py
    scale = 1.0 / xp.sqrt(nx * nx + ny * ny + 1.0)
    cos_i = (nx * dx + ny * dy + dz) * scale
    error = sag - pz
    valid = inside & (error * error < NEWTON_RESIDUAL_MM**2) & (cos_i > 0.0)
    return Hit(s, px, py, pz, nx * scale, ny * scale, scale, cos_i, valid)


@dataclass(frozen=True, slots=True, kw_only=True)
class Asphere(Curved):
    """A conic and a departure from it, both of revolution; ``radius_mm`` may be infinite.

    A kind defines its `profile`; its `parameters` begin with curvature and conic constant.
    """

    radius_mm: float = math.inf
    conic: FiniteFloat = 0.0

    def __post_init__(self) -> None:
        require_finite(self, "conic")
        Curved.__post_init__(self)

    @property
    def rim_mm(self) -> float:
        return conic_rim_mm(self.radius_mm, self.conic)

    @classmethod
    @abstractmethod
    def profile(cls, p: Sequence[Any], r2: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any]:
        """Sag, its derivative with respect to r^2, whether the conic reaches so far; p are the `parameters`."""

    @classmethod
    def intersect(cls, p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        start = conic_path(p[0], p[1], x, y, d, xp)
        return newton_hit(lambda r2: cls.profile(p, r2, xp), start, x, y, d, xp)

    def sag(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        return profile_sag(lambda r2: self.profile(self.parameters(), r2, NUMPY), x_mm, y_mm)
