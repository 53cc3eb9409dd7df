"""Plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from optics.arrays import ArrayNamespace, FloatArray
from optics.lens.shapes.base import Hit, Shape


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane(Shape):
    """Plane z = 0."""

    kind: ClassVar[str] = "plane"

    @property
    def curvature(self) -> float:
        return 0.0

    def parameters(self) -> tuple[float, ...]:
        return ()

    @staticmethod
    def intersect(p: Sequence[Any], x: Any, y: Any, d: Sequence[Any], xp: ArrayNamespace) -> Hit:
        return Hit(0.0, x, y, 0.0, 0.0, 0.0, 1.0, d[2], None)

    def sag(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        return np.zeros(np.broadcast_shapes(np.shape(x_mm), np.shape(y_mm)))

    def flipped(self) -> Self:
        return self

    def scaled(self, factor: float) -> Self:
        return self
