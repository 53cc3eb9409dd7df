"""Trails: lines of light of satellites and aeroplanes, and stars trailed by a motion of the camera.

Noise and threshold break a trail into many detections. Two of them belong together if light lies between them: the
median of the filtered image along the connecting line exceeds that of parallel lines on both sides. Single stars on the
line do not move a median, and a bright background is the same on the parallels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import label
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from optics.arrays import FloatArray

REACH_PX, END_PX, PARALLEL_PX, STEPS = 50.0, 5.0, 6.0, 24
"""Longest line between two pieces, length left out at its ends, distance of the parallels, samples of a line."""
LIGHT, SURE = 1.5, 5.0
"""Least light along the line [sigma], and in standard deviations of the median of this number of independent pixels."""
INDEPENDENT_PX, MEDIAN_SPREAD = 2.5, 1.2533
FEWEST, SHORTEST_PX, WIDEST_PX = 4, 40.0, 2.5
"""Pieces of a trail, its length and its RMS width."""
MOST_PAIRS = 200_000
STAMP_PX, BRIGHTEST, FEWEST_STARS, FEWEST_PIXELS = 12, 40, 3, 6
"""Half side of the windows of the shape of stars, number of stars, least number of stars and of pixels of a star."""
ELONGATED = 2.0
"""Ratio of the axes from which stars are trailed; a lens that is out of focus or has coma stays below."""
LIT_SIGMA = 3.0


def trail_members(signal_to_noise: FloatArray, x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which detections (n,) at columns ``x`` and rows ``y`` are part of a trail, in a filtered image (h, w) [sigma]."""
    member = np.zeros(len(x), bool)
    if len(x) < FEWEST:
        return member
    position = np.column_stack([x, y]).astype(np.float64)
    pairs = cKDTree(position).query_pairs(REACH_PX, output_type="ndarray")
    line = position[pairs[:, 1]] - position[pairs[:, 0]]
    length = np.linalg.norm(line, axis=1)
    far = length > 2.0 * END_PX + 2.0
    pairs, line, length = pairs[far], line[far], length[far]
    if not 0 < len(pairs) <= MOST_PAIRS:
        return member
    along = line / length[:, None]
    across = PARALLEL_PX * np.column_stack([-along[:, 1], along[:, 0]])
    distance = END_PX + (length - 2.0 * END_PX)[:, None] * np.linspace(0.0, 1.0, STEPS)
    points = position[pairs[:, 0], None] + distance[:, :, None] * along[:, None]
    middle, left, right = (_median(signal_to_noise, points + side[:, None]) for side in (0 * across, across, -across))
    error = MEDIAN_SPREAD / np.sqrt(np.maximum((length - 2.0 * END_PX) / INDEPENDENT_PX, 1.0))
    linked = pairs[middle - np.maximum(np.maximum(left, right), 0.0) > np.maximum(LIGHT, SURE * error)]
    graph = csr_matrix((np.ones(len(linked)), (linked[:, 0], linked[:, 1])), shape=(len(x), len(x)))
    group = connected_components(graph, directed=False)[1]
    for number in np.flatnonzero(np.bincount(group) >= FEWEST):
        rows = np.flatnonzero(group == number)
        offset = position[rows] - position[rows].mean(axis=0)
        _, singular_values, axes = np.linalg.svd(offset, full_matrices=False)
        member[rows] = np.ptp(offset @ axes[0]) > SHORTEST_PX and singular_values[1] / np.sqrt(len(rows)) < WIDEST_PX
    return member


def _median(image: FloatArray, points: FloatArray) -> FloatArray:
    """Median (k,) of an image at the nearest pixels of points (k, m, 2)."""
    column = np.clip(np.rint(points[..., 0]), 0, image.shape[1] - 1).astype(np.int64)
    row = np.clip(np.rint(points[..., 1]), 0, image.shape[0] - 1).astype(np.int64)
    return np.asarray(np.median(image[row, column], axis=1))


@dataclass(frozen=True, slots=True, kw_only=True)
class StarShape:
    """Common shape of the stars of a frame."""

    trail_px: float  # Length of the trails; 0 where the stars are not elongated or fewer than three are bright enough
    width_px: float  # Standard deviation of the light across the trails; NaN where fewer than three are bright enough
    angle_deg: float  # Direction of the longer axis, from +x towards +y


def star_shape(dn: ArrayLike, position_px: FloatArray, *, noise_dn: float) -> StarShape:
    """Whether the stars of a frame (h, w) are trails or disks, from the median of their second moments.

    A uniform trail of length L adds L^2 / 12 to the second moment along it. The 40 brightest of the stars at positions
    (n, 2), brightest first, that are isolated in a window of 25 px; ``noise_dn``: sigma of a background pixel.
    """
    dn = np.asarray(dn, float)
    height, width = dn.shape
    y, x = np.mgrid[-STAMP_PX : STAMP_PX + 1, -STAMP_PX : STAMP_PX + 1]
    moments: list[FloatArray] = []
    taken: list[NDArray[np.int64]] = []
    for at in np.rint(position_px).astype(np.int64):
        if any(np.abs(at - other).max() < STAMP_PX for other in taken) or len(moments) >= BRIGHTEST:
            continue
        taken.append(at)
        if not (STAMP_PX <= at[0] < width - STAMP_PX and STAMP_PX <= at[1] < height - STAMP_PX):
            continue
        stamp = dn[at[1] - STAMP_PX : at[1] + STAMP_PX + 1, at[0] - STAMP_PX : at[0] + STAMP_PX + 1]
        light = stamp - np.median(stamp)
        parts, _ = label(light > LIT_SIGMA * noise_dn, np.ones((3, 3)))
        star = parts[STAMP_PX, STAMP_PX]
        light = np.where((parts == star) & (star > 0), light, 0.0)  # neighbours and noise would make it wide
        if np.count_nonzero(light) < FEWEST_PIXELS:
            continue
        weight = light / light.sum()
        offset = np.stack([x - (weight * x).sum(), y - (weight * y).sum()])
        moments.append(np.einsum("yx,ayx,byx->ab", weight, offset, offset))
    if len(moments) < FEWEST_STARS:
        return StarShape(trail_px=0.0, width_px=float("nan"), angle_deg=float("nan"))
    value, axes = np.linalg.eigh(np.median(moments, axis=0))
    short, long = np.sqrt(np.maximum(value, 1e-9))
    return StarShape(
        trail_px=float(np.sqrt(12.0 * (value[1] - value[0]))) if long > ELONGATED * short else 0.0,
        width_px=float(short),
        angle_deg=float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1])) % 180.0),
    )
