"""Interpolation in tables."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray


def bilinear(
    values: ArrayLike, knots: tuple[ArrayLike, ArrayLike], positions: tuple[ArrayLike, ArrayLike]
) -> FloatArray:
    """Bilinear interpolation of a table, constant beyond its edges.

    Parameters
    ----------
    values : (a, b)
        Table.
    knots : (a,), (b,)
        Increasing positions of its rows and columns.
    positions : (n,), (n,)
        Where it is read along rows and columns.

    Returns
    -------
    (n,)
        Interpolated values.
    """
    table = np.asarray(values, np.float64)
    steps = [np.interp(x, k, np.arange(len(np.asarray(k)))) for x, k in zip(positions, knots, strict=True)]
    first = [np.minimum(step.astype(np.int64), size - 2) for step, size in zip(steps, table.shape, strict=True)]
    (row, column), (y, x) = first, (step - start for step, start in zip(steps, first, strict=True))
    upper = table[row, column] * (1.0 - x) + table[row, column + 1] * x
    lower = table[row + 1, column] * (1.0 - x) + table[row + 1, column + 1] * x
    return np.asarray(upper * (1.0 - y) + lower * y)
