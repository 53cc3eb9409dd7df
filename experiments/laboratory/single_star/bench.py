"""Geometry of the bench: table angles for image positions, and the resulting view of the camera.

Three frames: the laboratory, in which the star is fixed and which is the table's frame at zero angles; the table top;
the camera. With the installation M (cam from table top) and the table's attitude R (laboratory from table top)::

    v_cam = M R^T s
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.laboratory.devices.turntable import Turntable
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all
from render.engine.random import Streams

AIM_STEPS = 60
AIM_TOLERANCE_RAD = 1e-12
LONGEST_STEP_RAD = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """True star, table and camera mounting."""

    table: Turntable  # The table
    star: FloatArray  # (3,) Direction of the star in the laboratory
    installation: Rotation  # Cam from table top

    def __post_init__(self) -> None:
        freeze(self, "star", shape=(3,))

    def seen(self, angle_rad: FloatArray) -> FloatArray:
        """Unit vectors (n, 3) in cam towards the star at true angles (n, k)."""
        on_table = self.table.rotation(angle_rad).inv().apply(self.star.copy())
        return np.asarray(self.installation.apply(on_table))


@dataclass(frozen=True, slots=True, kw_only=True)
class Visits:
    """n places that the star's image visits."""

    wanted_px: FloatArray  # (n, 2) Where the image was to be
    true_rad: FloatArray  # (n, k) Angles of the table as they are and as they are read, mean of all readings
    reading_rad: FloatArray  # (n, k)
    direction: FloatArray  # (n, 3) Unit vectors in cam towards the star, at the true angles

    def __post_init__(self) -> None:
        freeze_all(self, wanted_px=("n", 2), true_rad=("n", "k"), reading_rad=("n", "k"), direction=("n", 3))

    def __len__(self) -> int:
        return len(self.wanted_px)


def aim(bench: Bench, wanted_cam: FloatArray, roll_rad: FloatArray) -> FloatArray:
    """Angles that put the star at wanted directions in cam."""
    table, count = bench.table, len(bench.table.axis)
    on_table = bench.installation.inv().apply(wanted_cam)
    angle = np.zeros((len(wanted_cam), count))
    if count == 3:
        angle[:, 2] = roll_rad
    off = np.full(len(wanted_cam), np.inf)
    for _ in range(AIM_STEPS):
        now = table.rotation(angle).apply(on_table)
        off = np.linalg.norm(bench.star - now, axis=1)
        if off.max() < AIM_TOLERANCE_RAD:
            return angle
        motion = np.cross(table.angle_rates(angle)[:, :2], now[:, None])  # (n, 2, 3): of the star, per radian
        step = (np.linalg.pinv(np.swapaxes(motion, 1, 2), rcond=1e-6) @ (bench.star - now)[..., None])[..., 0]
        longest = np.abs(step).max(1, keepdims=True)
        angle[:, :2] += step * np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(longest, 1e-300))
    at = int(np.argmax(off))
    raise DomainError(
        f"the table cannot turn the camera so that the star appears at place {at}: the closest approach is "
        f"{np.degrees(off[at]):.3g} deg; at zero angles the star should be near the camera's axis and perpendicular "
        "to the outer two axes"
    )


def visit(
    bench: Bench,
    wanted_px: FloatArray,
    wanted_cam: FloatArray,
    roll_rad: FloatArray,
    streams: Streams,
    *,
    readings: int,
) -> Visits:
    """Turn the table to every wanted place and read it there several times, with the errors of setting and reading."""
    true = bench.table.set(aim(bench, wanted_cam, roll_rad), streams)
    return Visits(
        wanted_px=wanted_px,
        true_rad=true,
        reading_rad=np.mean([bench.table.read(true, streams, call=i) for i in range(readings)], axis=0),
        direction=bench.seen(true),
    )
