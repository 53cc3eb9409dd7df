"""Displacement of stars on the detector while a frame is exposed and its rows are read."""

from __future__ import annotations

import math
from dataclasses import dataclass

from optics.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageMotion:
    """Largest displacements of stars [px]; made by `image_motion`."""

    trail_px: float  # During the exposure of a row, by the angular velocity across the boresight
    drift_px: float  # From the middle of the frame to its start or end, all rows, by the same velocity
    jitter_px: float  # By random motion across the boresight
    roll_px: float  # Of what may come in over the corners by turns about the boresight
    corner_px: float  # Distance of the corners from the axis
    most_px: float  # Half of the shorter side: stars that move farther leave the frame

    @property
    def reach_px(self) -> float:
        """Distance from the detector from which stars may come in."""
        return self.drift_px + self.jitter_px + self.roll_px


def image_motion(
    *,
    across_rad_per_s: float,
    about_rad_per_s: float,
    jitter_rad: FloatArray,
    exposure_s: float,
    duration_s: float,
    pixel_rad: float,
    size_px: tuple[int, int],
) -> ImageMotion:
    """Displacements by an angular velocity across and about the boresight, and by jitter.

    ``jitter_rad`` (3,): amplitude about x, y and the boresight. ``duration_s`` runs from the start of the first row's
    exposure to the end of the last one's. A turn by an angle a moves a corner by ``a`` times its distance r from the
    axis, and brings in no star from farther than the corners: at most r minus half of the shorter side.
    """
    corner_px = 0.5 * float(math.hypot(*size_px))
    drift_px = 0.5 * duration_s * across_rad_per_s / pixel_rad
    turn_rad = 0.5 * duration_s * about_rad_per_s + float(jitter_rad[2])
    return ImageMotion(
        trail_px=across_rad_per_s * exposure_s / pixel_rad,
        drift_px=drift_px,
        jitter_px=math.hypot(jitter_rad[0], jitter_rad[1]) / pixel_rad,
        roll_px=min(turn_rad * corner_px, corner_px - 0.5 * min(size_px)),
        corner_px=corner_px,
        most_px=0.5 * min(size_px),
    )
