"""Stamps into the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["add_stamps"]

FloatArray = NDArray[np.float64]


def add_stamps(
    image: NDArray[np.float32], cells: FloatArray, corner_px: FloatArray, electrons: FloatArray, oversampling: int
) -> FloatArray:
    """Bin stamps to pixels and add them to the image, in the order of the stars.

    Parameters
    ----------
    image : (h, w, b) float32
        Changed in place.
    cells : (s, b, m * oversampling, m * oversampling)
        Share of a star's light per cell.
    corner_px : (s, b, 2)
        Outer corner of the stamps (half-integers).
    electrons : (s, b)
        Light of each star and band [e-].
    oversampling : int
        Cells per pixel.

    Returns
    -------
    (s, b)
        Share of each star's light that fell on the image.
    """
    stars, bands, fine, _ = cells.shape
    size = fine // oversampling
    share = cells.reshape(stars, bands, size, oversampling, size, oversampling).sum((3, 5))
    height, width, _ = image.shape
    column = np.rint(corner_px[..., 0] + 0.5).astype(np.int64)[..., None] + np.arange(size)
    row = np.rint(corner_px[..., 1] + 0.5).astype(np.int64)[..., None] + np.arange(size)
    inside = ((row >= 0) & (row < height))[..., :, None] & ((column >= 0) & (column < width))[..., None, :]
    band = np.arange(bands)[None, :, None, None]
    flat = (
        np.clip(row, 0, height - 1)[..., :, None] * width + np.clip(column, 0, width - 1)[..., None, :]
    ) * bands + band
    share = np.where(inside, share, 0.0)
    lit = share > 0
    values = (share * electrons[..., None, None])[lit].astype(np.float32)
    np.add.at(image.reshape(-1), flat[lit], values)
    return share.sum((2, 3))
