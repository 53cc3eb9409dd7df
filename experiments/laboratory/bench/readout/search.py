"""Detection before measurement: the points of a target in a region, a star in wide windows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.measure.background import estimate_background
from calib.measure.detection.matched_filter import detect
from calib.measure.images.sensor_image import sensor_image
from calib.measure.stamps import coarse_position
from calib.measure.targets.target_points import SEARCH_MARGIN_PX, match_points, search_radius_px
from experiments.laboratory.bench.readout.windows import WindowReader, cut_windows
from optics.arrays import FloatArray
from optics.errors import DomainError

SEARCH_PX = 48
"""Side of the window in which a star is searched."""
DETECTION_SIGMA = 8.0
"""Least signal-to-noise ratio of a star's brightest pixel, smoothed over 3 x 3 pixels."""


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
    """Detected positions (j, 2) of the points of a target in one readout of its surroundings."""
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
    match_px = search_radius_px(nominal_px)
    return match_points(position, nominal_px, match_px=match_px, where=where, unseen=unseen, merged=merged)


def find_star(reader: WindowReader, light_e: NDArray[Any], near_px: FloatArray) -> FloatArray:
    """Coarse positions (n, 2) of a star, each in a wide window less the mean of two dark frames."""
    height, width = light_e.shape
    limit = np.array([width, height])
    if min(limit) < SEARCH_PX:
        raise DomainError(f"a detector of {width} x {height} px is smaller than the search window of {SEARCH_PX} px")
    corner = np.clip(np.rint(near_px).astype(np.int64) - SEARCH_PX // 2, 0, limit - SEARCH_PX)
    stack = reader.expose(cut_windows(light_e, corner, SEARCH_PX), corner, frames=1, label="search")
    dark = reader.expose(np.zeros((len(corner), SEARCH_PX, SEARCH_PX)), corner, frames=2, label="search dark")
    light = (stack.dn[0].astype(np.float64) - dark.dn.mean(0)) / stack.gain_dn_per_e
    valid = ~(stack.defect | stack.saturated[0])
    position = np.column_stack(coarse_position(light, valid))
    _check_detected(light, valid, position, near_px)
    return np.asarray(corner + position)


def _check_detected(light: FloatArray, valid: NDArray[np.bool_], position: FloatArray, near_px: FloatArray) -> None:
    index = np.rint(position).astype(np.int64)
    window = np.arange(len(light))
    row, column = (np.clip(index[:, k], 1, SEARCH_PX - 2) for k in (1, 0))
    block = sum(np.where(valid, light, 0.0)[window, row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1))
    sigma = 1.4826 * np.median(np.abs(light - np.median(light, axis=(1, 2), keepdims=True)), axis=(1, 2))  # MAD
    unseen = np.asarray(block) < DETECTION_SIGMA * 3.0 * np.maximum(sigma, 1e-9)
    if unseen.any():
        at = int(np.argmax(unseen))
        raise DomainError(
            f"the star is not detected within {SEARCH_PX // 2} px of column {near_px[at, 0]:.0f}, row "
            f"{near_px[at, 1]:.0f} ({int(unseen.sum())} of {len(light)} places); raise the signal, come nearer to "
            "focus, or lower the dark current"
        )
