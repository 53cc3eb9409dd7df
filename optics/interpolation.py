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
    """Bilinear interpolation of a table (a, b), constant beyond its edges, at positions along rows and columns.

    Shapes: ``knots`` (a,) and (b,), increasing; ``positions`` (...) and (...), like the result.
    """
    from scipy.ndimage import map_coordinates  # here: every command would wait for it

    index = np.stack([np.interp(x, k, np.arange(len(k))) for x, k in zip(positions, knots, strict=True)])
    flat = map_coordinates(np.asarray(values, np.float64), index.reshape(2, -1), order=1, mode="nearest")
    return np.asarray(flat).reshape(index.shape[1:])
