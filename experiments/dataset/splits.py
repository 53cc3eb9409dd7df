"""Training, validation and test splits by the sky, so that no star of a test frame occurs in training.

Random attitudes over the sky: a cap about a random pole is for the test, the opposite cap for validation, the rest for
training; gaps as wide as the field's diagonal separate them, so that no star is in two splits. A scan runs along a
circle, once or many times: it is cut into arcs with the same gaps. A cone, or the attitudes of a list, are cut across:
one side is for the test, the other for validation, the middle for training. Frames in gaps belong to no split
(``gap``). If gaps would leave less than half of the frames, and in all other cases, frames are assigned at random, and
the leakage is reported (`leakage`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from experiments.dataset.settings import ConePointing, DatasetConfig, ScanPointing, SkyPointing, SplitsConfig
from optics.arrays import FloatArray
from optics.attitude import attitude_from_angles
from optics.errors import DomainError
from optics.units import DEG_RAD
from render.engine.random import Streams
from render.sky.partition import PARTS, PartOf, cone_directions, parts_by_arcs, parts_by_caps, parts_by_latitude

BLOCK = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class Splits:
    """Split of the frames of a dataset."""

    by: Literal["sky", "arc", "frame"]
    gap_deg: float  # Least angle between boresights of two splits; 0 by frame
    of: Callable[[int, FloatArray], str]  # ``of(frame, boresight)``: name of the split, `GAP` for none


def build_splits(
    config: DatasetConfig, streams: Streams, diagonal_deg: float, listed: FloatArray | None = None
) -> Splits:
    """The splits of a dataset; that of a frame follows from configuration, number and boresight."""
    splits = config.splits
    gap_deg = diagonal_deg if splits.gap_deg is None else splits.gap_deg
    gap_rad, circle, boresights = gap_deg * DEG_RAD, _circle(config), _cone(config) if listed is None else listed
    by = splits.by
    if by == "auto":
        on_sky = boresights is not None or isinstance(config.pointing, SkyPointing)
        by = "arc" if circle is not None else "sky" if on_sky else "frame"
    fractions = dict(zip(PARTS, (splits.train_fraction, splits.validation_fraction, splits.test_fraction), strict=True))
    try:
        if by == "sky":
            part_of = _by_sky(fractions, streams, gap_rad, boresights)
            return Splits(by=by, gap_deg=gap_deg, of=lambda _, boresight: part_of(boresight))
        if by == "arc":
            if circle is None:
                raise DomainError("by = arc needs a scan at a constant rate across the sky; take sky or frame")
            part_of = parts_by_arcs(fractions, *circle, gap_rad)
            return Splits(by=by, gap_deg=gap_deg, of=lambda _, boresight: part_of(boresight))
    except DomainError as error:  # a field too wide, a scan about the boresight
        if splits.by != "auto":
            raise DomainError(f"splits.{error}") from None
    return Splits(by="frame", gap_deg=0.0, of=lambda frame, _: _of_block(splits, streams, frame))


def _by_sky(fractions: dict[str, float], streams: Streams, gap_rad: float, boresights: FloatArray | None) -> PartOf:
    """Regions of the whole sky, or of the part that boresights (n, 3) fill."""
    normal = streams.generator("split pole", 0).standard_normal(3)
    if boresights is None:
        return parts_by_caps(fractions, normal / math.hypot(*normal), gap_rad)
    return parts_by_latitude(fractions, boresights, gap_rad, normal)


def _cone(config: DatasetConfig) -> FloatArray | None:
    """Boresights (n, 3) that fill the cone of a configuration evenly; None without one."""
    pointing = config.pointing
    if not isinstance(pointing, ConePointing):
        return None
    axes = attitude_from_angles(pointing.ra_deg, pointing.dec_deg, 0.0).as_matrix()
    return cone_directions(axes, pointing.radius_deg * DEG_RAD)


def _circle(config: DatasetConfig) -> tuple[FloatArray, FloatArray] | None:
    """Pole of the circle of a scan at a constant rate, and the boresight at its start."""
    pointing = config.pointing
    if not isinstance(pointing, ScanPointing) or pointing.file or not any(pointing.rate_deg_per_s):
        return None
    start = attitude_from_angles(pointing.ra_deg, pointing.dec_deg, pointing.roll_deg)
    rate = np.array(pointing.rate_deg_per_s)
    return start.inv().apply(rate / math.hypot(*rate)), start.as_matrix()[2]


def _of_block(splits: SplitsConfig, streams: Streams, frame: int) -> str:
    """Frames of every block of 100 are assigned in random order, with fractions exact to half a frame."""
    block, number = divmod(frame, BLOCK)
    quantile = (_order(streams, block)[number] + 0.5) / BLOCK
    if quantile < splits.train_fraction:
        return PARTS[0]
    return PARTS[1] if quantile < splits.train_fraction + splits.validation_fraction else PARTS[2]


@lru_cache(maxsize=64)
def _order(streams: Streams, block: int) -> Any:
    return streams.generator("split", block).permutation(BLOCK)
