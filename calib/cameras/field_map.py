"""Smooth part of measured shifts over the field, and growth along the axes, with their standard deviations."""

from __future__ import annotations

import numpy as np

from optics.arrays import FloatArray
from optics.field_map import polynomial_basis


def smooth_map_rms(position_px: FloatArray, shift_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """RMS (2,) of a smooth map less its mean, and its standard deviation, from measured shifts (n, 2) [px].

    A polynomial is fitted (ACC18 eq. 19: cubic); its scatter, with free parameters counted (noise, S-curve and response
    of the pixels), is subtracted from the mean square.
    """
    smooth, noise, free = _smooth(position_px, shift_px, degree=3)
    count = len(shift_px)
    square = smooth.var(axis=0) - noise**2 * (free - 1) / count
    return np.sqrt(np.maximum(square, 0.0)), noise / np.sqrt(count)


def _smooth(position_px: FloatArray, shift_px: FloatArray, degree: int) -> tuple[FloatArray, FloatArray, int]:
    """Fitted polynomial (n, 2), RMS (2,) of the shifts about it, free parameters counted, and their number."""
    low, high = position_px.min(0), position_px.max(0)
    basis = polynomial_basis((2.0 * position_px - low - high) / (high - low), degree)
    smooth = basis @ np.linalg.lstsq(basis, shift_px, rcond=None)[0]
    free = basis.shape[1]
    return smooth, np.sqrt(((shift_px - smooth) ** 2).sum(0) / (len(basis) - free)), free


def growth_along_axes(position_px: FloatArray, shift_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Growth (2,) of x along x and of y along y by planes through shifts (n, 2), and its standard deviation (2,)."""
    design_matrix = np.column_stack([np.ones(len(position_px)), position_px])
    coefficients = np.linalg.lstsq(design_matrix, shift_px, rcond=None)[0]
    residual = shift_px - design_matrix @ coefficients
    sigma = np.sqrt((residual**2).sum(0) / (len(design_matrix) - design_matrix.shape[1]))
    spread = np.sqrt(np.diag(np.linalg.inv(design_matrix.T @ design_matrix)))
    return np.diag(coefficients[1:]), spread[1:] * sigma
