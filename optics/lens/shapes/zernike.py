"""Conic plus Zernike polynomials, in the order of Noll or of the University of Arizona (fringe)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Literal, Self

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.shapes.freeform import PolynomialFreeform

MOST_TERMS = {"noll": 231, "fringe": 37}
"""Noll up to degree 20, beyond which sums of powers lose digits; fringe as many as there are."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Zernike(PolynomialFreeform):
    """Conic plus ``coefficients_mm[j - 1]`` Z_j(x, y), x and y over ``norm_radius_mm``; azimuths from x towards y.

    ``noll`` polynomials are orthonormal, of unit variance over the disk (Noll 1976, J. Opt. Soc. Am. 66, 207; the
    "standard" ones of design programs), ``fringe`` polynomials are +-1 at most on the rim (Wyant & Creath 1992,
    *Applied Optics and Optical Engineering* XI, ch. 1).
    """

    ordering: Literal["noll", "fringe"]
    kind: ClassVar[str] = "zernike"

    def __post_init__(self) -> None:
        if self.ordering not in MOST_TERMS:
            raise DomainError(f"Zernike.ordering = {self.ordering!r}; 'noll' or 'fringe' is needed")
        if len(self.coefficients_mm) > MOST_TERMS[self.ordering]:
            raise DomainError(
                f"Zernike.coefficients_mm holds {len(self.coefficients_mm)} numbers; at most "
                f"{MOST_TERMS[self.ordering]} are possible in {self.ordering} order"
            )
        PolynomialFreeform.__post_init__(self)

    def _terms(self) -> Iterator[tuple[int, int, float, float]]:
        """Radial degree, azimuthal order (negative: sine), normalisation and coefficient of every term."""
        for j, a in enumerate(self.coefficients_mm, 1):
            n, m = noll_index(j) if self.ordering == "noll" else fringe_index(j)
            norm = math.sqrt((n + 1) * (2 if m else 1)) if self.ordering == "noll" else 1.0
            yield n, m, norm, a

    def monomials_mm(self) -> FloatArray:
        terms = [term for term in self._terms() if term[3]]
        size = max((n for n, *_ in terms), default=0) + 1
        total = np.zeros((size, size))
        for n, m, norm, a in terms:
            total[: n + 1, : n + 1] += norm * a * zernike_monomials(n, m)
        return total

    def flipped(self) -> Self:
        """The surface seen from behind; cosines of odd orders and sines of even ones are odd in x."""
        coefficients = tuple(a if (m % 2 == 1) == (m > 0) and m else -a for _, m, _, a in self._terms())
        return replace(self, radius_mm=-self.radius_mm, coefficients_mm=coefficients)


@lru_cache
def noll_index(j: int) -> tuple[int, int]:
    """Radial degree n and azimuthal order m (negative: sine) of Noll's polynomial j = 1, 2, ..."""
    n = (math.isqrt(8 * j - 7) - 1) // 2
    within = j - n * (n + 1) // 2 - 1  # position within the degree
    m = 2 * ((within + 1) // 2) if n % 2 == 0 else 2 * (within // 2) + 1
    return n, m if j % 2 == 0 else -m


@lru_cache
def fringe_index(j: int) -> tuple[int, int]:
    """Radial degree n and azimuthal order m (negative: sine) of fringe polynomial j = 1, 2, ..."""
    if j == MOST_TERMS["fringe"]:
        return 12, 0
    group = math.isqrt(j - 1)  # (n + m) / 2
    within = j - group**2 - 1  # orders fall from group to 0, cosine before sine
    m = group - within // 2
    return 2 * group - m, -m if within % 2 else m


@lru_cache
def zernike_monomials(n: int, m: int) -> FloatArray:
    """Coefficients (n + 1, n + 1) of x^i y^j of R_n^|m|(r) cos(m phi), or sin(|m| phi) for m < 0; |R| = 1 at r = 1."""
    order, total = abs(m), np.zeros((n + 1, n + 1))
    half = (n - order) // 2
    for k in range(half + 1):
        radial = (-1) ** k * math.comb(n - k, k) * math.comb(n - 2 * k, half - k)
        power = half - k  # r^(n - 2 k) = (x^2 + y^2)^power r^order
        for a in range(power + 1):
            for q in range(int(m < 0), order + 1, 2):  # (x + i y)^order: even powers of y make the cosine
                sign = (-1) ** (q // 2)
                total[2 * (power - a) + order - q, 2 * a + q] += (
                    radial * math.comb(power, a) * math.comb(order, q) * sign
                )
    total.setflags(write=False)
    return total
