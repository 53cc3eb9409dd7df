"""Manufacturing tolerances of a lens: the perturbations of its elements, and lenses that are drawn from them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from optics.arrays import FloatArray
from optics.lens.perturb import change_index, change_shape, decentre, despace, tilt
from optics.lens.system import AMBIENT, LensSystem

Perturbation = Callable[[LensSystem, float], LensSystem]
"""A lens, and a number of standard deviations, to the perturbed lens."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerances:
    """Standard deviations; 0: exact."""

    decentre_mm: float = 0.0  # Of every element, per axis
    tilt_deg: float = 0.0  # Of every element, per axis
    wedge_deg: float = 0.0  # Tilt of the last surface of every glass element, per axis
    thickness_mm: float = 0.0  # Of every element; all surfaces behind move with it
    radius_fraction: float = 0.0  # Of every curved surface, relative
    index: float = 0.0  # Of every glass, the same at all wavelengths


def perturbations(lens: LensSystem, tolerances: Tolerances) -> dict[str, Perturbation]:
    """Perturbations of all elements and surfaces by name, such as ``decentre x of L1``."""
    return dict(_perturbations(lens, tolerances))


def perturbed(lens: LensSystem, moves: Mapping[str, Perturbation], amounts: FloatArray) -> LensSystem:
    """The lens with every perturbation made by its number of standard deviations (p,)."""
    for move, amount in zip(moves.values(), amounts, strict=True):
        lens = move(lens, float(amount))
    return lens


def draw_amounts(rng: np.random.Generator, lenses: int, count: int, *, uniform: bool = False) -> FloatArray:
    """Numbers of standard deviations (lenses, count): normal, or uniform within sqrt(3)."""
    shape = lenses, count
    return rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), shape) if uniform else rng.standard_normal(shape)


def _moved(move: Callable[..., LensSystem], what: Any, key: str, sigma: float) -> Perturbation:
    return lambda lens, number: move(lens, what, **{key: number * sigma})


def _perturbations(lens: LensSystem, sigma: Tolerances) -> Iterator[tuple[str, Perturbation]]:
    for name in lens.elements:
        surfaces = lens.indices_of(name)
        last = surfaces[-1]
        glass = tuple(i for i in surfaces if lens.surfaces[i].medium != AMBIENT and not lens.surfaces[i].mirror)
        for axis in "xy":
            if sigma.decentre_mm:
                yield f"decentre {axis} of {name}", _moved(decentre, name, f"{axis}_mm", sigma.decentre_mm)
            if sigma.tilt_deg:
                yield f"tilt {axis} of {name}", _moved(tilt, name, f"{axis}_deg", sigma.tilt_deg)
            if sigma.wedge_deg and glass:
                yield f"wedge {axis} of {name}", _moved(tilt, last, f"{axis}_deg", sigma.wedge_deg)
        if sigma.thickness_mm:
            yield f"thickness of {name}", _moved(partial(despace, following=True), last, "z_mm", sigma.thickness_mm)
        if sigma.index and glass:
            yield f"index of {name}", _moved(change_index, glass, "by", sigma.index)
        for i in surfaces if sigma.radius_fraction else ():
            radius = getattr(lens.surfaces[i].shape, "radius_mm", np.inf)
            if np.isfinite(radius) and radius:
                change = partial(change_shape, name="radius_mm")
                yield f"radius of {lens.label(i)}", _moved(change, i, "by", radius * sigma.radius_fraction)
