"""Surfaces without symmetry of revolution: Newton's method on z = sag(x, y); conics with a polynomial in x and y."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from pydantic import FiniteFloat

from optics.arrays import NUMPY, ArrayNamespace, FloatArray
from optics.lens.shapes.base import Hit, Shape, require_finite, require_positive
from optics.lens.shapes.revolution import Curved, conic_path, conic_profile, conic_rim_mm
from optics.validate import Positive

NEWTON_STEPS, NEWTON_RESIDUAL_MM = 8, 1e-10

Sag = Callable[[Any, Any], tuple[Any, Any, Any, Any]]
"""(x, y) -> sag, its slopes along x and y, whether the surface reaches so far."""


def surface_hit(surface: Sag, start: Any, x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
    """Intersect rays that stand on the vertex plane; parameters as `optics.lens.shapes.revolution.newton_hit`."""
    dx, dy, dz = d
    s = start
    for _ in range(NEWTON_STEPS):
        sag, along_x, along_y, _ = surface(x + s * dx, y + s * dy)
        s = s + (sag - s * dz) / (dz - along_x * dx - along_y * dy)
    px, py, pz = x + s * dx, y + s * dy, s * dz
    sag, along_x, along_y, inside = surface(px, py)
    scale = 1.0 / xp.sqrt(along_x * along_x + along_y * along_y + 1.0)
    cos_i = (dz - along_x * dx - along_y * dy) * scale
    error = sag - pz
    valid = inside & (error * error < NEWTON_RESIDUAL_MM**2) & (cos_i > 0.0)
    return Hit(s, px, py, pz, -(along_x * scale), -(along_y * scale), scale, cos_i, valid)


@dataclass(frozen=True, slots=True, kw_only=True)
class Freeform(Shape):
    """A shape given by its sag and slopes; rays intersect it by Newton's method from its vertex plane."""

    rotational: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def surface(cls, p: Sequence[Any], x: Any, y: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any, Any]:
        """Sag, its slopes along x and y, whether the surface reaches so far; p are the `parameters`."""

    @classmethod
    def start(cls, p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Any:
        """Path from the vertex plane with which Newton's method begins [mm]."""
        return 0.0 * x

    @classmethod
    def intersect(cls, p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        return surface_hit(lambda u, v: cls.surface(p, u, v, xp), cls.start(p, x, y, d, xp), x, y, d, xp)

    def sag(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        x, y = np.broadcast_arrays(np.asarray(x_mm, float), np.asarray(y_mm, float))
        sag, _, _, inside = self.surface(self.parameters(), x, y, NUMPY)
        return np.where(inside, sag, np.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class PolynomialFreeform(Freeform, Curved):
    """A conic plus functions of x and y over ``norm_radius_mm`` with coefficients; ``radius_mm`` may be infinite.

    A kind states the coefficients of x^i y^j [mm] (`monomials_mm`).
    """

    radius_mm: float = math.inf
    conic: FiniteFloat = 0.0
    norm_radius_mm: Positive
    coefficients_mm: tuple[FiniteFloat, ...] = ()

    def __post_init__(self) -> None:
        require_finite(self, "conic", "coefficients_mm")
        require_positive(self, "norm_radius_mm")
        Curved.__post_init__(self)

    @abstractmethod
    def monomials_mm(self) -> FloatArray:
        """Coefficients (n + 1, n + 1) of x^i y^j [mm], x and y over the normalisation radius; 0 for i + j > n."""

    @property
    def rim_mm(self) -> float:
        return conic_rim_mm(self.radius_mm, self.conic)

    @property
    def curvature(self) -> float:
        c = self.monomials_mm()
        second = float(c[2, 0] + c[0, 2]) if len(c) > 2 else 0.0
        return 1.0 / self.radius_mm + second / self.norm_radius_mm**2

    def parameters(self) -> tuple[float, ...]:
        """Curvature [1/mm], conic constant, reciprocal normalisation radius, coefficients by powers of y, then x."""
        c = self.monomials_mm()
        flat = (float(c[i, j]) for j in range(len(c)) for i in range(len(c) - j))
        return (1.0 / self.radius_mm, self.conic, 1.0 / self.norm_radius_mm, *flat)

    @classmethod
    def surface(cls, p: Sequence[Any], x: Any, y: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any, Any]:
        base, slope, inside = conic_profile(p[0], p[1], x * x + y * y, xp)
        sag, along_x, along_y = polynomial(p[3:], x * p[2], y * p[2])
        return base + sag, 2.0 * slope * x + p[2] * along_x, 2.0 * slope * y + p[2] * along_y, inside

    @classmethod
    def start(cls, p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Any:
        """Path to the conic [mm]."""
        return conic_path(p[0], p[1], x, y, d, xp)


def polynomial(c: Sequence[Any], x: Any, y: Any) -> tuple[Any, Any, Any]:
    """Polynomial in x and y and its two derivatives, by Horner's rule."""
    degree = (math.isqrt(8 * len(c) + 1) - 3) // 2
    zero = 0.0 * x
    value, along_x, along_y, end = zero, zero, zero, len(c)
    for j in reversed(range(degree + 1)):
        row, row_slope = zero, zero
        for a in reversed(c[end - (degree + 1 - j) : end]):
            row_slope = row_slope * x + row
            row = row * x + a
        end -= degree + 1 - j
        along_y = along_y * y + value
        value, along_x = value * y + row, along_x * y + row_slope
    return value, along_x, along_y
