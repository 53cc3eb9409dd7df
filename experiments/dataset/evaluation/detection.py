"""Detections beside the truth: which stars are found, what is found that is no star, and how far off centroids are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from calib.flags import UNFIT, StarFlag, has_flag
from experiments.dataset.truth.star_truth import FLAGS
from experiments.laboratory.readout.reduction import SMEAR_PX, MeasuredFrame
from optics.arrays import FloatArray
from optics.records import concatenated, freeze

__all__ = ["FoundStars", "compare_frame", "joined"]


MATCH_PX = 2.0
"""A detection this near to the light of a star is that star; both must be each other's nearest. Saturated stars:
`NEAR_PX`."""
NEAR_PX = 4.0
"""A detection farther than this from every rendered star is false."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundStars:
    """Stars of one or more frames, and what the detection made of them."""

    magnitude: FloatArray  # (n,) Of every star of which light reaches the detector
    snr: FloatArray  # (n,) Of every star of which light reaches the detector
    electrons: FloatArray  # (n,) Of every star of which light reaches the detector
    flags: NDArray[np.int32]  # (n,) Of the truth (`experiments.dataset.truth.star_truth.FLAGS`)
    found: NDArray[np.bool_]  # (n,) Whether a detection belongs to it
    fit: NDArray[np.bool_]  # (n,) Whether that detection has no flag of the measurement
    blend_seen: NDArray[np.bool_]  # (n,) Whether that detection is flagged ``BLEND``
    error_px: FloatArray  # (n, 2) Centroid minus centroid of the noiseless light; NaN where there is no centroid
    smear_px: FloatArray  # (n,) Length of its trail
    position_px: FloatArray  # (n, 2) Centroid of its noiseless light
    radius_px: FloatArray  # (n,) Distance from the middle of the detector
    false: NDArray[np.int64]  # (f,) Frames of detections without a star
    false_spike: NDArray[np.bool_]  # (f,) Whether these are flagged as sharper than a star or as defective
    frames: int  # Number of frames

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("magnitude", "snr", "electrons", "smear_px", "radius_px"):
            freeze(self, name, shape=("n",), sizes=sizes)
        for name, kind in (("flags", np.int32), ("found", np.bool_), ("fit", np.bool_), ("blend_seen", np.bool_)):
            freeze(self, name, shape=("n",), dtype=kind, sizes=sizes)
        for name in ("error_px", "position_px"):
            freeze(self, name, shape=("n", 2), finite=False, sizes=sizes)
        freeze(self, "false", shape=("f",), dtype=np.int64, sizes=sizes)
        freeze(self, "false_spike", shape=("f",), dtype=np.bool_, sizes=sizes)

    def has(self, flag: str) -> NDArray[np.bool_]:
        """Stars with a flag of the truth."""
        return np.asarray((self.flags & FLAGS[flag][0]) != 0)

    @property
    def clean(self) -> NDArray[np.bool_]:
        """Stars at rest that nothing disturbs: no flag of the truth but a vignetted pupil."""
        return np.asarray(((self.flags & ~np.int32(FLAGS["vignetted"][0])) == 0) & (self.smear_px <= SMEAR_PX))


def compare_frame(
    frame: int, measured: MeasuredFrame, truth: dict[str, Any], *, width_px: int, height_px: int
) -> FoundStars:
    """Lay the detections of a frame beside its truth."""
    lit = (np.asarray(truth["flags"]) & FLAGS["no_light"][0]) == 0
    star = np.column_stack([truth["photon_x_px"], truth["photon_y_px"]])[lit]
    detected = measured.detected_px
    n = len(star)
    smear = np.nan_to_num(np.hypot(truth["smear_x_px"], truth["smear_y_px"]))[lit]
    partner = np.full(n, -1)
    lonely = np.ones(len(detected), bool)
    if n and len(detected):
        distance, nearest = cKDTree(detected).query(star)
        back_distance, back = cKDTree(star).query(detected)
        burnt = (np.asarray(truth["flags"])[lit] & FLAGS["saturated"][0]) != 0  # the top of a plateau is anywhere on it
        mutual = (back[nearest] == np.arange(n)) & (distance <= np.where(burnt, NEAR_PX, MATCH_PX))
        partner[mutual] = nearest[mutual]
        lonely = back_distance > NEAR_PX + smear[back] / 2.0  # a faint trail may break up
    found = partner >= 0
    error = np.full((n, 2), np.nan)
    error[found] = measured.stars.pixel_px[partner[found]] - star[found]
    flags = np.zeros(n, np.uint32)
    flags[found] = measured.stars.flags[partner[found]]
    middle = np.array([(width_px - 1) / 2, (height_px - 1) / 2])
    return FoundStars(
        magnitude=np.asarray(truth["magnitude"])[lit],
        snr=np.asarray(truth["snr"])[lit],
        electrons=np.asarray(truth["electrons"])[lit],
        flags=np.asarray(truth["flags"], np.int32)[lit],
        found=found,
        fit=found & ~has_flag(flags, UNFIT),
        blend_seen=has_flag(flags, StarFlag.BLEND),
        error_px=error,
        smear_px=smear,
        position_px=star,
        radius_px=np.hypot(*(star - middle).T) if n else np.zeros(0),
        false=np.full(np.count_nonzero(lonely), frame),
        false_spike=measured.stars.sharp[lonely],
        frames=1,
    )


def joined(parts: list[FoundStars]) -> FoundStars:
    """Stars of several frames as one record."""
    return concatenated(parts, frames=sum(part.frames for part in parts))
