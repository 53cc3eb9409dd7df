"""Footprints of stars: rectangles that contain their spots on the pixels; flags in them, overlaps.

A footprint reaches 3 standard deviations of the spot and half a pixel from the photon centroid; the variance of the
spot is that of the rays, of the charge diffusion and of a pixel (1/12).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from optics.arrays import FloatArray, IntArray

REACH_SIGMA = 3.0
LARGEST_PX = 512.0


def footprint_px(variance_x_px2: FloatArray, variance_y_px2: FloatArray, diffusion_px: float) -> FloatArray:
    """Extent of footprints from the photon centroid along columns and rows (2, n); a point's where no ray arrives."""
    rays = np.maximum(np.nan_to_num(np.stack([variance_x_px2, variance_y_px2]), nan=0.0), 0.0)
    sigma = np.sqrt(rays + diffusion_px**2 + 1.0 / 12.0)
    return np.asarray(np.minimum(REACH_SIGMA * sigma + 0.5, LARGEST_PX))


def footprint_bits(centre_px: FloatArray, half_px: FloatArray, bits: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Bits (n,) of all pixels of an image (h, w) whose centres lie in footprints, centre and extent (2, n)."""
    size = np.array([[bits.shape[1]], [bits.shape[0]]])
    low = np.clip(np.ceil(centre_px - half_px), 0, size).astype(np.int64)
    high = np.clip(np.floor(centre_px + half_px) + 1, 0, size).astype(np.int64)
    corners = zip(*low.tolist(), *high.tolist(), strict=True)
    return np.array([np.bitwise_or.reduce(bits[y0:y1, x0:x1], axis=None) for x0, y0, x1, y1 in corners], np.int32)


def overlapping(centre_px: FloatArray, half_px: FloatArray, electrons: FloatArray, fraction: float) -> IntArray:
    """Stars (indices) whose footprint meets that of a star with at least a fraction of their electrons (n,)."""
    if not centre_px.size:
        return np.zeros(0, np.int64)
    reach = 2.0 * float(np.hypot(*half_px.max(axis=1)))
    first, second = cKDTree(centre_px.T).query_pairs(reach, output_type="ndarray").T
    overlap = (np.abs(centre_px[:, first] - centre_px[:, second]) <= half_px[:, first] + half_px[:, second]).all(0)
    first, second = first[overlap], second[overlap]
    ratio = electrons[second] / electrons[first]
    return np.asarray(np.unique(np.concatenate([first[ratio >= fraction], second[ratio <= 1.0 / fraction]])))
