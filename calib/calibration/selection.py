"""Usable stars of a calibration: checks before the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.calibration.observations import Observations
from calib.cameras.base import CameraModel
from optics.arrays import BoolArray
from optics.errors import DomainError

LARGEST_OUTSIDE_PART = 0.01  # of the stars outside the detector, above which the list is in another convention


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Stars that a family of attitudes can use."""

    stars: Observations  # Stars on the detector in frames with enough of them; frame numbers as before
    used: BoolArray  # (n,) Which of all stars ``stars`` are
    note: str  # What was left out, for the message; empty if nothing was


def select_stars(observations: Observations, model: CameraModel, least: int) -> Selection:
    """Stars on the detector, in frames that hold at least ``least`` of them."""
    size = np.array([model.geometry.width_px, model.geometry.height_px])
    position = observations.pixel_px
    outside = np.any((position < -1.0) | (position > size), axis=1)
    if np.count_nonzero(outside) > LARGEST_OUTSIDE_PART * len(position):
        raise DomainError(
            f"{np.count_nonzero(outside)} of {len(position)} star positions lie outside the detector of {size[0]} x "
            f"{size[1]} px (columns {position[:, 0].min():.1f} to {position[:, 0].max():.1f}, rows "
            f"{position[:, 1].min():.1f} to {position[:, 1].max():.1f}); (column, row) from the centre of the first "
            "pixel is needed, optics.frames converts other tools' lists"
        )
    count = np.bincount(observations.frame, minlength=observations.frames)
    used = ~outside & (count >= least)[observations.frame]
    few = int(np.count_nonzero((count < least) & (count > 0)))
    notes = []
    if few:
        notes.append(f"{few} frames with fewer than {least} stars hold no information and were left out")
    if outside.any():
        notes.append(f"{np.count_nonzero(outside)} stars outside the detector were left out")
    return Selection(
        stars=observations if used.all() else observations.select(used),
        used=used,
        note="; ".join(notes),
    )
