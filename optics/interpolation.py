"""Interpolation in tables."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray, IntArray


def bracket(nodes: FloatArray, at: FloatArray) -> list[tuple[IntArray, FloatArray]]:
    """Indices of the nodes around positions, and their linear weights; the outermost nodes hold beyond."""
    if len(nodes) == 1:
        return [(np.zeros(at.shape, np.int64), np.ones(at.shape))]
    low = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    fraction = np.clip((at - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)
    return [(low, 1.0 - fraction), (low + 1, fraction)]


def bilinear(
    values: ArrayLike, knots: tuple[FloatArray, FloatArray], positions: tuple[FloatArray, FloatArray]
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
    from scipy.ndimage import map_coordinates  # here: every command would wait for it

    steps = [np.interp(x, k, np.arange(len(k))) for x, k in zip(positions, knots, strict=True)]
    return np.asarray(map_coordinates(np.asarray(values, np.float64), np.stack(steps), order=1, mode="nearest"))
