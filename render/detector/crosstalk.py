"""Crosstalk: each pair of the 3 x 3 neighbours on a chip exchanges a fixed fraction of its difference of charge."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from render.detector.spec import Detector
from render.engine.upload import uploaded

DISPLACEMENTS = tuple((dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dx or dy)


@dataclass(frozen=True, slots=True)
class Neighbours:
    """Existing neighbours of pixels on the backend."""

    bits: Any  # (n,) `neighbour_bits`, flat
    row_length: int  # Of the flat pixel order
    fractions: tuple[float, float, float]  # Horizontal, vertical, diagonal


def frame_neighbours(detector: Detector, types: Any) -> Neighbours | None:
    """Neighbours in the whole detector; None without crosstalk."""
    return _neighbours(detector, lambda: _frame_bits(_borders(detector), types), detector.width_px)


def window_neighbours(
    detector: Detector, types: Any, column: NDArray[np.int64], row: NDArray[np.int64]
) -> Neighbours | None:
    """Neighbours in windows of columns (n, w) and rows (n, h); None without crosstalk."""
    return _neighbours(detector, lambda: uploaded(types.UInt32, neighbour_bits(detector, column, row)), column.shape[1])


def _neighbours(detector: Detector, bits: Any, row_length: int) -> Neighbours | None:
    fractions = detector.crosstalk_horizontal, detector.crosstalk_vertical, detector.crosstalk_diagonal
    return Neighbours(bits(), row_length, fractions) if any(fractions) else None


class _Borders(NamedTuple):
    """Borders between chips."""

    chip_width_px: int
    gap_px: int
    chips: int
    height_px: int


def _borders(detector: Detector) -> _Borders:
    return _Borders(*(getattr(detector, name) for name in _Borders._fields))


@lru_cache(maxsize=2)
def _frame_bits(borders: _Borders, types: Any) -> Any:
    width = borders.chips * borders.chip_width_px + (borders.chips - 1) * borders.gap_px
    return uploaded(types.UInt32, _bits(borders, np.arange(width)[None], np.arange(borders.height_px)[None]))


def neighbour_bits(detector: Detector, column: NDArray[np.int64], row: NDArray[np.int64]) -> NDArray[np.uint32]:
    """Bit i is set where the neighbour at ``DISPLACEMENTS[i]`` is in the window and on the same chip.

    Shapes: columns (n, w), rows (n, h), returns (n, h, w).
    """
    return _bits(_borders(detector), column, row)


def _bits(borders: _Borders, column: NDArray[np.int64], row: NDArray[np.int64]) -> NDArray[np.uint32]:
    period = borders.chip_width_px + borders.gap_px
    chip = np.floor_divide(column, period)
    on_chip = (column - chip * period < borders.chip_width_px) & (chip >= 0) & (chip < borders.chips)
    on_array = (row >= 0) & (row < borders.height_px)
    chip = np.where(on_chip[:, None, :] & on_array[:, :, None], chip[:, None, :], -1).astype(np.int8)
    padded = np.pad(chip, ((0, 0), (1, 1), (1, 1)), constant_values=-1)
    height, width = chip.shape[1:]
    bits = np.zeros(chip.shape, np.uint32)
    for bit, (dx, dy) in enumerate(DISPLACEMENTS):
        neighbour = padded[:, 1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]
        bits |= ((neighbour == chip) & (chip >= 0)).astype(np.uint32) << np.uint32(bit)
    return bits


def exchanged(types: Any, charge: Any, neighbours: Neighbours, pixel_of: Any) -> Any:
    """Charge (n,) after crosstalk, conserved up to the last edge.

    ``pixel_of``: entry of ``neighbours.bits`` of every pixel, where the arrays hold several frames; None: its own.
    """
    from render.engine.jit import dr

    index = dr.arange(types.UInt32, dr.width(charge))
    bits = neighbours.bits if pixel_of is None else dr.gather(types.UInt32, neighbours.bits, pixel_of)
    row_length = dr.opaque(types.Int32, neighbours.row_length)
    horizontal, vertical, diagonal = (dr.opaque(types.Float32, fraction) for fraction in neighbours.fractions)
    mixed = charge  # not "+=" below: that would write into the charge that is read
    for bit, (dx, dy) in enumerate(DISPLACEMENTS):
        fraction = diagonal if dx and dy else horizontal if dx else vertical
        exists = (bits & (1 << bit)) != 0
        neighbour = types.UInt32(types.Int32(index) + dx + dy * row_length)
        exchange = fraction * (dr.gather(types.Float32, charge, neighbour, exists) - charge)
        mixed = mixed + dr.select(exists, exchange, 0.0)
    return mixed
