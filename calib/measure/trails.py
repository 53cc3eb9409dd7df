"""Detections that belong to a line of light: satellites and aeroplanes.

Noise and threshold break a trail into many detections. Two of them belong together if light lies between them: the
median of the filtered image along the connecting line exceeds that of parallel lines on both sides. Single stars on the
line do not move a median, and a bright background is the same on the parallels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from optics.arrays import FloatArray

REACH_PX, END_PX, BESIDE_PX, STEPS = 50.0, 5.0, 6.0, 24
"""Longest way between two pieces, what is left out at its ends, distance of the parallels, samples of a way."""
LIGHT, SURE = 1.5, 5.0
"""Least light along the way [sigma], and in standard deviations of the median of this number of independent pixels."""
INDEPENDENT_PX, MEDIAN_SPREAD = 2.5, 1.2533
FEWEST, SHORTEST_PX, WIDEST_PX = 4, 40.0, 2.5
"""Pieces of a trail, its length and its RMS width."""
MOST_PAIRS = 200_000


def trail_members(signal_to_noise: FloatArray, x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which detections (n,) at columns ``x`` and rows ``y`` are part of a trail, in a filtered image (h, w) [sigma]."""
    member = np.zeros(len(x), bool)
    if len(x) < FEWEST:
        return member
    place = np.column_stack([x, y]).astype(np.float64)
    pairs = cKDTree(place).query_pairs(REACH_PX, output_type="ndarray")
    length = np.linalg.norm(place[pairs[:, 1]] - place[pairs[:, 0]], axis=1)
    pairs, length = pairs[length > 2.0 * END_PX + 2.0], length[length > 2.0 * END_PX + 2.0]
    if not 0 < len(pairs) <= MOST_PAIRS:
        return member
    along = (place[pairs[:, 1]] - place[pairs[:, 0]]) / length[:, None]
    across = BESIDE_PX * np.column_stack([-along[:, 1], along[:, 0]])
    way = END_PX + (length - 2.0 * END_PX)[:, None] * np.linspace(0.0, 1.0, STEPS)
    points = place[pairs[:, 0], None] + way[:, :, None] * along[:, None]
    middle, left, right = (_median(signal_to_noise, points + side[:, None]) for side in (0 * across, across, -across))
    error = MEDIAN_SPREAD / np.sqrt(np.maximum((length - 2.0 * END_PX) / INDEPENDENT_PX, 1.0))
    linked = pairs[middle - np.maximum(np.maximum(left, right), 0.0) > np.maximum(LIGHT, SURE * error)]
    graph = csr_matrix((np.ones(len(linked)), (linked[:, 0], linked[:, 1])), shape=(len(x), len(x)))
    group = connected_components(graph, directed=False)[1]
    for label in np.flatnonzero(np.bincount(group) >= FEWEST):
        rows = np.flatnonzero(group == label)
        spread = np.linalg.svd(place[rows] - place[rows].mean(axis=0), full_matrices=False)
        extent = np.ptp((place[rows] - place[rows].mean(axis=0)) @ spread[2][0])
        member[rows] = extent > SHORTEST_PX and spread[1][1] / np.sqrt(len(rows)) < WIDEST_PX
    return member


def _median(image: FloatArray, points: FloatArray) -> FloatArray:
    """Median (k,) of an image at the nearest pixels of points (k, m, 2)."""
    column = np.clip(np.rint(points[..., 0]), 0, image.shape[1] - 1).astype(np.int64)
    row = np.clip(np.rint(points[..., 1]), 0, image.shape[0] - 1).astype(np.int64)
    return np.asarray(np.median(image[row, column], axis=1))
