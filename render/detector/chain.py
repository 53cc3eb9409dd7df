"""The detector chain on Dr.Jit arrays: expected electrons to digital numbers, in one kernel (two with crosstalk).

`render.detector.readout` is the public interface and lists the order of effects; here are flat arrays of pixels, of
frames and windows alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.detector.crosstalk import Neighbours, exchanged
from render.detector.full_well import filled_wells
from render.detector.maps import PixelMaps
from render.detector.nonlinearity import relative_gain
from render.detector.spec import Detector
from render.engine.jit import dr
from render.engine.philox import normal, split_key
from render.engine.poisson import INVERSION_LIMIT, poisson
from render.engine.random import Streams

_FRAME_AXIS_LIMIT = 1 << 24


@dataclass(frozen=True, slots=True)
class ReadoutConditions:
    """Conditions of a readout: factors on the maps, and the streams."""

    signal_factor: float
    background_e: float
    dark_factor_s: float  # exposure time times dark current over that at the reference
    streams: Streams
    first_frame: int
    frames: int
    typical_e: float = 0.0  # signal of most pixels; a hint for the choice of the kernel, without effect on any number


def digitise(
    types: Any,
    expected: Any,
    *,
    maps: PixelMaps,
    neighbours: Neighbours | None,
    detector: Detector,
    conditions: ReadoutConditions,
    deposit: Any = None,
) -> NDArray[np.uint32]:
    """Read all pixels (n,) out in all frames, (frames, n); ``deposit`` (frames n,) [e-] is charge of cosmic rays."""
    size = dr.width(expected)
    step = max(1, _FRAME_AXIS_LIMIT // max(size, 1))
    numbers = _numbers(types, detector, conditions)
    parts = []
    for start in range(0, conditions.frames, step):
        count = min(step, conditions.frames - start)
        keys = _keys(types, conditions, start, count, size)
        part = deposit
        if deposit is not None and count < conditions.frames:
            part = dr.gather(types.Float32, deposit, dr.arange(types.UInt32, count * size) + start * size)
        packed = _read(types, expected, part, maps=maps, neighbours=neighbours, numbers=numbers, keys=keys)
        parts.append(np.asarray(packed).reshape(count, size))
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _numbers(types: Any, detector: Detector, conditions: ReadoutConditions) -> dict[str, Any]:
    """Everything a kernel needs of detector and exposure, read from memory: another value is not another kernel."""
    values = {
        "signal_factor": conditions.signal_factor,
        "background_e": conditions.background_e,
        "dark_factor_s": conditions.dark_factor_s,
        "full_well_e": detector.full_well_e,
        "per_full_well": 1.0 / detector.full_well_e,
        "gain": detector.gain_dn_per_e,
        "largest": float(detector.largest_dn),
    }
    numbers: dict[str, Any] = {name: dr.opaque(types.Float32, value) for name, value in values.items()}
    level = conditions.typical_e + conditions.background_e + detector.dark_current_e_per_s * conditions.dark_factor_s
    numbers["dark"] = level < INVERSION_LIMIT / 2.0
    numbers["nonlinearity"] = [dr.opaque(types.Float32, value) for value in detector.nonlinearity]
    return numbers


def _keys(types: Any, conditions: ReadoutConditions, start: int, count: int, size: int) -> dict[str, Any]:
    """Stream keys per pixel of ``count`` frames, and which of the ``size`` pixels each entry is (None: itself)."""
    first = conditions.first_frame + start
    if count == 1:
        scalars = {name: split_key(types, conditions.streams.key(name, first)) for name in ("photon", "read noise")}
        return {**scalars, "pixel": None}
    index = dr.arange(types.UInt32, count * size)
    frame = index // dr.opaque(types.UInt32, size)
    keys: dict[str, Any] = {"pixel": index - frame * dr.opaque(types.UInt32, size)}
    for name in ("photon", "read noise"):
        table = [conditions.streams.key(name, first + i) for i in range(count)]
        words = [types.UInt32(np.array([(k >> shift) & 0xFFFFFFFF for k in table], np.uint32)) for shift in (0, 32)]
        keys[name] = tuple(dr.gather(types.UInt32, word, frame) for word in words)
    return keys


def _read(
    types: Any,
    expected: Any,
    deposit: Any,
    *,
    maps: PixelMaps,
    neighbours: Neighbours | None,
    numbers: dict[str, Any],
    keys: dict[str, Any],
) -> Any:
    pixel = keys["pixel"]
    if pixel is not None:
        expected = dr.gather(types.Float32, expected, pixel)
        maps = PixelMaps(*(dr.gather(type(value), value, pixel) for value in maps))
    # PRNU on all light, then one Poisson variate for light and dark current together: a sum of Poisson variates is one
    light = expected * numbers["signal_factor"] + numbers["background_e"]
    mean = maps.response * light + maps.dark_rate * numbers["dark_factor_s"]
    charge = types.Float32(poisson(types, mean, maps.pixel, keys["photon"], mostly_small=numbers["dark"]))
    if deposit is not None:  # gaps and dead pixels collect nothing
        charge = charge + dr.select(maps.response > 0.0, deposit, 0.0)
    charge, saturated = filled_wells(charge, numbers["full_well_e"])
    if neighbours is not None:
        dr.eval(charge)  # neighbours are read from memory: the only place where the chain is cut in two kernels
        charge = exchanged(types, charge, neighbours, pixel)
    signal = charge + maps.read_noise * normal(types, maps.pixel, keys["read noise"])
    gain = numbers["gain"] * signal * relative_gain(signal * numbers["per_full_well"], numbers["nonlinearity"])
    # round half to even, then the ends of the converter
    number = dr.minimum(dr.maximum(dr.round(gain + maps.offset), 0.0), numbers["largest"])
    saturated = saturated | (number >= numbers["largest"])
    return types.UInt32(number) | dr.select(saturated, types.UInt32(1 << 16), types.UInt32(0))
