"""Places that the star's image visits: the table is set there and read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.calibration.star_bench import StarBench, aiming_angles
from experiments.laboratory.devices.turntable import Turntable
from optics.arrays import FloatArray
from optics.records import freeze_all
from render.engine.random import Streams


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


def visit(
    bench: StarBench,
    wanted_px: FloatArray,
    wanted_cam: FloatArray,
    roll_rad: FloatArray,
    streams: Streams,
    *,
    readings: int,
) -> Visits:
    """Turn the table to every wanted place and read it there several times, with the errors of setting and reading."""
    assert isinstance(bench.table, Turntable)
    true = bench.table.set(aiming_angles(bench, wanted_cam, roll_rad), streams)
    return Visits(
        wanted_px=wanted_px,
        true_rad=true,
        reading_rad=np.mean([bench.table.read(true, streams, call=i) for i in range(readings)], axis=0),
        direction=bench.star_in_cam(true),
    )
