"""Smooth sky of a frame: a Legendre polynomial through the levels of its blocks."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import leggrid2d, legvander2d

from calib.measure.statistics.robust import robust_rms
from optics.arrays import FloatArray

DEGREE, BLOCKS_PER_TERM = 10, 6
"""Largest total degree, and blocks for each term: finer structure would be noise of the frame."""
CLIP_SIGMA, ROUNDS = 4.0, 3


def sky_surface(level: FloatArray, sigma: FloatArray, shape: tuple[int, int], block_px: int) -> FloatArray:
    """Level (h, w) of a frame by least squares of the levels of its blocks (r, c) without outliers.

    ``sigma`` (r, c): standard deviations of the levels, NaN in blocks without one.
    """
    rows, columns = level.shape
    terms = [(d + 1) * (d + 2) // 2 for d in range(DEGREE + 1)]
    degree = max([0, *(d for d, count in enumerate(terms) if count * BLOCKS_PER_TERM <= level.size)])
    y, x = ((2.0 * np.arange(n) + 1.0) / n - 1.0 for n in (rows, columns))
    order = np.add.outer(np.arange(degree + 1), np.arange(degree + 1))
    used = (order <= degree).ravel()
    row, column = np.meshgrid(y, x, indexing="ij")
    design = legvander2d(row, column, (degree, degree)).reshape(level.size, -1)[:, used]
    weight = np.nan_to_num(1.0 / sigma.ravel())
    coefficients = np.zeros(order.size)
    for _ in range(ROUNDS):
        coefficients[used] = np.linalg.lstsq(design * weight[:, None], level.ravel() * weight, rcond=None)[0]
        residual = (level.ravel() - design @ coefficients[used]) * weight
        weight = np.where(np.abs(residual) < CLIP_SIGMA * robust_rms(residual[weight > 0]), weight, 0.0)
    row, column = (
        np.clip((2.0 * np.arange(n) + 1.0) / (block_px * m) - 1.0, -1.0, 1.0)
        for n, m in zip(shape, level.shape, strict=True)
    )
    return np.asarray(leggrid2d(row, column, coefficients.reshape(order.shape)))
