"""Search of the light before measurement: the points of a target in a region, a star in wide windows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.measure.background import estimate_background
from calib.measure.detection import detect
from calib.measure.image import sensor_image
from calib.measure.stamps import coarse_position
from experiments.laboratory.bench.readout.windows import WindowReader, cut_windows
from optics.arrays import FloatArray
from optics.errors import DomainError

MATCH_PX = 4.0
"""A detection this close to a target point's nominal place is that point, with any lens."""
DISTORTED_FRACTION = 0.03
"""Additional tolerance by distortion, as a fraction of the distance from the middle of the target."""
SEARCH_MARGIN_PX = 80
"""How far the whole target may be displaced."""
SEARCH_PX = 48
"""Side of the window in which a star is looked for."""
SEEN_SIGMA = 8.0
"""A star's brightest smoothed pixel stands out of the search window's noise by this much at least."""


def find_points(
    reader: WindowReader,
    light_e: NDArray[Any],
    nominal_px: FloatArray,
    *,
    label: str,
    where: str,
    unseen: str,
    merged: str,
) -> FloatArray:
    """Detected places (j, 2) of the points of a target in one readout of its surroundings."""
    height, width = light_e.shape
    low = np.maximum(np.floor(nominal_px.min(0)).astype(np.int64) - SEARCH_MARGIN_PX, 0)
    high = np.minimum(np.ceil(nominal_px.max(0)).astype(np.int64) + SEARCH_MARGIN_PX + 1, [width, height])
    region = light_e[low[1] : high[1], low[0] : high[0]]
    stack = reader.expose(region[None], low[None], frames=1, label=label)
    image = sensor_image(
        stack.dn[0, 0],
        gain_dn_per_e=stack.gain_dn_per_e,
        offset_dn=stack.offset_dn,
        read_noise_e=stack.read_noise_e,
        defect=stack.defect[0],
        source=where,
    )
    table = detect(image, estimate_background(image))
    position = np.column_stack([table.x_px, table.y_px]) + low
    match_px = _reach_px(nominal_px)
    return match_points(position, nominal_px, match_px=match_px, where=where, unseen=unseen, merged=merged)


def _reach_px(nominal_px: FloatArray) -> float:
    """How far from its nominal place a point is looked for: distortion and scale displace it, its neighbours do not."""
    spread = float(np.linalg.norm(nominal_px - nominal_px.mean(0), axis=1).max())
    apart = np.linalg.norm(nominal_px[:, None] - nominal_px[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return max(MATCH_PX, min(DISTORTED_FRACTION * spread, 0.4 * float(apart.min())))


def match_points(
    position_px: FloatArray, nominal_px: FloatArray, *, match_px: float, where: str, unseen: str, merged: str
) -> FloatArray:
    """Detections (n, 2) matched to the points at the nominal places (j, 2), in their order.

    The lens may displace the whole image (a moved element): that is estimated first, then each point looked for close
    by. Other parameters and errors as of `find_points`.
    """
    if not len(position_px):
        raise DomainError(f"{where}: no target point was detected; {unseen}")
    offset = position_px[:, None] - nominal_px[None]
    distance = np.linalg.norm(offset - common_shift(offset.reshape(-1, 2)), axis=2)
    nearest = distance.argmin(0)
    missing = distance[nearest, np.arange(len(nominal_px))] > match_px
    if missing.any():
        x, y = nominal_px[int(np.argmax(missing))]
        raise DomainError(
            f"{where}: target points not detected: {int(missing.sum())} of {len(nominal_px)}, e.g. the one at column "
            f"{x:.1f}, row {y:.1f}; {unseen}"
        )
    if len(np.unique(nearest)) < len(nearest):
        raise DomainError(f"{where}: images of target points overlap, two of them give a single detection; {merged}")
    return position_px[nearest]


def common_shift(offset: FloatArray) -> FloatArray:
    """The displacement (2,) that most (detection, point) pairs agree on."""
    near = offset[np.linalg.norm(offset, axis=1) < SEARCH_MARGIN_PX + MATCH_PX]
    if not len(near):
        return np.zeros(2)
    votes = (np.linalg.norm(near[:, None] - near[None], axis=2) < MATCH_PX).sum(1)
    centre = near[votes.argmax()]
    return np.asarray(np.median(near[np.linalg.norm(near - centre, axis=1) < MATCH_PX], axis=0))


def find_star(reader: WindowReader, light_e: NDArray[Any], near_px: FloatArray) -> FloatArray:
    """Coarse places (n, 2) of a star, each in a wide window less the mean of two dark frames."""
    height, width = light_e.shape
    limit = np.array([width, height])
    if min(limit) < SEARCH_PX:
        raise DomainError(f"a detector of {width} x {height} px is smaller than the search window of {SEARCH_PX} px")
    corner = np.clip(np.rint(near_px).astype(np.int64) - SEARCH_PX // 2, 0, limit - SEARCH_PX)
    stack = reader.expose(cut_windows(light_e, corner, SEARCH_PX), corner, frames=1, label="search")
    dark = reader.expose(np.zeros((len(corner), SEARCH_PX, SEARCH_PX)), corner, frames=2, label="search dark")
    light = (stack.dn[0].astype(np.float64) - dark.dn.mean(0)) / stack.gain_dn_per_e
    valid = ~(stack.defect | stack.saturated[0])
    x, y = coarse_position(light, valid)
    found = np.column_stack([x, y])
    _check_seen(light, valid, found, near_px)
    return np.asarray(corner + found)


def _check_seen(light: FloatArray, valid: NDArray[np.bool_], found: FloatArray, near_px: FloatArray) -> None:
    index = np.rint(found).astype(np.int64)
    some = np.arange(len(light))
    row, column = (np.clip(index[:, k], 1, SEARCH_PX - 2) for k in (1, 0))
    block = sum(np.where(valid, light, 0.0)[some, row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1))
    spread = 1.4826 * np.median(np.abs(light - np.median(light, axis=(1, 2), keepdims=True)), axis=(1, 2))
    unseen = np.asarray(block) < SEEN_SIGMA * 3.0 * np.maximum(spread, 1e-9)
    if unseen.any():
        at = int(np.argmax(unseen))
        raise DomainError(
            f"the star is not detected within {SEARCH_PX // 2} px of column {near_px[at, 0]:.0f}, row "
            f"{near_px[at, 1]:.0f} ({int(unseen.sum())} of {len(light)} places); raise the signal, come nearer to "
            "focus, or lower the dark current"
        )
