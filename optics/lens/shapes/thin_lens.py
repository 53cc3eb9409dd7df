r"""Ideal thin lens.

A plane that refracts light by paraxial optics at any height and angle: with slopes t = (dx/dz, dy/dz), heights h,
indices n and n' in front and behind, and :math:`n_0` of the air or vacuum around the whole lens,

.. math:: n' t' = n t - n_0 h / f .

f is thus the focal length in these surroundings, as in design programs, whose indices are relative to them. Parallel
light of any direction meets in one point of the plane n' f / n0 behind it; no real lens does that. The optical path is
such that all rays of a parallel bundle are equally long to that point (``collimated = "before"``), or, for a lens met
from its focus, all rays of a point of the plane n f / n0 in front to a plane wave (``"after"``). For objects between,
optical paths are not physical.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from optics.arrays import ArrayNamespace, FloatArray
from optics.errors import DomainError
from optics.lens.shapes.base import Hit, Shape


@dataclass(frozen=True, slots=True, kw_only=True)
class ThinLens(Shape):
    """Ideal thin lens of ``focal_length_mm``; see the module for its optical path."""

    focal_length_mm: float
    collimated: Literal["before", "after"] = "before"
    kind: ClassVar[str] = "paraxial"
    redirects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.focal_length_mm == 0.0 or math.isnan(self.focal_length_mm) or math.isinf(self.focal_length_mm):
            raise DomainError(f"ThinLens.focal_length_mm = {self.focal_length_mm}; a number other than 0 is needed")
        if self.collimated not in ("before", "after"):
            raise DomainError(f"ThinLens.collimated = {self.collimated!r}; 'before' or 'after' is needed")

    @property
    def curvature(self) -> float:
        return 0.0

    def power(self, before: float, after: float, ambient: float) -> float:
        return ambient / self.focal_length_mm

    def parameters(self) -> tuple[float, ...]:
        """Focal length [mm], and 1 for parallel light before the lens or 0 for after it."""
        return (self.focal_length_mm, float(self.collimated == "before"))

    @staticmethod
    def intersect(p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        return Hit(0.0, x, y, 0.0, 0.0, 0.0, 1.0, d[2], None)

    @staticmethod
    def redirect(
        p: Sequence[Any], hit: Hit, d: Sequence[Any], index: tuple[Any, Any, Any], xp: ArrayNamespace
    ) -> tuple[tuple[Any, Any, Any], Any]:
        n, m, ambient = index
        focal, before = p[0] / ambient, p[1]
        tx, ty = d[0] / d[2], d[1] / d[2]
        ux, uy = (n * tx - hit.x / focal) / m, (n * ty - hit.y / focal) / m
        long_in, long_out = xp.sqrt(1.0 + tx * tx + ty * ty), xp.sqrt(1.0 + ux * ux + uy * uy)
        a, b = n / m, m / n
        # path of the ray through the middle of the lens, less that of this one outside the lens
        focus = m * m * focal * (xp.sqrt(1.0 + a * a * (tx * tx + ty * ty)) - long_out)
        source = n * n * focal * (xp.sqrt(1.0 + b * b * (ux * ux + uy * uy)) - long_in)
        from_wave = focus - n * (hit.x * tx + hit.y * ty) / long_in
        to_wave = source + m * (hit.x * ux + hit.y * uy) / long_out
        return (ux / long_out, uy / long_out, 1.0 / long_out), before * from_wave + (1.0 - before) * to_wave

    def sag(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        return np.zeros(np.broadcast_shapes(np.shape(x_mm), np.shape(y_mm)))

    def flipped(self) -> Self:
        return replace(self, collimated="after" if self.collimated == "before" else "before")

    def scaled(self, factor: float) -> Self:
        return replace(self, focal_length_mm=self.focal_length_mm * factor)
