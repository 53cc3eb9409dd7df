"""Zernike polynomials in three orders, and their fit to a wavefront.

``noll``: "standard" (Noll 1976, J. Opt. Soc. Am. 66, 207), index from 1, each of RMS 1 over the unit disk; the Zernike
Standard Coefficients of ray-tracing programs. ``ansi``: ISO 24157 / OSA, index from 0, RMS 1. ``fringe``: University of
Arizona, index from 1, 37 terms, amplitude 1 at the rim (ISO 14999-2 lists them). The azimuth of sine terms is measured
from +x towards +y.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy.special import eval_jacobi

from optics.arrays import FloatArray
from optics.errors import DomainError, unknown_name
from optics.lens.shapes.zernike import MOST_TERMS, fringe_index, noll_index

ZernikeOrder = Literal["noll", "ansi", "fringe"]


def _ansi(j: int) -> tuple[int, int]:
    n = int((np.sqrt(8 * j + 1) - 1) // 2)
    return n, 2 * j - n * (n + 2)


_ORDERS: dict[str, tuple[int, Callable[[int], tuple[int, int]]]] = {
    "noll": (1, noll_index),
    "ansi": (0, _ansi),
    "fringe": (1, fringe_index),
}


def zernike_numbers(count: int, order: ZernikeOrder = "noll") -> tuple[tuple[int, int], ...]:
    """Radial degree n and azimuthal frequency m of the first terms; m < 0 marks sines."""
    if order not in _ORDERS:
        raise unknown_name("order of Zernike polynomials", order, _ORDERS)
    if count < 1 or (order == "fringe" and count > MOST_TERMS["fringe"]):
        raise DomainError(
            f"{count} Zernike terms ({order}); at least 1, and of the fringe set at most {MOST_TERMS['fringe']}"
        )
    first, numbers = _ORDERS[order]
    return tuple(numbers(j) for j in range(first, first + count))


def zernikes(x: FloatArray, y: FloatArray, count: int, order: ZernikeOrder = "noll") -> FloatArray:
    """The first terms of an order at points of the unit disk; errors as `zernike_numbers`.

    Parameters
    ----------
    x, y : array
        Points of the unit disk.
    count : int
        Number of terms.
    order : {"noll", "ansi", "fringe"}
        Numbering and norm.

    Returns
    -------
    (count, ...) array
        Values of the terms.
    """
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    terms = []
    for n, m in zernike_numbers(count, order):
        k = abs(m)
        radial = r**k * eval_jacobi((n - k) // 2, 0, k, 2.0 * r * r - 1.0)
        norm = 1.0 if order == "fringe" else np.sqrt((n + 1) * (1.0 if m == 0 else 2.0))
        terms.append(norm * radial * (np.sin(k * angle) if m < 0 else np.cos(k * angle)))
    return np.stack(terms)


def fit_zernikes(
    x: FloatArray, y: FloatArray, value: FloatArray, weight: FloatArray, count: int, order: ZernikeOrder = "noll"
) -> FloatArray:
    """Coefficients (count,) of the weighted least-squares fit to values at points of the unit disk.

    Over a full disk they are the projections; over an annulus or a vignetted pupil they depend on ``count``.
    """
    root = np.sqrt(weight)
    terms = zernikes(x, y, count, order)
    return np.asarray(np.linalg.lstsq((terms * root).T, value * root, rcond=None)[0])
