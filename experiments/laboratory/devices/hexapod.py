"""A hexapod (Stewart platform) that carries the camera and turns it in small steps.

The camera turns, the target is fixed: the image moves over the detector. A pose is a rotation vector [rad] of the
target seen from the camera, ``v_cam = R(pose) v_cam at rest``: a pose (0, a, 0) moves the image of an axial point by a
along increasing column, (-a, 0, 0) by a along increasing row, (0, 0, a) rolls the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from optics.units import ARCSEC_RAD, DEG_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class Hexapod:
    """A platform's errors, each a standard deviation per axis.

    ACC18 names a PI H-840 but no figures; the defaults (2 and 5 urad) are of the size that makers state for such
    platforms, rounded.
    """

    step_error_arcsec: float = 0.4  # Pitch and yaw reached against those commanded, anew at every position
    roll_error_arcsec: float = 1.0  # The same for roll about the camera's axis
    reading_error_arcsec: float = 0.2  # What the platform reports against where it is, all three axes

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise DomainError(f"Hexapod.{name} = {value} arcsec; it must be finite and not negative")


@dataclass(frozen=True, slots=True, kw_only=True)
class HexapodPath:
    """Poses of a run; rotation vectors (m, 3) [rad]."""

    commanded_rad: FloatArray  # (m, 3) What was asked for, where the platform went, what it reported
    true_rad: FloatArray  # (m, 3)
    read_rad: FloatArray  # (m, 3)

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in self.__dataclass_fields__:
            freeze(self, name, shape=("m", 3), sizes=sizes)


def step_path(
    hexapod: Hexapod,
    rng: np.random.Generator,
    *,
    positions: int,
    step_rad: float,
    direction_deg: float,
) -> HexapodPath:
    """Equal steps of the image along a straight line, the middle of the path at rest."""
    if positions < 2:
        raise DomainError(f"positions = {positions}; at least 2 are needed for a step")
    way = (np.arange(positions) - (positions - 1) / 2) * step_rad
    angle = direction_deg * DEG_RAD
    commanded = np.stack([-way * np.sin(angle), way * np.cos(angle), np.zeros(positions)], axis=1)
    size = np.array([hexapod.step_error_arcsec, hexapod.step_error_arcsec, hexapod.roll_error_arcsec]) * ARCSEC_RAD
    true = commanded + size * rng.standard_normal((positions, 3))
    read = true + hexapod.reading_error_arcsec * ARCSEC_RAD * rng.standard_normal((positions, 3))
    return HexapodPath(commanded_rad=commanded, true_rad=true, read_rad=read)


def turned(direction: FloatArray, pose_rad: FloatArray) -> FloatArray:
    """Unit vectors (m, j, 3) in cam of target points (j, 3) at m poses (m, 3)."""
    out = np.stack([Rotation.from_rotvec(pose).apply(direction) for pose in np.array(pose_rad)])
    return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))
