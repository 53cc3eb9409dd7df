"""Record of a frame: what its truth file says of it and the index lists."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

__all__ = ["DiskTruth", "FrameRecord", "record_from_text"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DiskTruth:
    """The Moon or a planet that is larger than a pixel."""

    name: str  # Which; ``moon`` or ``planet``, as in the labels
    kind: str  # Which; ``moon`` or ``planet``, as in the labels
    star_id: int  # As that of planets among the stars (-10^6 - NAIF number)
    ra_deg: float  # Direction in which its middle is seen, icrs
    dec_deg: float  # Direction in which its middle is seen, icrs
    x_px: float  # Its middle (column, row) and size
    y_px: float  # Its middle (column, row) and size
    diameter_px: float  # Its middle (column, row) and size
    phase_deg: float  # Angle Sun - body - observer; direction of the Sun in the image, from +column towards +row
    sun_angle_deg: float  # Angle Sun - body - observer; direction of the Sun in the image, from +column towards +row
    magnitude: float | None  # V; None where no published equation holds
    electrons: float  # Expected electrons on the detector and their centroid
    photon_x_px: float  # Expected electrons on the detector and their centroid
    photon_y_px: float  # Expected electrons on the detector and their centroid
    noise_share: float  # Square of the image's error over the photon noise, in the pixel where it is largest


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameRecord:
    """One frame, in the units and conventions of files."""

    frame: int  # Number of the frame
    split: str  # train, validation or test
    file: str  # Frame and truth, relative to the dataset's folder
    truth: str  # Frame and truth, relative to the dataset's folder
    ra_deg: float  # Boresight and position angle of up, in the middle of the exposure
    dec_deg: float  # Boresight and position angle of up, in the middle of the exposure
    roll_deg: float  # Boresight and position angle of up, in the middle of the exposure
    # The same attitude as a quaternion cam from icrs, scalar last and not negative
    quat_xyzw: tuple[float, float, float, float]
    rate_deg_per_s: tuple[float, float, float]  # Angular velocity in camera axes at that time
    epoch_year: float  # Julian year
    exposure_s: float  # Exposure time
    stars: int  # Stars of which light reaches the detector, and those of them with a saturated pixel
    saturated: int  # Stars of which light reaches the detector, and those of them with a saturated pixel
    saturated_px: int  # Saturated pixels
    background_e: float  # Mean expected electrons per pixel of sky light
    frame_bytes: int  # Size of the frame's file
    sha256: str  # Its digest
    disks: tuple[DiskTruth, ...] = ()  # Bodies that it shows as disks; left out of the text where there are none

    def to_text(self) -> str:
        """JSON on one line, keys in their order."""
        values = asdict(self)
        if not self.disks:
            del values["disks"]
        return json.dumps(values)


def record_from_text(text: str) -> FrameRecord:
    """The record that `FrameRecord.to_text` wrote."""
    values = json.loads(text)
    for name in ("quat_xyzw", "rate_deg_per_s"):
        values[name] = tuple(values[name])
    values["disks"] = tuple(DiskTruth(**disk) for disk in values.get("disks", ()))
    return FrameRecord(**values)
