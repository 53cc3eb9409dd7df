"""Windows about catalogue stars: isolated stars, pixels of neighbours, pixels with light of any star."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from calib.measure.background import Background
from calib.psf.gaussian_mixture import StarWindows
from calib.records import SensorImage
from optics.arrays import FloatArray, IntArray
from optics.records import concatenated

MASK_RADII = ((9.8, 3.0), (8.0, 5.0), (6.5, 8.0), (4.5, 14.0), (2.5, 30.0))
"""Radius [px] of the disk masked about a star brighter than a magnitude, for stars of width 0.65 px."""
MASK_WIDTH_PX, DETECTION_RADIUS_PX = 0.65, 5.0
NEIGHBOUR_MAG = 3.5
"""A star is isolated if no star brighter than this difference lies within reach."""
REACH_PX = 9.0
LINEAR_FRACTION = 0.85
"""Of the highest pixel of all frames: brighter pixels may be at full well below the end of the converter."""
FAINTER_MAG, NEIGHBOUR_PX = 1.5, 5.0
"""Neighbours up to this magnitude below the faintest star of a sample are masked within this radius."""


def isolated(position_px: FloatArray, magnitude: FloatArray, reach_px: float = REACH_PX) -> NDArray[np.bool_]:
    """Which of n stars at positions (n, 2), with magnitudes (n,), are isolated (`NEIGHBOUR_MAG`)."""
    near = cKDTree(position_px).query_pairs(reach_px, output_type="ndarray")
    mask = np.ones(len(position_px), bool)
    for star, other in (near.T, near.T[::-1]):
        mask[star[magnitude[other] < magnitude[star] + NEIGHBOUR_MAG]] = False
    return mask


def starlit_pixels(
    shape: tuple[int, int],
    star_px: FloatArray,
    magnitude: FloatArray,
    *,
    detected_px: FloatArray | None = None,
    width_px: float = MASK_WIDTH_PX,
) -> NDArray[np.bool_]:
    """Pixels (h, w) with light of catalogue stars at positions (n, 2), or of detections (m, 2)."""
    height, width = shape
    grow = max(width_px / MASK_WIDTH_PX, 0.6)
    disks = [(star_px[magnitude < limit], radius) for limit, radius in MASK_RADII]
    if detected_px is not None:
        disks.append((detected_px, DETECTION_RADIUS_PX))
    starlit = np.zeros(shape, bool)
    for position, radius in disks:
        x, y = np.rint(position[np.isfinite(position).all(axis=1)]).astype(np.int64).T
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        if inside.any():
            dark = np.ones(shape, bool)
            dark[y[inside], x[inside]] = False
            starlit |= distance_transform_edt(dark) <= radius * grow
    return starlit


def star_windows(
    images: Sequence[SensorImage],
    backgrounds: Sequence[Background],
    position_px: Sequence[FloatArray],
    magnitude: Sequence[FloatArray],
    colour: Sequence[IntArray],
    *,
    faintest_mag: float,
    size_px: int,
    defective: NDArray[np.bool_],
) -> StarWindows:
    """Windows about isolated, unsaturated stars brighter than ``faintest_mag``; defective pixels are not valid.

    ``position_px``, ``magnitude``, ``colour``: sequences of (n, 2), (n,), (n,), catalogue stars of each frame.
    """
    half = size_px // 2
    highest = LINEAR_FRACTION * max(float(image.dn[image.valid & ~defective].max()) for image in images)
    parts: list[StarWindows] = []
    for number, (image, background, position, mag) in enumerate(
        zip(images, backgrounds, position_px, magnitude, strict=True)
    ):
        height, width = image.dn.shape
        x, y = position.T
        inside = (x > half + 1) & (x < width - half - 2) & (y > half + 1) & (y < height - half - 2)
        rows = np.flatnonzero(inside & (mag < faintest_mag) & isolated(position, mag))
        level = image.noise.offset_dn + image.noise.gain_dn_per_e * background.level_at(x[rows], y[rows])
        middle = np.rint(position[rows]).astype(np.int64)
        at_y = (middle[:, 1, None] - half + np.arange(size_px))[:, :, None]
        at_x = (middle[:, 0, None] - half + np.arange(size_px))[:, None, :]
        pixels = image.dn[at_y, at_x]
        linear = ~(image.saturated[at_y, at_x] | (pixels > highest)).any(axis=(1, 2))
        rows, middle, at_y, at_x, level = rows[linear], middle[linear], at_y[linear], at_x[linear], level[linear]
        neighbours = _neighbour_pixels(position, rows, at_x, at_y, mag < faintest_mag + FAINTER_MAG)
        parts.append(
            StarWindows(
                dn=pixels[linear] - level[:, None, None],
                offset_px=position[rows] - middle,
                position_px=position[rows],
                colour=colour[number][rows],
                frame=np.full(len(rows), number),
                star=rows,
                level_dn=level,
                valid=image.valid[at_y, at_x] & ~defective[at_y, at_x] & ~neighbours,
            )
        )
    return concatenated(parts)


def _neighbour_pixels(
    position_px: FloatArray, rows: IntArray, at_x: IntArray, at_y: IntArray, bright: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Pixels (n, s, s) whose nearest bright star is not the star of the window, and within its reach."""
    others = np.flatnonzero(bright)
    x, y = np.broadcast_arrays(at_x, at_y)
    if not len(others) or not x.size:
        return np.zeros(x.shape, bool)
    distance, nearest = cKDTree(position_px[others]).query(np.stack([x, y], axis=-1))
    return np.asarray((others[nearest] != rows[:, None, None]) & (distance < NEIGHBOUR_PX))
