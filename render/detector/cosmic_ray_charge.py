"""Charge of cosmic rays on the backend, in the pixel order of a frame or of windows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.errors import DomainError
from render.detector.cosmic_rays import CosmicRayHits
from render.detector.spec import Detector


def frame_deposit(types: Any, hits: CosmicRayHits, detector: Detector) -> Any:
    """Charge in every pixel of the detector (h w,) [e-], or None without hits."""
    _same_size(hits, detector)
    if not len(hits.row):
        return None
    index = hits.row * detector.width_px + hits.column
    return _scattered(types, detector.width_px * detector.height_px, index, hits.charge_e)


def window_deposit(
    types: Any, hits: Sequence[CosmicRayHits], detector: Detector, column: NDArray[np.int64], row: NDArray[np.int64]
) -> Any:
    """Charge in every pixel of windows, frame after frame (m n h w,) [e-], or None without hits."""
    # column, row (n, w) or (n, h)
    inside = ((row >= 0) & (row < detector.height_px))[:, :, None]
    inside = inside & ((column >= 0) & (column < detector.width_px))[:, None, :]
    pixel = np.where(inside, row[:, :, None] * detector.width_px + column[:, None, :], -1).ravel()
    order = np.argsort(pixel, kind="stable")
    indices: list[NDArray[np.int64]] = []
    charges: list[NDArray[np.float64]] = []
    for frame, frame_hits in enumerate(hits):
        _same_size(frame_hits, detector)
        hit_pixel = frame_hits.row * detector.width_px + frame_hits.column
        first, last = (np.searchsorted(pixel, hit_pixel, side, sorter=order) for side in ("left", "right"))
        count = last - first  # windows may overlap: a pixel can stand in several
        start = np.repeat(first - np.concatenate([[0], np.cumsum(count)[:-1]]), count) if count.size else first
        indices.append(frame * pixel.size + order[start + np.arange(count.sum())])
        charges.append(np.repeat(frame_hits.charge_e, count))
    index = np.concatenate(indices)
    return _scattered(types, len(hits) * pixel.size, index, np.concatenate(charges)) if index.size else None


def _scattered(types: Any, size: int, index: NDArray[np.int64], charge: NDArray[np.float64]) -> Any:
    from render.engine.jit import dr
    from render.engine.upload import uploaded

    deposit = dr.zeros(types.Float32, size)
    to = uploaded(types.UInt32, index.astype(np.uint32))
    dr.scatter(deposit, uploaded(types.Float32, charge.astype(np.float32)), to)
    return deposit


def _same_size(hits: CosmicRayHits, detector: Detector) -> None:
    if tuple(hits.shape) != detector.shape:
        raise DomainError(
            f"hits are of a detector of shape {tuple(hits.shape)}, detector {detector.name!r} is {detector.shape}; "
            "make them for this detector"
        )
