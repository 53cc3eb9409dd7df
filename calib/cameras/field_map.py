"""Shifts of images over the field as polynomials, and as shift, roll and scale of the whole image."""

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
        """Shifts (n, 2) at directions (n, 3)."""
        return np.asarray(_field_basis(direction, self.reach, self.degree) @ self.coefficients)


def fit_field_map(direction: FloatArray, shift_px: FloatArray, degree: int = 5) -> FieldMap:
    """Least squares to shifts (n, 2) [px] at directions (n, 3) in cam."""
    reach = float(np.abs(direction[:, :2] / direction[:, 2:]).max())
    coefficients = np.linalg.lstsq(_field_basis(direction, reach, degree), shift_px, rcond=None)[0]
    return FieldMap(reach=reach, degree=degree, coefficients=np.asarray(coefficients, np.float64))


def _field_basis(direction: FloatArray, reach: float, degree: int) -> FloatArray:
    return polynomial_basis(direction[:, :2] / direction[:, 2:] / reach, degree)


def fit_similarity(position_px: FloatArray, shift_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shift of the image in x and y [px], roll [rad] and growth (4,), by least squares, and the residuals (n, 2)."""
    x, y = position_px.T
    ones, zeros = np.ones_like(x), np.zeros_like(x)
    basis = np.concatenate([np.stack([ones, zeros, -y, x], 1), np.stack([zeros, ones, x, y], 1)])
    motion = np.linalg.lstsq(basis, shift_px.T.ravel(), rcond=None)[0]
    return motion, shift_px - (basis @ motion).reshape(2, -1).T


def smooth_map_rms(position_px: FloatArray, shift_px: FloatArray, degree: int = 3) -> tuple[FloatArray, FloatArray]:
    """RMS (2,) of a smooth map less its mean, and its standard deviation, from measured shifts.

    A polynomial is fitted; its scatter, with free parameters counted (noise, S-curve and response of the pixels), is
    subtracted from the mean square.

    Parameters
    ----------
    position_px, shift_px : (n, 2)
        Positions, and shifts along x and y [px].
    degree : int
        Total degree of the polynomial (ACC18 eq. 19: 3).
    """
    smooth, noise = _smooth(position_px, shift_px, degree)
    count, free = len(shift_px), (degree + 1) * (degree + 2) // 2
    square = smooth.var(axis=0) - noise**2 * (free - 1) / count
    return np.sqrt(np.maximum(square, 0.0)), noise / np.sqrt(count)


def _smooth(position_px: FloatArray, shift_px: FloatArray, degree: int) -> tuple[FloatArray, FloatArray]:
    """Fitted polynomial (n, 2), and RMS (2,) of the shifts about it, free parameters counted."""
    low, high = position_px.min(0), position_px.max(0)
    basis = polynomial_basis((2.0 * position_px - low - high) / (high - low), degree)
    smooth = basis @ np.linalg.lstsq(basis, shift_px, rcond=None)[0]
    return smooth, np.sqrt(((shift_px - smooth) ** 2).sum(0) / (len(basis) - basis.shape[1]))


def growth_along_axes(position_px: FloatArray, shift_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Growth (2,) of x along x and of y along y by planes through shifts (n, 2), and its standard deviation (2,)."""
    design_matrix = np.column_stack([np.ones(len(position_px)), position_px])
    coefficients = np.linalg.lstsq(design_matrix, shift_px, rcond=None)[0]
    residual = shift_px - design_matrix @ coefficients
    sigma = np.sqrt((residual**2).sum(0) / (len(design_matrix) - design_matrix.shape[1]))
    spread = np.sqrt(np.diag(np.linalg.inv(design_matrix.T @ design_matrix)))
    return np.diag(coefficients[1:]), spread[1:] * sigma
