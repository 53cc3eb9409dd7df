"""Conic plus a polynomial in x and y."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from optics.arrays import FloatArray
from optics.lens.shapes.freeform import PolynomialFreeform
from optics.validate import Positive


@dataclass(frozen=True, slots=True, kw_only=True)
class XYPolynomial(PolynomialFreeform):
    """Conic plus ``coefficients_mm`` of x, y, x^2, x y, y^2, x^3, x^2 y, ..., x and y over ``norm_radius_mm``."""

    norm_radius_mm: Positive = 1.0
    kind: ClassVar[str] = "polynomial"

    def _powers(self) -> list[tuple[int, int]]:
        """Powers of x and y of every coefficient."""
        powers: list[tuple[int, int]] = []
        degree = 0
        while len(powers) < len(self.coefficients_mm):
            degree += 1
            powers += [(degree - j, j) for j in range(degree + 1)]
        return powers[: len(self.coefficients_mm)]

    def monomials_mm(self) -> FloatArray:
        """Coefficients of x^i y^j [mm]."""
        powers = self._powers()
        size = max((i + j for i, j in powers), default=0) + 1
        monomials = np.zeros((size, size))
        for (i, j), a in zip(powers, self.coefficients_mm, strict=True):
            monomials[i, j] = a
        return monomials

    def flipped(self) -> Self:
        coefficients = tuple(a if i % 2 else -a for (i, _), a in zip(self._powers(), self.coefficients_mm, strict=True))
        return replace(self, radius_mm=-self.radius_mm, coefficients_mm=coefficients)
