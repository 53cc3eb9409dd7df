"""Detections matched to points of a target at nominal positions; a lens displaces them together and each a little."""

from __future__ import annotations

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError

MATCH_PX = 4.0
"""A detection this close to the nominal position of a target point is that point, with any lens."""
DISTORTED_FRACTION = 0.03
"""Additional tolerance by distortion, as a fraction of the distance from the middle of the target."""
SEARCH_MARGIN_PX = 80
"""Largest displacement of the target."""


def search_radius_px(nominal_px: FloatArray) -> float:
    """Search radius about nominal positions (j, 2): displacement by distortion and scale, below half the spacing."""
    spread = float(np.linalg.norm(nominal_px - nominal_px.mean(0), axis=1).max())
    distance = np.linalg.norm(nominal_px[:, None] - nominal_px[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return max(MATCH_PX, min(DISTORTED_FRACTION * spread, 0.4 * float(distance.min())))


def match_points(
    position_px: FloatArray, nominal_px: FloatArray, *, match_px: float, where: str, unseen: str, merged: str
) -> FloatArray:
    """Detections (n, 2) matched to the points at the nominal positions (j, 2), in their order.

    A displacement of the image (a moved element of the lens) is estimated first. ``where``, ``unseen`` and ``merged``
    are words of the messages: the readout, and the advice where points are not detected or merge.
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
    """Displacement (2,) of most (detection, point) pairs."""
    near = offset[np.linalg.norm(offset, axis=1) < SEARCH_MARGIN_PX + MATCH_PX]
    if not len(near):
        return np.zeros(2)
    votes = (np.linalg.norm(near[:, None] - near[None], axis=2) < MATCH_PX).sum(1)
    centre = near[votes.argmax()]
    return np.asarray(np.median(near[np.linalg.norm(near - centre, axis=1) < MATCH_PX], axis=0))
