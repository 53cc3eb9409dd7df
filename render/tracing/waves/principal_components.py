"""Principal components of images, split by their parity along rows and columns, of which a quarter is stored."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Components:
    """Components of n images."""

    coefficient: NDArray[np.float32]  # (n, c), or an array of as many elements
    quarter: NDArray[np.float32]  # (c, h, h) A quarter of each component, light per px^2
    parity: IntArray  # (c,) 2 where odd along rows plus 1 where odd along columns; equal ones together


def principal_components(
    images: NDArray[np.float32], smoothing: NDArray[np.float32], disk: NDArray[np.bool_], step_px: float, limit: float
) -> Components:
    """Principal components of images (n, m, m) as pixels see them, for each parity separately.

    The inner product is that of light on pixels (``smoothing`` leads from samples to them) at every third of a pixel,
    within a disk. They are so many that the remainder, the root of its squares summed over the pixels of a stamp, is
    below a limit in every image.
    """
    stride, half = max(1, round(1.0 / (3.0 * step_px))), -(-images.shape[-1] // 2)
    folded_rows, pixel_disk = folded(smoothing[:half:stride]), disk[:half:stride, :half:stride]
    mirrored = images[:, ::-1]
    coefficient, quarters, parity = [], [], []
    for p, (row_sign, column_sign) in enumerate(product((1.0, -1.0), (1.0, -1.0))):
        upper = images[:, :half] + np.float32(row_sign) * mirrored[:, :half]
        quarter = 0.25 * (upper[:, :, :half] + np.float32(column_sign) * upper[:, :, ::-1][:, :, :half])
        row, column = folded_rows[p // 2], folded_rows[p % 2]
        on_pixels = ((row @ quarter @ column.T) * pixel_disk).reshape(len(images), -1).astype(np.float64)
        variances, vectors = np.linalg.eigh(on_pixels @ on_pixels.T)
        remainder = np.cumsum(np.maximum(variances, 0.0) * vectors**2, axis=1).max(0) * (2.0 * stride * step_px) ** 2
        retained = vectors[:, remainder > (0.5 * limit) ** 2].astype(np.float32)
        coefficient.append(retained)
        quarters.append(np.tensordot(retained, quarter, axes=(0, 0)))
        parity.append(np.full(retained.shape[1], p))
    return Components(np.concatenate(coefficient, axis=1), np.concatenate(quarters), np.concatenate(parity))


def folded(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Values (..., m) folded about their middle: weights of half an even, and of half an odd function."""
    half = -(-values.shape[-1] // 2)
    first, last = values[..., :half], values[..., ::-1][..., :half]
    even = first + last
    if values.shape[-1] % 2:
        even[..., -1] *= 0.5
    return even, first - last


def projected(row: NDArray[Any], quarters: list[NDArray[Any]], column: NDArray[Any]) -> NDArray[Any]:
    """Rows (..., n, m) times the images of quarters, one of each parity, times columns (..., k, m)."""
    (even, odd), (along, across) = folded(row), folded(column)
    product = (even @ quarters[0] + odd @ quarters[2]) @ np.swapaxes(along, -1, -2)
    return np.asarray(product + (even @ quarters[1] + odd @ quarters[3]) @ np.swapaxes(across, -1, -2))


def mirrored_field(
    bands: list[Components], moment: FloatArray, origin: FloatArray, size: int
) -> tuple[list[Components], FloatArray, FloatArray]:
    """Components, moments and origins at ``size`` x ``size`` field points from those of the upper quarter."""
    middle, count = size // 2, size - size // 2
    row, column = (v.ravel() for v in np.indices((size, size)))
    source = np.abs(row - middle) * count + np.abs(column - middle)
    coefficients = [band.coefficient.reshape(len(moment), -1, len(band.parity))[source] for band in bands]
    moment, origin = moment[source], origin[source]
    for axis, lower in ((0, column < middle), (1, row < middle)):
        moment[lower, ..., 2 + axis] *= -1.0
        origin[lower, ..., axis] *= -1.0
        for coefficient, band in zip(coefficients, bands, strict=True):
            coefficient[lower] *= np.where(band.parity >> axis & 1, np.float32(-1.0), np.float32(1.0))
    return [replace(band, coefficient=c) for band, c in zip(bands, coefficients, strict=True)], moment, origin
