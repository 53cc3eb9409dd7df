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
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from experiments.dataset.settings import ConePointing, DatasetConfig, ScanPointing, SkyPointing, SplitsConfig
from optics.arrays import FloatArray
from optics.attitude import attitude_from_angles
from optics.errors import DomainError
from optics.units import DEG_RAD, RAD_DEG
from render.engine.random import Streams
from render.sky.partition import PARTS, PartOf, cone_directions, parts_by_arcs, parts_by_caps, parts_by_latitude

BLOCK = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class Splits:
    """Split of the frames of a dataset."""

    by: Literal["sky", "arc", "frame"]  # "sky", "arc" or "frame"
    gap_deg: float  # Least angle between boresights of two splits; 0 by frame
    of: Callable[[int, FloatArray], str]  # ``of(frame, boresight)``: name of the split, `GAP` for none


def build_splits(
    config: DatasetConfig, streams: Streams, diagonal_deg: float, listed: FloatArray | None = None
) -> Splits:
    """The splits of a dataset; which one a frame is in follows from configuration, number and boresight."""
    splits = config.splits
    gap_deg = diagonal_deg if splits.gap_deg is None else splits.gap_deg
    circle, boresights = _circle(config), listed if listed is not None else _cone(config)
    with _named():
        if splits.by == "auto":
            with suppress(DomainError):  # a field too wide, a scan about the boresight
                if circle is not None:
                    return _spatial("arc", gap_deg, parts_by_arcs(_fractions(splits), *circle, gap_deg * DEG_RAD))
                if boresights is not None or isinstance(config.pointing, SkyPointing):
                    return _by_sky(splits, streams, gap_deg, boresights)
        if splits.by == "sky":
            return _by_sky(splits, streams, gap_deg, boresights)
        if splits.by == "arc":
            if circle is None:
                raise DomainError("by = arc needs a scan at a constant rate across the sky; take sky or frame")
            return _spatial("arc", gap_deg, parts_by_arcs(_fractions(splits), *circle, gap_deg * DEG_RAD))
    return Splits(by="frame", gap_deg=0.0, of=lambda frame, _: _of_block(splits, streams, frame))


@contextmanager
def _named() -> Iterator[None]:
    """Messages that begin with a key of the table ``splits``."""
    try:
        yield
    except DomainError as error:
        raise DomainError(f"splits.{error}") from None


def _fractions(splits: SplitsConfig) -> dict[str, float]:
    return dict(zip(PARTS, (splits.train_fraction, splits.validation_fraction, splits.test_fraction), strict=True))


def _spatial(by: Literal["sky", "arc"], gap_deg: float, part_of: PartOf) -> Splits:
    return Splits(by=by, gap_deg=gap_deg * DEG_RAD * RAD_DEG, of=lambda _, boresight: part_of(boresight))


def _by_sky(splits: SplitsConfig, streams: Streams, gap_deg: float, boresights: FloatArray | None) -> Splits:
    """Regions of all the sky, or of the part that boresights (n, 3) fill."""
    normal = streams.generator("split pole", 0).standard_normal(3)
    gap_rad = gap_deg * DEG_RAD
    if boresights is None:
        pole = normal / math.hypot(*normal)
        return _spatial("sky", gap_deg, parts_by_caps(_fractions(splits), pole, gap_rad))
    return _spatial("sky", gap_deg, parts_by_latitude(_fractions(splits), boresights, gap_rad, normal))


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
    """Every block of 100 frames is shared out as exactly as whole frames allow."""
    block, place = divmod(frame, BLOCK)
    position = (_order(streams, block)[place] + 0.5) / BLOCK
    if position < splits.train_fraction:
        return PARTS[0]
    return PARTS[1] if position < splits.train_fraction + splits.validation_fraction else PARTS[2]


@lru_cache(maxsize=64)
def _order(streams: Streams, block: int) -> Any:
    return streams.generator("split", block).permutation(BLOCK)
