"""Fixed patterns of one chip, as a function of the detector's ``sensor_seed`` and the pixel.

Every map is a pure function of (sensor seed, map name, pixel index in the whole detector), so that a window computes
only its own pixels, with the values of the full map.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass, fields
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optics.records import freeze
from render.detector.spec import Detector
from render.engine import Engine
from render.engine.random import Streams
from render.engine.upload import uploaded

_WHOLE = ("width_px", "height_px", "chip_width_px", "gap_px")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorMaps:
    """The patterns of one detector, for calibration frames and comparisons."""

    response: NDArray[np.float32]  # (h, w) Response over its mean: 1 + PRNU; 0 for dead pixels and in gaps
    # (h, w) Dark current at the reference temperature [e-/s], hot pixels included
    dark_current_e_per_s: NDArray[np.float32]
    read_noise_e: NDArray[np.float32]  # (h, w) Temporal dark noise [e-]
    offset_dn: NDArray[np.float32]  # (h, w) Offset with pixel and column pattern [DN]
    defect: NDArray[np.bool_]  # (h, w) Hot, dead, or in a gap

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for field in fields(self):
            dtype = np.bool_ if field.name == "defect" else np.float32
            freeze(self, field.name, shape=("h", "w"), dtype=dtype, sizes=sizes)


class PixelMaps(NamedTuple):
    """Patterns on the backend, flat, for the pixels of a frame or of windows (n,)."""

    response: Any
    dark_rate: Any
    read_noise: Any
    offset: Any
    defect: Any
    pixel: Any  # index in the whole detector, the counter of all streams


_Recipe = namedtuple(
    "_Recipe",
    "sensor_seed width_px height_px chip_width_px gap_px prnu dark_current_e_per_s dark_spread_e_per_s hot_fraction "
    "hot_dark_e_per_s dead_fraction read_noise_e read_noise_spread gain_dn_per_e offset_dn dsnu_e column_pattern_e "
    "damage_centres_per_px damage_dark_e_per_s damage_known_e_per_s",
)
"""Inputs of the maps; hashable, so that maps are computed once."""


def sensor_maps(detector: Detector) -> SensorMaps:
    """Patterns of the whole detector; ``sensor_seed`` selects the individual chip."""
    maps = full_maps(detector, Engine.active().types)
    arrays = (np.array(value).reshape(detector.shape) for value in maps[:5])
    return SensorMaps(**dict(zip((field.name for field in fields(SensorMaps)), arrays, strict=True)))


def dark_electrons(
    detector: Detector, exposure_s: float, *, temperature_c: float | None = None, background_e_per_s: float = 0.0
) -> NDArray[np.float32]:
    """Electrons (h, w) that an exposure adds to the light: dark current of every pixel, and background."""
    kelvin = detector.dark_reference_c if temperature_c is None else temperature_c
    rate = sensor_maps(detector).dark_current_e_per_s * detector.dark_factor(kelvin) + background_e_per_s
    return np.asarray(rate * exposure_s, np.float32)


def full_maps(detector: Detector, types: Any) -> PixelMaps:
    """Maps of all pixels, row by row; made once per detector and backend."""
    return _full_maps(_recipe(detector), types)


def window_maps(detector: Detector, types: Any, column: NDArray[np.int64], row: NDArray[np.int64]) -> PixelMaps:
    """Maps of windows, flat, from their columns (n, w) and rows (n, h); pixels outside get the values of the edge."""
    column = np.clip(column, 0, detector.width_px - 1).astype(np.uint32)
    row = np.clip(row, 0, detector.height_px - 1).astype(np.uint32)
    shape = (len(column), row.shape[1], column.shape[1])
    columns, rows = (np.broadcast_to(part, shape).ravel() for part in (column[:, None, :], row[:, :, None]))
    return _maps(_recipe(detector), types, uploaded(types.UInt32, columns), uploaded(types.UInt32, rows))


def _recipe(detector: Detector) -> _Recipe:
    return _Recipe(*(getattr(detector, name) for name in _Recipe._fields))


@lru_cache(maxsize=2)
def _full_maps(recipe: _Recipe, types: Any) -> PixelMaps:
    from render.engine.jit import dr

    index = dr.arange(types.UInt32, recipe.width_px * recipe.height_px)
    row = index // recipe.width_px
    return _maps(recipe, types, index - row * recipe.width_px, row)


def _maps(recipe: _Recipe, types: Any, column: Any, row: Any) -> PixelMaps:
    from render.engine.jit import dr
    from render.engine.philox import normal, philox4x32, split_key

    streams = Streams(recipe.sensor_seed).child("sensor")

    def key(name: str) -> tuple[Any, Any]:
        return split_key(types, streams.key(name))

    # One kernel for all detectors: numbers come from memory, not from the code.
    values = {name: value for name, value in recipe._asdict().items() if name != "sensor_seed"}
    p = SimpleNamespace(**{k: dr.opaque(types.UInt32 if k in _WHOLE else types.Float32, v) for k, v in values.items()})
    pixel = row * p.width_px + column
    gap = column % (p.chip_width_px + p.gap_px) >= p.chip_width_px
    words = philox4x32(types, (pixel, 0, 0, 0), key("defects"))
    chance = [dr.fma(types.Float32(word), 2.0**-32, 2.0**-33) for word in words[:3]]
    dead = (chance[0] < p.dead_fraction) | gap
    hot = chance[1] < p.hot_fraction
    response = dr.maximum(dr.fma(p.prnu, normal(types, pixel, key("prnu")), 1.0), 0.0)
    # Log-normal with the given mean and standard deviation: never negative, skewed like measured dark histograms.
    variance = dr.log(1.0 + dr.square(p.dark_spread_e_per_s / dr.maximum(p.dark_current_e_per_s, 1e-30)))
    variance = dr.select(p.dark_current_e_per_s > 0.0, variance, 0.0)
    spread = dr.exp(dr.sqrt(variance) * normal(types, pixel, key("dark current")) - 0.5 * variance)
    dark_rate = p.dark_current_e_per_s * spread + dr.select(hot, -p.hot_dark_e_per_s * dr.log(chance[2]), 0.0)
    read_noise = p.read_noise_e * dr.exp(p.read_noise_spread * normal(types, pixel, key("read noise spread")))
    listed = dead | hot
    if recipe.damage_centres_per_px > 0.0:
        centres = _damage(types, p, pixel, key("damage centres"), key("damage current"))
        dark_rate, listed = dark_rate + centres, listed | (centres > p.damage_known_e_per_s)
    pattern = p.dsnu_e * normal(types, pixel, key("offset"))
    pattern = pattern + p.column_pattern_e * normal(types, column, key("column offset"))
    maps = PixelMaps(
        response=dr.select(dead, 0.0, response),
        dark_rate=dr.select(gap, 0.0, dark_rate),
        read_noise=dr.select(gap, 0.0, read_noise),
        offset=p.offset_dn + dr.select(gap, 0.0, p.gain_dn_per_e * pattern),
        defect=listed,
        pixel=pixel,
    )
    dr.eval(*maps)
    return maps


def _damage(types: Any, p: SimpleNamespace, pixel: Any, centres_key: tuple[Any, Any], key: tuple[Any, Any]) -> Any:
    """Dark current of the damage centres: a Poisson number of exponential variates, each from its own counter."""
    from render.engine.jit import dr
    from render.engine.philox import philox4x32
    from render.engine.poisson import poisson

    size = dr.width(pixel)
    number = types.UInt32(poisson(types, p.damage_centres_per_px + dr.zeros(types.Float32, size), pixel, centres_key))

    def one_more(total: Any, index: Any) -> tuple[Any, Any]:
        word = philox4x32(types, (pixel, index, 0, 0), key)[0]
        return total - dr.log(dr.fma(types.Float32(word), 2.0**-32, 2.0**-33)), index + 1

    total, _ = dr.while_loop(
        (dr.zeros(types.Float32, size), dr.zeros(types.UInt32, size)),
        lambda total, index: index < number,
        one_more,
        label="damage",
    )
    return p.damage_dark_e_per_s * total
