"""A hexapod (Stewart platform) that carries the camera and turns it in small steps.

The camera turns, the target is fixed: the image moves over the detector. A pose is a rotation vector [rad] of the
target seen from the camera, ``v_cam = R(pose) v_cam at rest``: a pose (0, a, 0) moves the image of an axial point by a
along increasing column, (-a, 0, 0) by a along increasing row, (0, 0, a) rolls the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.laboratory.settings.tables import HexapodConfig, StepConfig
from optics.arrays import FloatArray
from optics.records import freeze
from optics.units import ARCSEC_RAD, DEG_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class HexapodPath:
    """Poses of a run; rotation vectors (m, 3) [rad]."""

    commanded_rad: FloatArray
    true_rad: FloatArray  # Reached
    read_rad: FloatArray  # Reported

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in self.__dataclass_fields__:
            freeze(self, name, shape=("m", 3), sizes=sizes)


def step_path(hexapod: HexapodConfig, steps: StepConfig, pixel_arcsec: float, rng: np.random.Generator) -> HexapodPath:
    """Equal steps of the image along a straight line, the middle of the path at rest."""
    distance = (np.arange(steps.positions) - (steps.positions - 1) / 2) * steps.step_px * pixel_arcsec * ARCSEC_RAD
    angle = steps.direction_deg * DEG_RAD
    commanded = np.stack([-distance * np.sin(angle), distance * np.cos(angle), np.zeros(steps.positions)], axis=1)
    size = np.array([hexapod.step_error_arcsec, hexapod.step_error_arcsec, hexapod.roll_error_arcsec]) * ARCSEC_RAD
    true = commanded + size * rng.standard_normal((steps.positions, 3))
    read = true + hexapod.reading_error_arcsec * ARCSEC_RAD * rng.standard_normal((steps.positions, 3))
    return HexapodPath(commanded_rad=commanded, true_rad=true, read_rad=read)


def turned(direction: FloatArray, pose_rad: FloatArray) -> FloatArray:
    """Unit vectors (m, j, 3) in cam of target points (j, 3) at m poses (m, 3)."""
    vectors = np.stack([Rotation.from_rotvec(pose).apply(direction) for pose in np.array(pose_rad)])
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
