r"""Surfaces of revolution: plane, sphere, conic, even asphere.

Sag, with curvature :math:`c = 1/R`, conic constant :math:`k` and :math:`r^2 = x^2 + y^2`:

.. math:: z(r) = \frac{c r^2}{1 + \sqrt{1 - (1 + k) c^2 r^2}} + \sum_j a_j r^{4 + 2j}

A ray is brought to the plane z = 0 of the vertex first; from there the path to the conic is the small root
:math:`s = F / (G + \sqrt{G^2 - A F})` with :math:`A = c (1 + k N^2)`, :math:`G = N - c (x L + y M)`, :math:`F = c r^2`
(Spencer & Murty 1962, J. Opt. Soc. Am. 52, 672; Welford 1986, ch. 4), a form free of cancellation that is continuous
through the plane. The even asphere adds Newton steps.

Each class names its parameters, which the trace receives as numbers or as arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from optics.arrays import NUMPY, ArrayNamespace
from optics.errors import DomainError

__all__ = ["Conic", "EvenAsphere", "Hit", "Plane", "Shape", "Sphere", "sag"]

NEWTON_STEPS = 6
NEWTON_RESIDUAL_MM = 1e-10


@dataclass(frozen=True, slots=True)
class Hit:
    """Intersection in the vertex frame: path from the vertex plane, point, unit normal towards +z, cosine, validity.

    ``valid`` is None where every ray is valid; what is zero for all rays may be a plain 0.0.
    """

    path: Any
    x: Any
    y: Any
    z: Any
    nx: Any
    ny: Any
    nz: Any
    cos_i: Any
    valid: Any


def _check_finite(owner: str, **values: float) -> None:
    for name, value in values.items():
        if not math.isfinite(value):
            raise DomainError(f"{owner}.{name} = {value}; a finite number is needed")


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """Plane z = 0."""

    kind: ClassVar[str] = "plane"

    @property
    def curvature(self) -> float:
        """Vertex curvature [1/mm]."""
        return 0.0

    def parameters(self) -> tuple[float, ...]:
        """Numbers the trace needs: none."""
        return ()

    @staticmethod
    def intersect(p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        """Intersect rays that stand on the vertex plane."""
        return Hit(0.0, x, y, 0.0, 0.0, 0.0, 1.0, d[2], None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere:
    """Sphere of ``radius_mm``; positive when the centre of curvature lies on the +z side."""

    radius_mm: float
    kind: ClassVar[str] = "sphere"

    def __post_init__(self) -> None:
        _check_finite("Sphere", radius_mm=self.radius_mm)
        if self.radius_mm == 0.0:
            raise DomainError("Sphere.radius_mm = 0 mm; it must not be zero (leave it out for a plane)")

    @property
    def curvature(self) -> float:
        """Vertex curvature [1/mm]."""
        return 1.0 / self.radius_mm

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm]."""
        return (self.curvature,)

    @staticmethod
    def intersect(p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        """Intersect rays that stand on the vertex plane; parameter: c."""
        c = p[0]
        dx, dy, dz = d
        f = c * (x * x + y * y)
        g = dz - c * (x * dx + y * dy)
        disc = g * g - c * f
        cos_i = xp.sqrt(xp.maximum(disc, 0.0))
        s = f / (g + cos_i)
        x, y, z = x + s * dx, y + s * dy, s * dz
        nz = 1.0 - c * z
        return Hit(s, x, y, z, -(c * x), -(c * y), nz, cos_i, (disc > 0.0) & (g > 0.0) & (nz > 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Conic:
    """Conicoid: k < -1 hyperboloid, -1 paraboloid, -1 < k < 0 prolate, 0 sphere, > 0 oblate ellipsoid."""

    radius_mm: float
    conic: float
    kind: ClassVar[str] = "conic"

    def __post_init__(self) -> None:
        _check_finite("Conic", radius_mm=self.radius_mm, conic=self.conic)
        if self.radius_mm == 0.0:
            raise DomainError("Conic.radius_mm = 0 mm; it must not be zero")

    @property
    def curvature(self) -> float:
        """Vertex curvature [1/mm]."""
        return 1.0 / self.radius_mm

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm], conic constant."""
        return (self.curvature, self.conic)

    @staticmethod
    def intersect(p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        """Intersect rays that stand on the vertex plane; parameters: c, k."""
        c, k = p[0], p[1]
        dx, dy, dz = d
        f = c * (x * x + y * y)
        g = dz - c * (x * dx + y * dy)
        disc = g * g - c * (1.0 + k * dz * dz) * f
        root = xp.sqrt(xp.maximum(disc, 0.0))
        s = f / (g + root)
        x, y, z = x + s * dx, y + s * dy, s * dz
        nx, ny, nz = -(c * x), -(c * y), 1.0 - (1.0 + k) * c * z
        scale = 1.0 / xp.sqrt(nx * nx + ny * ny + nz * nz)
        valid = (disc > 0.0) & (g > 0.0) & (nz > 0.0)
        return Hit(s, x, y, z, nx * scale, ny * scale, nz * scale, root * scale, valid)


@dataclass(frozen=True, slots=True, kw_only=True)
class EvenAsphere:
    """Conic plus even polynomial: ``coefficients[j]`` [mm^-(3+2j)] times r^(4+2j); ``radius_mm`` may be infinite."""

    radius_mm: float
    conic: float = 0.0
    coefficients: tuple[float, ...] = ()
    kind: ClassVar[str] = "asphere"

    def __post_init__(self) -> None:
        _check_finite(
            "EvenAsphere", conic=self.conic, **{f"coefficients[{i}]": a for i, a in enumerate(self.coefficients)}
        )
        if self.radius_mm == 0.0 or math.isnan(self.radius_mm):
            raise DomainError(f"EvenAsphere.radius_mm = {self.radius_mm} mm; a number other than zero is needed")

    @property
    def curvature(self) -> float:
        """Vertex curvature [1/mm]."""
        return 1.0 / self.radius_mm

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm], conic constant, polynomial coefficients."""
        return (self.curvature, self.conic, *self.coefficients)

    @staticmethod
    def _sag_and_slope(p: Sequence[Any], r2: Any, xp: ArrayNamespace) -> tuple[Any, Any]:
        """Sag and its derivative with respect to r^2."""
        c, k, coefficients = p[0], p[1], p[2:]
        w = xp.sqrt(xp.maximum(1.0 - (1.0 + k) * c * c * r2, 1e-12))
        poly, slope = r2 * 0.0, r2 * 0.0
        for a in reversed(coefficients):
            slope = slope * r2 + poly
            poly = poly * r2 + a
        # poly(r2) = sum a_j r2^j; the sag term is r2^2 poly
        return c * r2 / (1.0 + w) + r2 * r2 * poly, 0.5 * c / w + 2.0 * r2 * poly + r2 * r2 * slope

    @staticmethod
    def intersect(p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        """Intersect rays that stand on the vertex plane; parameters: c, k, a4, a6, ..."""
        dx, dy, dz = d
        s = Conic.intersect(p, x, y, d, xp).path
        for _ in range(NEWTON_STEPS):
            px, py = x + s * dx, y + s * dy
            sag, slope = EvenAsphere._sag_and_slope(p, px * px + py * py, xp)
            s = s + (sag - s * dz) / (dz - 2.0 * slope * (px * dx + py * dy))
        px, py, pz = x + s * dx, y + s * dy, s * dz
        r2 = px * px + py * py
        sag, slope = EvenAsphere._sag_and_slope(p, r2, xp)
        nx, ny = -2.0 * slope * px, -2.0 * slope * py
        scale = 1.0 / xp.sqrt(nx * nx + ny * ny + 1.0)
        cos_i = (nx * dx + ny * dy + dz) * scale
        error = sag - pz
        inside = 1.0 - (1.0 + p[1]) * p[0] * p[0] * r2 > 0.0
        valid = inside & (error * error < NEWTON_RESIDUAL_MM**2) & (cos_i > 0.0)
        return Hit(s, px, py, pz, nx * scale, ny * scale, scale, cos_i, valid)


Shape = Plane | Sphere | Conic | EvenAsphere


def sag(shape: Shape, radius_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sag z(r) [mm] of a surface; NaN beyond the edge of a conic.

    Parameters
    ----------
    shape : Shape
        The surface.
    radius_mm : array
        Distance from the axis [mm].
    """
    r2 = np.asarray(radius_mm, float) ** 2
    if isinstance(shape, Plane):
        return np.zeros_like(r2)
    p = shape.parameters() if not isinstance(shape, Sphere) else (shape.curvature, 0.0)
    inside = 1.0 - (1.0 + p[1]) * p[0] ** 2 * r2
    return np.where(inside >= 0.0, EvenAsphere._sag_and_slope(p, r2, NUMPY)[0], np.nan)
