"""Stars of a frame as a star tracker measures them: dark subtracted, detected, centroided, without the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.measure.background import estimate_background
from calib.measure.centroiding.registry import get_centroider
from calib.measure.detection.scores import nearest_pairs
from calib.measure.find import find_stamps
from calib.measure.images.sensor_image import subtract_dark
from calib.records import NoiseModel, StarTable
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from render.records import Frame, PsfGrid

FWHM_PX = 1.8
"""Width of the detection filter: a spot of sigma 0.7 px on the pixels."""
SMEAR_PX = 0.25
"""Longest trail that is measured like a star at rest."""
BACKGROUND_STEP_PX = 4
"""Every 16th pixel gives the level of a sky that is flat over hundreds of pixels to a fraction of an electron. The
noise of a cell has an error of some 3 % then, which at 5 sigma adds a third of the false alarms."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameReduction:
    """Settings of a reduction: dark frame, noise model, centroider, detection limit."""

    dark_dn: NDArray[np.float32]  # (h, w) Mean of frames without light
    noise: NoiseModel  # Of a frame minus that mean
    centroid: str  # Name of a centroider
    window_px: int  # Its window
    threshold_sigma: float  # Detection limit
    fwhm_px: float = FWHM_PX  # Width of the detection filter
    psfs: PsfGrid | None = None  # For a centroider that needs PSFs
    background_step_px: int = BACKGROUND_STEP_PX  # Step of the pixels used for background and noise

    def __post_init__(self) -> None:
        freeze(self, "dark_dn", shape=("h", "w"), dtype=np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredFrame:
    """Stars of one frame."""

    stars: StarTable  # All detections with their centroids, brightest first
    fit: NDArray[np.bool_]  # (n,) Whether a star may be used for an attitude: `StarTable.fit`
    detected_px: FloatArray  # (n, 2) Positions of the detections, before the centroid

    def matched(self, star_px: FloatArray, near_px: float, match_px: float) -> tuple[NDArray[np.int64], int]:
        """Detection of each star (n,), -1 for none, and the number of false detections, beyond ``near_px`` from all.

        Detections flagged as too sharp for a star are left out.
        """
        detection, visible = np.full(len(star_px), -1), np.flatnonzero(np.isfinite(star_px).all(axis=1))
        pairs = nearest_pairs(star_px[visible], self.detected_px, match_px)
        detection[visible] = pairs.detection
        return detection, int(np.count_nonzero((pairs.distance_px > near_px) & ~self.stars.sharp))

    def at_positions(self, pixel_px: FloatArray) -> MeasuredFrame:
        """The same stars at other positions (n, 2)."""
        return replace(self, stars=replace(self.stars, x_px=pixel_px[:, 0], y_px=pixel_px[:, 1]))


def measure_frame(frame: Frame, reduction: FrameReduction, *, smear_px: float = 0.0) -> MeasuredFrame:
    """Detect and centroid the stars of a frame.

    A PSF at rest does not fit a trail: with ``smear_px`` of motion by the rate of the camera, positions are first
    moments under a Gaussian window (`calib.measure.centroiders.windowed.WindowedCentroid`), in a window that contains
    the trail.
    """
    image = subtract_dark(frame, reduction.dark_dn, noise=reduction.noise)
    try:
        background = estimate_background(image, step_px=reduction.background_step_px)
    except DomainError:  # saturated all over
        return MeasuredFrame(stars=StarTable.empty(), fit=np.zeros(0, np.bool_), detected_px=np.zeros((0, 2)))
    moving = smear_px > SMEAR_PX
    window_px = reduction.window_px + (2 * math.ceil(smear_px / 2.0) if moving else 0)
    stamps = find_stamps(
        image,
        background=background,
        threshold_sigma=reduction.threshold_sigma,
        fwhm_px=reduction.fwhm_px,
        size_px=min(window_px, (min(frame.dn.shape) - 1) // 2 * 2 + 1),
    )
    options: dict[str, Any] = {}
    if not moving and reduction.psfs is not None:
        stamps = replace(stamps, psf_index=reduction.psfs.nearest(stamps.start_px[:, 0], stamps.start_px[:, 1]))
        options = {"epsf": reduction.psfs.psfs}
    stars = get_centroider("windowed" if moving else reduction.centroid, **options).measure(stamps, image.noise)
    return MeasuredFrame(stars=stars, fit=stars.fit, detected_px=stamps.start_px)
