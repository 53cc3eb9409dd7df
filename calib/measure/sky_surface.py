"""Smooth sky of a frame: a Legendre polynomial through the levels of its blocks."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import leggrid2d, legvander2d

from calib.measure.statistics.robust import robust_rms
from optics.arrays import FloatArray

DEGREE, BLOCKS_PER_TERM = 10, 6
"""Total degree at most, and blocks for each term: finer structure would carry the frame's noise."""
CLIP_SIGMA, ROUNDS = 4.0, 3


def sky_surface(level: FloatArray, sigma: FloatArray, shape: tuple[int, int], block_px: int) -> FloatArray:
    """Level (h, w) of a frame of ``shape`` by least squares of the levels of blocks, outliers left out.

    Parameters
    ----------
    level, sigma : (r, c)
        Mean of each block and its standard deviation; NaN where there is none.
    shape : (int, int)
        Rows and columns of the frame.
    block_px : int
        Side of a block; the first ones begin at the first pixel.
    """
    rows, columns = level.shape
    terms = [(d + 1) * (d + 2) // 2 for d in range(DEGREE + 1)]
    degree = max([0, *(d for d, count in enumerate(terms) if count * BLOCKS_PER_TERM <= level.size)])
    x, y = ((2.0 * np.arange(n) + 1.0) / n - 1.0 for n in (columns, rows))
    order = np.add.outer(np.arange(degree + 1), np.arange(degree + 1))
    used = (order <= degree).ravel()
    at_y, at_x = np.meshgrid(y, x, indexing="ij")
    design = legvander2d(at_y, at_x, (degree, degree)).reshape(level.size, -1)[:, used]
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
