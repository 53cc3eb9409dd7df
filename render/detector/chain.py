"""The detector chain on Dr.Jit arrays: expected electrons to digital numbers, in one kernel (two with crosstalk).

`render.detector.readout` is the public interface; here are arrays of pixels only, of frames and windows alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.detector.maps import DISPLACEMENTS, PixelMaps
from render.detector.spec import Detector
from render.engine.jit import dr
from render.engine.philox import normal, split_key
from render.engine.poisson import INVERSION_LIMIT, poisson
from render.engine.random import Streams

_FRAME_AXIS_LIMIT = 1 << 24


@dataclass(frozen=True, slots=True)
class Exposure:
    """Conditions of a readout: factors on the maps, and the streams."""

    signal_factor: float
    background_e: float
    dark_factor_s: float  # exposure time times dark current over that at the reference
    streams: Streams
    first_frame: int
    frames: int
    typical_e: float = 0.0  # signal of most pixels; a hint for the choice of the kernel, without effect on any number


@dataclass(frozen=True, slots=True)
class Neighbours:
    """For crosstalk: which neighbours exist (bits over `DISPLACEMENTS`), and the row length of the flat pixel order."""

    bits: Any
    stride: int


def digitise(
    types: Any,
    expected: Any,
    *,
    maps: PixelMaps,
    neighbours: Neighbours | None,
    detector: Detector,
    exposure: Exposure,
    deposit: Any = None,
) -> NDArray[np.uint32]:
    """Read all pixels out in all frames."""
    # expected (n,), deposit (frames n,) [e-] -> (frames, n)
    size = dr.width(expected)
    step = max(1, _FRAME_AXIS_LIMIT // max(size, 1))
    numbers = _numbers(types, detector, exposure)
    parts = []
    for start in range(0, exposure.frames, step):
        count = min(step, exposure.frames - start)
        keys = _keys(types, exposure, start, count, size)
        part = deposit
        if deposit is not None and count < exposure.frames:
            part = dr.gather(types.Float32, deposit, dr.arange(types.UInt32, count * size) + start * size)
        packed = _read(types, expected, part, maps=maps, neighbours=neighbours, numbers=numbers, keys=keys)
        parts.append(np.asarray(packed).reshape(count, size))
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _numbers(types: Any, detector: Detector, exposure: Exposure) -> dict[str, Any]:
    """Everything a kernel needs of detector and exposure, read from memory: another value is not another kernel."""
    values = {
        "signal_factor": exposure.signal_factor,
        "background_e": exposure.background_e,
        "dark_factor_s": exposure.dark_factor_s,
        "full_well_e": detector.full_well_e,
        "per_full_well": 1.0 / detector.full_well_e,
        "gain": detector.gain_dn_per_e,
        "largest": float(detector.largest_dn),
        "horizontal": detector.crosstalk_horizontal,
        "vertical": detector.crosstalk_vertical,
        "diagonal": detector.crosstalk_diagonal,
    }
    numbers: dict[str, Any] = {name: dr.opaque(types.Float32, value) for name, value in values.items()}
    level = exposure.typical_e + exposure.background_e + detector.dark_current_e_per_s * exposure.dark_factor_s
    numbers["dark"] = level < INVERSION_LIMIT / 2.0
    numbers["nonlinearity"] = [dr.opaque(types.Float32, value) for value in detector.nonlinearity]
    return numbers


def _keys(types: Any, exposure: Exposure, start: int, count: int, size: int) -> dict[str, Any]:
    """Stream keys per pixel of ``count`` frames, and which of the ``size`` pixels each entry is (None: itself)."""
    first = exposure.first_frame + start
    if count == 1:
        scalars = {name: split_key(types, exposure.streams.key(name, first)) for name in ("photon", "read noise")}
        return {**scalars, "of": None}
    index = dr.arange(types.UInt32, count * size)
    frame = index // dr.opaque(types.UInt32, size)
    keys: dict[str, Any] = {"of": index - frame * dr.opaque(types.UInt32, size)}
    for name in ("photon", "read noise"):
        table = [exposure.streams.key(name, first + i) for i in range(count)]
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
    of = keys["of"]
    if of is not None:
        expected = dr.gather(types.Float32, expected, of)
        maps = PixelMaps(*(dr.gather(type(value), value, of) for value in maps))
    # PRNU on all light, then one Poisson variate for light and dark current together: a sum of Poisson variates is one
    light = expected * numbers["signal_factor"] + numbers["background_e"]
    mean = maps.response * light + maps.dark_rate * numbers["dark_factor_s"]
    charge = types.Float32(poisson(types, mean, maps.pixel, keys["photon"], mostly_small=numbers["dark"]))
    if deposit is not None:  # cosmic rays; gaps and dead pixels collect nothing
        charge = charge + dr.select(maps.response > 0.0, deposit, 0.0)
    charge = dr.minimum(charge, numbers["full_well_e"])
    if neighbours is not None:
        dr.eval(charge)  # neighbours are read from memory: the only place where the chain is cut in two kernels
    saturated = charge >= numbers["full_well_e"]  # before crosstalk takes some of it away
    if neighbours is not None:
        charge = _crosstalk(types, charge, neighbours, numbers, of)
    # read noise, gain with non-linearity, offset
    signal = charge + maps.read_noise * normal(types, maps.pixel, keys["read noise"])
    fraction = signal * numbers["per_full_well"]
    bend = types.Float32(0.0)
    for coefficient in reversed(numbers["nonlinearity"]):
        bend = (bend + coefficient) * fraction
    level = numbers["gain"] * signal * (1.0 + bend) + maps.offset
    # round half to even, then the ends of the converter
    number = dr.minimum(dr.maximum(dr.round(level), 0.0), numbers["largest"])
    saturated = saturated | (number >= numbers["largest"])
    return types.UInt32(number) | dr.select(saturated, types.UInt32(1 << 16), types.UInt32(0))


def _crosstalk(types: Any, charge: Any, neighbours: Neighbours, numbers: dict[str, Any], of: Any) -> Any:
    """Each pair of neighbours exchanges a fixed share of its difference: charge is conserved up to the last edge."""
    here = dr.arange(types.UInt32, dr.width(charge))
    bits = neighbours.bits if of is None else dr.gather(types.UInt32, neighbours.bits, of)
    stride = dr.opaque(types.Int32, neighbours.stride)
    mixed = charge  # not "+=" below: that would write into the charge that is read
    for bit, (dx, dy) in enumerate(DISPLACEMENTS):
        share = numbers["diagonal"] if dx and dy else numbers["horizontal"] if dx else numbers["vertical"]
        exists = (bits & (1 << bit)) != 0
        there = types.UInt32(types.Int32(here) + dx + dy * stride)
        mixed = mixed + dr.select(exists, share * (dr.gather(types.Float32, charge, there, exists) - charge), 0.0)
    return mixed
