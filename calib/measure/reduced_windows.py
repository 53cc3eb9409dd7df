"""Stamps of a windowed readout without background and fixed pattern; start positions of centroiders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.flags import StarFlag, has_flag
from calib.measure.stamps import centre_of_gravity, ring_background, stamps_from_windows
from calib.records import NoiseModel, Stamps
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.records import WindowStack

NEAR_PX = 3
"""Reach of the centre of gravity where fixed patterns are left in."""


def dark_subtracted(
    stack: WindowStack,
    dark_e: FloatArray,
    *,
    start_px: FloatArray | None = None,
    response: FloatArray | None = None,
) -> tuple[Stamps, NoiseModel]:
    """Stamps minus the mean dark frame; with the lamp off there is no light, so no background is left."""
    frames, count, height, width = stack.dn.shape
    stamps, noise = stamps_from_windows(stack, stack.corner_px)
    pedestal = dark_e - noise.offset_dn / noise.gain_dn_per_e
    electrons = np.where(stamps.valid, stamps.electrons - np.tile(pedestal, (frames, 1, 1)), 0.0)
    if response is not None:
        electrons = electrons / np.tile(response, (frames, 1, 1))
    if start_px is None:
        start_px = stack.corner_px + centre_of_gravity(electrons.reshape(frames, count, height, width).mean(0))
    return replace(stamps, electrons=electrons, start_px=np.tile(start_px, (frames, 1))), noise


def ring_subtracted(
    stack: WindowStack, detected_px: FloatArray, *, response: FloatArray | None = None
) -> tuple[Stamps, NoiseModel]:
    """Stamps minus the nominal offset and a background value per window; fixed patterns remain.

    The background is that of the outermost ring of the mean frame; centroiders start at its centre of gravity within
    3 px of the detection.
    """
    frames, count, height, width = stack.dn.shape
    stamps, noise = stamps_from_windows(stack, detected_px)
    if response is not None:
        stamps = replace(stamps, electrons=stamps.electrons / np.tile(response, (frames, 1, 1)))
    mean = stamps.electrons.reshape(frames, count, height, width).mean(0)
    valid = ~stack.defect
    level = ring_background(mean, valid)
    at = np.rint(detected_px - stack.corner_px)
    near_x, near_y = (np.abs(np.arange(n) - at[:, k, None]) <= NEAR_PX for k, n in enumerate((width, height)))
    near = near_y[:, :, None] & near_x[:, None, :]
    gravity = centre_of_gravity(np.where(near & valid, mean - level[:, None, None], 0.0))
    start_px = np.tile(stack.corner_px + gravity, (frames, 1))
    return replace(stamps, background_e=np.tile(level, frames), start_px=start_px), noise


def refuse_saturated(stamps: Stamps, windows: int, *, where: str, advice: str) -> None:
    """Refuse a readout of ``windows`` windows in which any is saturated in any frame."""
    full = has_flag(stamps.flags, StarFlag.SATURATED).reshape(-1, windows).any(0)
    if full.any():
        x, y = stamps.start_px[int(np.argmax(full))]
        raise DomainError(
            f"{where}: saturated at {int(full.sum())} of {windows} places, e.g. at column {x:.0f}, row {y:.0f}; "
            f"{advice}"
        )
