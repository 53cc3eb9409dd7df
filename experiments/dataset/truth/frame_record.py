"""Record of a frame: what its truth file says of it and the index lists."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

__all__ = ["DiskTruth", "FrameRecord", "record_from_text"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DiskTruth:
    """The Moon or a planet that is larger than a pixel.

    Attributes
    ----------
    name, kind : str
        Which; ``moon`` or ``planet``, as in the labels.
    star_id : int
        As that of planets among the stars (-10^6 - NAIF number).
    ra_deg, dec_deg : float
        Direction in which its middle is seen, icrs.
    x_px, y_px, diameter_px : float
        Its middle (column, row) and size.
    phase_deg, sun_angle_deg : float
        Angle Sun - body - observer; direction of the Sun in the image, from +column towards +row.
    magnitude : float or None
        V; None where no published equation holds.
    electrons, photon_x_px, photon_y_px : float
        Expected electrons on the detector and their centroid.
    noise_share : float
        Square of the image's error over the photon noise, in the pixel where it is largest.
    """

    name: str
    kind: str
    star_id: int
    ra_deg: float
    dec_deg: float
    x_px: float
    y_px: float
    diameter_px: float
    phase_deg: float
    sun_angle_deg: float
    magnitude: float | None
    electrons: float
    photon_x_px: float
    photon_y_px: float
    noise_share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameRecord:
    """One frame, in the units and conventions of files.

    Attributes
    ----------
    frame : int
        Number of the frame.
    split : str
        train, validation or test.
    file, truth : str
        Frame and truth, relative to the dataset's folder.
    ra_deg, dec_deg, roll_deg : float
        Boresight and position angle of up, in the middle of the exposure.
    quat_xyzw : tuple of float
        The same attitude as a quaternion cam from icrs, scalar last and not negative.
    rate_deg_per_s : tuple of float
        Angular velocity in camera axes at that time.
    epoch_year : float
        Julian year.
    exposure_s : float
        Exposure time.
    stars, saturated : int
        Stars of which light reaches the detector, and those of them with a saturated pixel.
    saturated_px : int
        Saturated pixels.
    background_e : float
        Mean expected electrons per pixel of sky light.
    frame_bytes : int
        Size of the frame's file.
    sha256 : str
        Its digest.
    disks : tuple of DiskTruth
        Bodies that it shows as disks; left out of the text where there are none.
    """

    frame: int
    split: str
    file: str
    truth: str
    ra_deg: float
    dec_deg: float
    roll_deg: float
    quat_xyzw: tuple[float, float, float, float]
    rate_deg_per_s: tuple[float, float, float]
    epoch_year: float
    exposure_s: float
    stars: int
    saturated: int
    saturated_px: int
    background_e: float
    frame_bytes: int
    sha256: str
    disks: tuple[DiskTruth, ...] = ()

    def to_text(self) -> str:
        """JSON on one line, keys in their order."""
        values = asdict(self)
        if not self.disks:
            del values["disks"]
        return json.dumps(values)


def record_from_text(text: str) -> FrameRecord:
    """The record that `FrameRecord.to_text` wrote.

    Raises
    ------
    ValueError, TypeError
        Something else.
    """
    values = json.loads(text)
    for name in ("quat_xyzw", "rate_deg_per_s"):
        values[name] = tuple(values[name])
    values["disks"] = tuple(DiskTruth(**disk) for disk in values.get("disks", ()))
    return FrameRecord(**values)
