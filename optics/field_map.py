"""Shifts of images over the field: as polynomials, and as shift, roll and scale of the entire image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander2d

from optics.arrays import FloatArray


def polynomial_basis(point: FloatArray, degree: int) -> FloatArray:
    """Products of Legendre polynomials at points (..., 2), total degree at most ``degree``: (..., k)."""
    terms = legvander2d(point[..., 0], point[..., 1], [degree, degree])
    total = np.add.outer(np.arange(degree + 1), np.arange(degree + 1)).ravel()
    return np.asarray(terms[..., total <= degree])


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldMap:
    """A shift over the field, as polynomials in the tangents of the direction; made by `fit_field_map`."""

    reach: float  # Largest tangent of the fit
    degree: int
    coefficients: FloatArray  # (k, 2)

    def at(self, direction: FloatArray) -> FloatArray:
        """Shifts (..., 2) at directions (..., 3)."""
        return np.asarray(_field_basis(direction, self.reach, self.degree) @ self.coefficients)


def fit_field_map(direction: FloatArray, shift: FloatArray, degree: int = 5) -> FieldMap:
    """Least squares to shifts (n, 2) at directions (n, 3) in cam."""
    reach = float(np.abs(direction[:, :2] / direction[:, 2:]).max())
    coefficients = np.linalg.lstsq(_field_basis(direction, reach, degree), shift, rcond=None)[0]
    return FieldMap(reach=reach, degree=degree, coefficients=np.asarray(coefficients, np.float64))


def _field_basis(direction: FloatArray, reach: float, degree: int) -> FloatArray:
    return polynomial_basis(direction[..., :2] / direction[..., 2:] / reach, degree)


def fit_similarity(position: FloatArray, shift: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shift of the image in x and y, roll [rad] and growth (4,), by least squares, and the residuals (n, 2)."""
    x, y = position.T
    ones, zeros = np.ones_like(x), np.zeros_like(x)
    design_matrix = np.concatenate([np.stack([ones, zeros, -y, x], 1), np.stack([zeros, ones, x, y], 1)])
    motion = np.linalg.lstsq(design_matrix, shift.T.ravel(), rcond=None)[0]
    return motion, shift - (design_matrix @ motion).reshape(2, -1).T
