"""Images of a lens of revolution as components that turn: radial shapes times cosines and sines of the azimuth.

A star at another azimuth of the field has the same image, turned. With the image of a star on the column axis as
sum_m g_m(rho) cos(m theta), that of one at azimuth phi is

    sum_m g_m(rho) [cos(m phi) cos(m theta) + sin(m phi) sin(m theta)]

so that images along one radius determine the whole field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from optics.arrays import FloatArray, IntArray
from render.tracing.waves.pixel_kernel import BandLimited, FieldSampling

FINER = 2
"""Refinement of the samples before points of rings are interpolated."""
ROOM = 1.6
"""Oversampling of rings and azimuths relative to the highest frequency of the images."""
BATCH = 32
"""Images that are converted at a time."""
NOTHING = 0.3
"""Part of the allowed remainder for azimuthal orders without components."""
CENTROID_PX, MOMENT = 6.5, 1.0
"""Radius within which centroids count, and the weight of their error [px] against that of light [fraction]."""
TAPS = 6
"""Samples on either side of an interpolated point."""


@dataclass(frozen=True, slots=True)
class AzimuthalModes:
    """Components of n images."""

    order: IntArray  # (c,) Azimuthal order m of each
    coefficient: NDArray[np.float32]  # (n, c) Of every image
    shape: NDArray[np.float32]  # (2, c, i, i) Components on samples, for cos(m phi) and for sin(m phi)


def azimuthal_modes(
    images: NDArray[np.float32], samples_px: FloatArray, field: FieldSampling, blur_px: float, limit: float
) -> AzimuthalModes:
    """Components of images that are symmetric about the column axis."""
    # images (n, i, i), samples_px (i,)
    reach = float(samples_px[-1]) - TAPS * field.light_step
    count = math.ceil(ROOM * math.pi * reach * (1.0 / field.light_step - field.highest))
    node = np.cos(np.pi * (np.arange(count) + 0.5) / (2 * count))  # positive Chebyshev points of twice this number
    ring, angle = reach * node, np.pi * (np.arange(count) + 0.5) / count
    to_rings = _to_rings(samples_px, field, ring, angle)
    series = _series(to_rings, images, count)
    distance = (samples_px[:, None] - samples_px) / blur_px
    blur = np.exp(-0.5 * distance**2) * (field.light_step / (blur_px * math.sqrt(2.0 * math.pi)))
    blurred = _series(to_rings, (blur.astype(np.float32) @ images) @ blur.astype(np.float32), count)
    # integral of g^2 over a ring of an order, by Chebyshev's rule
    area = 0.5 * np.pi * ring * (np.pi / (2 * count)) * reach * np.sqrt(1.0 - node**2) * 2.0
    moment = (area * ring * (ring <= CENTROID_PX)) @ blurred[:, 1]
    blurred = blurred * np.sqrt(area)[:, None, None]
    blurred[:, 0] *= math.sqrt(2.0)
    blurred = np.pad(blurred, ((0, 1), (0, 0), (0, 0)))  # centroid error as an additional ring
    blurred[-1, 1] = MOMENT * moment
    bright = (blurred**2).sum(0).max(1)
    weak = np.argsort(bright)
    weak = weak[np.cumsum(bright[weak]) < (NOTHING * limit) ** 2]
    orders = np.setdiff1d(np.arange(count), weak)
    part = np.stack([_principal(blurred[:, m].T) for m in orders], axis=-1)  # (n, j, m)
    energy = part**2
    order = np.argsort(energy.max(0), axis=None)
    lost = np.cumsum(energy.reshape(len(images), -1)[:, order], axis=1).max(0) + bright[weak].sum()
    j, m = np.unravel_index(order[lost > limit**2], part.shape[1:])
    by_order = np.argsort(m, kind="stable")
    j, m = j[by_order], m[by_order]
    value = (part[:, j, m] / np.linalg.norm(part[:, j, m], axis=0)).astype(np.float32)
    m = orders[m]
    radial = np.concatenate([series[:, order] @ value[:, m == order] for order in np.unique(m)], axis=1)
    return AzimuthalModes(m, value, _on_samples(samples_px, reach, node, radial, m))


def _to_rings(
    samples_px: FloatArray, field: FieldSampling, ring: FloatArray, angle: FloatArray
) -> tuple[NDArray[np.float32], NDArray[np.float32], csr_array]:
    """Matrices (f, i) from samples to rows, from the axis on, and columns of finer samples; from those to points of
    rings."""
    step = field.light_step / FINER
    fine = np.arange(FINER * (len(samples_px) - 1) + 1) * step + samples_px[0]
    rate = 1.0 / field.light_step
    between = BandLimited(field.highest, rate - field.highest, min(3.0, 12.0 * field.light_step * FINER))
    finer = np.asarray(between(fine[:, None] - samples_px) * field.light_step, np.float32)
    near = BandLimited(field.highest, 1.0 / step - field.highest, (TAPS + 0.5) * step)
    x, y = (ring[:, None] * f(angle) for f in (np.cos, np.sin))
    index, weight = [], []
    taps = np.arange(-TAPS, TAPS + 1, dtype=np.int32)
    for position in (x.ravel(), y.ravel()):
        at = np.rint((position - fine[0]) / step).astype(np.int32)[:, None] + taps
        index.append(at)
        kernel = near(at * step + fine[0] - position[:, None])
        weight.append((kernel / kernel.sum(1, keepdims=True)).astype(np.float32))
    upper = index[1].min()
    flat = (index[1] - upper)[:, :, None] * np.int32(len(fine)) + index[0][:, None, :]
    value = weight[1][:, :, None] * weight[0][:, None, :]
    rows = np.arange(0, flat.size + 1, len(taps) ** 2, dtype=np.int32)
    matrix = csr_array((value.ravel(), flat.ravel(), rows), shape=(x.size, len(fine) * (len(fine) - upper)))
    return finer[upper:], finer.T.copy(), matrix


def _series(
    to_rings: tuple[NDArray[np.float32], NDArray[np.float32], csr_array], images: NDArray[np.float32], count: int
) -> NDArray[np.float32]:
    """Cosine series (r, m, n) of images on rings."""
    row, column, matrix = to_rings
    angle = np.pi * (np.arange(count) + 0.5) / count
    cosine = np.cos(np.outer(np.arange(count), angle)) * (2.0 / count)
    cosine[0] *= 0.5
    cosine = cosine.astype(np.float32)
    result = np.empty((count, count, len(images)), np.float32)
    for part in (slice(i, i + BATCH) for i in range(0, len(images), BATCH)):
        fine = np.stack([(row @ image @ column).ravel() for image in images[part]], axis=1)
        result[..., part] = cosine @ (matrix @ fine).reshape(count, count, -1)
    return result


def _principal(single: NDArray[np.float32]) -> FloatArray:
    """Left singular vectors times singular values (n, j) of values (n, r): coefficients of principal components."""
    values = single.astype(np.float64)
    if len(values) > values.shape[1]:
        return np.asarray(values @ np.linalg.eigh(values.T @ values)[1])
    square, vectors = np.linalg.eigh(values @ values.T)
    return np.asarray(vectors * np.sqrt(np.maximum(square, 0.0)))


def _on_samples(
    samples_px: FloatArray, reach_px: float, node: FloatArray, radial: FloatArray, order: IntArray
) -> NDArray[np.float32]:
    """Shapes (2, c, i, i) of radial ones (r, c), which are even or odd in the radius like their order."""
    x, y = np.meshgrid(samples_px, samples_px)
    distance, azimuth = np.hypot(x, y).ravel(), np.arctan2(y, x).ravel()
    inside = np.flatnonzero(distance < reach_px)
    radii, inverse = np.unique(np.round(distance[inside] / reach_px, 12), return_inverse=True)
    nodes = np.concatenate([node, -node[::-1]])
    weight = np.sin(np.arccos(nodes)) * (-1.0) ** np.arange(len(nodes))
    with np.errstate(divide="ignore"):
        part = weight / (radii[:, None] - nodes)
    part[~np.isfinite(part).all(1)] = 0.0
    part /= part.sum(1, keepdims=True)
    to_even, to_odd = (part[:, : len(node)] + sign * part[:, : len(node) - 1 : -1] for sign in (1.0, -1.0))
    shape = np.zeros((2, len(order), distance.size), np.float32)
    for m in np.unique(order):
        columns = np.flatnonzero(order == m)
        values = ((to_odd if m % 2 else to_even) @ radial[:, columns])[inverse].T
        shape[0][np.ix_(columns, inside)] = values * np.cos(m * azimuth[inside])
        shape[1][np.ix_(columns, inside)] = values * np.sin(m * azimuth[inside])
    return shape.reshape(2, len(order), *x.shape)
