"""Hot and dead pixels, distinguished from stars by their shape and by their fixed position while stars move.

A star illuminates the neighbours of a pixel, a hot pixel does not. With e the excess of a pixel over the mean of its
eight neighbours and r the excess of these over the background, both in units of the noise of a pixel, a star of sigma
0.45 px in the middle of its pixel has r = 0.12 e, a wider star more, a hot pixel r = 0. In several frames a pixel is
hot if the median of e over the frames is large and the median of r is not; frames of other fields do not affect the
median. A blinking pixel is high and isolated in at least two frames, at the level of its neighbours in at least two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from calib.measure.background import estimate_background
from calib.records import SensorImage
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all

MOST_FRAMES = 32
SURE = 5.5
"""Standard deviations of the median over the frames: 0.02 pixels of 1 Mpx exceed it by noise."""
MEDIAN_SPREAD = 1.2533
BLINK_SIGMA, LOW_SIGMA, BLINK_FRAMES = 6.0, 1.5, 2
RING_FRACTION = 0.05
"""Excess of the neighbours over that of the pixel, below which it is no star; 3 standard deviations are added."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HotPixels:
    """Pixels that differ from their neighbours in every scene."""

    mask: NDArray[np.bool_]  # (h, w) All of them
    blinking: NDArray[np.bool_]  # (h, w) High in some frames only
    dead: NDArray[np.bool_]  # (h, w) Lower than their neighbours
    excess_sigma: FloatArray  # (h, w) Median excess over the neighbours [noise of a pixel]; 0 outside the mask
    frames: int  # Frames used
    threshold_sigma: float  # Excess from which a pixel is hot

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, mask=("h", "w"), blinking=("h", "w"), dead=("h", "w"), dtype=np.bool_, sizes=sizes)
        freeze(self, "excess_sigma", shape=("h", "w"), sizes=sizes)

    def __str__(self) -> str:
        blinking, dead = int(self.blinking.sum()), int(self.dead.sum())
        hot = int(self.mask.sum()) - dead
        return (
            f"{hot} hot pixels above {self.threshold_sigma:.2g} sigma ({blinking} of them blink), {dead} dead, "
            f"of {self.mask.size}; {self.frames} frame{'s' if self.frames > 1 else ''}"
        )


def find_hot_pixels(images: Sequence[SensorImage], *, threshold_sigma: float = 3.0) -> HotPixels:
    """Hot, blinking and dead pixels of one camera.

    Parameters
    ----------
    images : sequence of SensorImage
        Frames of equal size, of different parts of the sky if possible; 32 of them, evenly spread, are used. A single
        frame gives all pixels sharper than a star, cosmic rays included.
    threshold_sigma : float
        Smallest excess over the neighbours in units of the pixel noise; raised for few frames.

    Returns
    -------
    HotPixels
        ``without_pixels(image, hot.mask)`` excludes them.

    Raises
    ------
    DomainError
        No frame, or frames of unlike size.
    """
    if not images:
        raise DomainError("no frames; at least one is needed to find hot pixels")
    shape = images[0].dn.shape
    for image in images:
        if image.dn.shape != shape:
            raise DomainError(f"{image.source}: {image.dn.shape} px, {images[0].source} has {shape}")
    chosen = [images[k] for k in np.unique(np.linspace(0, len(images) - 1, MOST_FRAMES).round().astype(int))]
    excess, ring = (np.empty((len(chosen), *shape), np.float32) for _ in range(2))
    for k, image in enumerate(chosen):
        excess[k], ring[k] = _excess(image)
    sigma = np.sqrt(1.0 + 1.0 / 8.0) / np.sqrt(len(chosen)) * (MEDIAN_SPREAD if len(chosen) > 2 else 1.0)
    limit = max(threshold_sigma, SURE * sigma)
    median, neighbours = np.median(excess, axis=0), np.median(ring, axis=0)
    hot = (median > limit) & (neighbours < RING_FRACTION * median + sigma)
    dead = (median < -limit) & (np.abs(neighbours) < 2.0 * sigma + 0.2 * limit)
    isolated = (excess > BLINK_SIGMA) & (ring < RING_FRACTION * excess + 3.0 / np.sqrt(8.0))
    low = (excess < LOW_SIGMA).sum(axis=0)
    blinking = (isolated.sum(axis=0) >= BLINK_FRAMES) & (low >= BLINK_FRAMES) & (np.abs(neighbours) < 1.0)
    mask = hot | dead | blinking
    return HotPixels(
        mask=mask,
        blinking=blinking,
        dead=dead,
        excess_sigma=np.where(mask, median, 0.0),
        frames=len(chosen),
        threshold_sigma=float(limit),
    )


def without_pixels(image: SensorImage, mask: NDArray[np.bool_]) -> SensorImage:
    """Exclude pixels from every measurement.

    Parameters
    ----------
    image : SensorImage
        The image.
    mask : (h, w) bool
        Pixels to leave out, e.g. of `find_hot_pixels`.

    Returns
    -------
    SensorImage
        The same numbers, with these pixels not valid.

    Raises
    ------
    DomainError
        The mask has another shape than the image.
    """
    if np.shape(mask) != image.dn.shape:
        raise DomainError(f"mask has shape {np.shape(mask)}, the image {image.dn.shape}; they must agree")
    return replace(image, valid=image.valid & ~np.asarray(mask, dtype=bool))


def _excess(image: SensorImage) -> tuple[FloatArray, FloatArray]:
    """Excess over the neighbours, and that of the neighbours over the background, in units of the noise."""
    sky = estimate_background(image, step_px=2 if min(image.dn.shape) >= 512 else 1)
    sigma = np.maximum(sky.sigma_image(), 1e-6)
    light = (np.where(image.valid, image.noise.to_electrons(image.dn) - sky.level_image(), 0.0)) / sigma
    neighbours = (9.0 * uniform_filter(light, 3, mode="nearest") - light) / 8.0
    return np.where(image.valid, light - neighbours, 0.0), neighbours
