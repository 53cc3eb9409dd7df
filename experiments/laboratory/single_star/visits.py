"""Positions of the star's image: the table is set for each and read."""

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
    """n positions that the star's image visits, with a table of k axes."""

    wanted_px: FloatArray  # (n, 2) Commanded image positions
    true_rad: FloatArray  # (n, k) Angles of the table
    reading_rad: FloatArray  # (n, k) Mean of all readings
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
    """Turn the table to every position and read it several times, with the errors of setting and reading."""
    assert isinstance(bench.table, Turntable)
    true = bench.table.set(aiming_angles(bench, wanted_cam, roll_rad), streams)
    return Visits(
        wanted_px=wanted_px,
        true_rad=true,
        reading_rad=np.mean([bench.table.read(true, streams, call=call) for call in range(readings)], axis=0),
        direction=bench.star_in_cam(true),
    )
