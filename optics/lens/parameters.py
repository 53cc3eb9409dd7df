"""The numbers of a lens as arrays for optimisers, and the lens built from changed arrays.

Arrays have a row per surface. A number that a surface does not have (the curvature of a plane, the conic constant of a
sphere) is 0 and cannot be changed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.perturb import change_index, change_temperature, decentre, tilt
from optics.lens.system import AMBIENT, LensSystem

LENS_PARAMETERS = {
    "curvature_per_mm": "(s,) vertex curvatures [1/mm]",
    "conic": "(s,) conic constants",
    "asphere": "(s, m) coefficients of aspheres, in the units of their shapes",
    "thickness_mm": "(s,) distance along the axis to the next surface, or to the image plane [mm]",
    "decentre_mm": "(s, 2) shift of a surface across the axis, lens frame [mm]",
    "tilt_deg": "(s, 2) rotation of a surface about its own vertex, lens frame [deg]",
    "index_offset": "(s,) added to the refractive index of the glass behind a surface, at every wavelength alike",
    "temperature_c": "(1,) temperature of the whole lens [C]",
}


def _has(lens: LensSystem, name: str) -> list[bool]:
    """Mask of the surfaces that have a field."""
    return [hasattr(surface.shape, name) for surface in lens.surfaces]


def lens_parameters(lens: LensSystem) -> dict[str, FloatArray]:
    """Values of `LENS_PARAMETERS`; decentre and tilt are relative to the present lens."""
    count = len(lens.surfaces)
    aspheres = [tuple(getattr(surface.shape, "asphere", ())) for surface in lens.surfaces]
    most = max(len(terms) for terms in aspheres)
    position = [*(surface.position_mm for surface in lens.surfaces), lens.image_position_mm]
    along = lens.axis[1:]
    return {
        "curvature_per_mm": np.array(
            [s.shape.curvature if has else 0.0 for s, has in zip(lens.surfaces, _has(lens, "radius_mm"), strict=True)]
        ),
        "conic": np.array([float(getattr(surface.shape, "conic", 0.0)) for surface in lens.surfaces]),
        "asphere": np.array([(*terms, *[0.0] * (most - len(terms))) for terms in aspheres]).reshape(count, most),
        "thickness_mm": np.array([float((position[i + 1] - position[i]) @ along[i]) for i in range(count)]),
        "decentre_mm": np.zeros((count, 2)),
        "tilt_deg": np.zeros((count, 2)),
        "index_offset": np.array([surface.index_offset for surface in lens.surfaces]),
        "temperature_c": np.array([lens.environment.temperature_c]),
    }


def steps_of(values: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Steps of the numbers for finite-difference derivatives of the compiled lens."""
    relative, least = (
        {"curvature_per_mm": 1e-3, "asphere": 1e-3},
        {"curvature_per_mm": 1e-8, "asphere": 1e-20, "tilt_deg": 1e-2, "index_offset": 1e-4, "temperature_c": 0.1},
    )
    return {name: np.maximum(np.abs(v) * relative.get(name, 0.0), least.get(name, 1e-3)) for name, v in values.items()}


def with_parameters(
    lens: LensSystem, values: Mapping[str, FloatArray], *, housing_cte_per_k: float = 23.6e-6
) -> LensSystem:
    """A lens with other numbers."""
    before = lens_parameters(lens)
    for name, value in values.items():
        if np.shape(value) != before[name].shape:
            raise DomainError(f"{name} has shape {np.shape(value)}; {before[name].shape} is needed")
    change = {name: np.asarray(values[name], float) - before[name] for name in before if name in values}
    for name, by in change.items():
        for index in np.argwhere(by):
            lens = CHANGES[name](lens, tuple(int(i) for i in index), np.asarray(values[name], float), by)
    kelvin = change.get("temperature_c", np.zeros(1))[0]
    if kelvin:
        lens = change_temperature(lens, float(before["temperature_c"][0] + kelvin), housing_cte_per_k=housing_cte_per_k)
    return lens


Change = Callable[[LensSystem, tuple[int, ...], FloatArray, FloatArray], LensSystem]


def _shape(lens: LensSystem, surface: int, name: str, value: object) -> LensSystem:
    """The lens with one number of a surface's shape replaced."""
    current = lens.surfaces[surface]
    if not hasattr(current.shape, name):
        number = "curvature" if name == "radius_mm" else name
        raise DomainError(f"{lens.label(surface)} of lens {lens.name!r} is a {current.shape.kind}; it has no {number}")
    return lens.with_surfaces({surface: replace(current, shape=replace(current.shape, **{name: value}))})


def _curvature(lens: LensSystem, at: tuple[int, ...], values: FloatArray, by: FloatArray) -> LensSystem:
    return _shape(lens, at[0], "radius_mm", float(1.0 / values[at]) if values[at] else np.inf)


def _conic(lens: LensSystem, at: tuple[int, ...], values: FloatArray, by: FloatArray) -> LensSystem:
    return _shape(lens, at[0], "conic", float(values[at]))


def _asphere(lens: LensSystem, at: tuple[int, ...], values: FloatArray, by: FloatArray) -> LensSystem:
    terms = list(getattr(lens.surfaces[at[0]].shape, "asphere", ()))
    if at[1] >= len(terms):
        raise DomainError(f"{lens.label(at[0])} of lens {lens.name!r} has no coefficient {at[1]} of an asphere")
    terms[at[1]] = float(values[at])
    return _shape(lens, at[0], "asphere", tuple(terms))


def _thickness(lens: LensSystem, at: tuple[int, ...], values: FloatArray, by: FloatArray) -> LensSystem:
    shift = float(by[at]) * lens.axis[at[0] + 1]
    behind = {
        i: replace(surface, position_mm=surface.position_mm + shift)
        for i, surface in enumerate(lens.surfaces)
        if i > at[0]
    }
    return replace(lens.with_surfaces(behind), image_position_mm=lens.image_position_mm + shift)


def _decentre(lens: LensSystem, at: tuple[int, ...], values: FloatArray, by: FloatArray) -> LensSystem:
    x_mm, y_mm = np.eye(2)[at[1]] * by[at]
    return decentre(lens, at[0], float(x_mm), float(y_mm))


def _tilt(lens: LensSystem, at: tuple[int, ...], values: FloatArray, by: FloatArray) -> LensSystem:
    before = lens.surfaces[at[0] - 1].medium if at[0] else AMBIENT
    surface = lens.surfaces[at[0]]
    if surface.is_stop and surface.medium == before and not surface.mirror:
        raise DomainError(f"{lens.label(at[0])} of lens {lens.name!r} is a separate stop; it cannot be tilted")
    x_deg, y_deg = np.eye(2)[at[1]] * by[at]
    return tilt(lens, at[0], float(x_deg), float(y_deg))


def _index(lens: LensSystem, at: tuple[int, ...], values: FloatArray, by: FloatArray) -> LensSystem:
    same = [at[0]]  # a stop within the glass has the same behind it
    for i in range(at[0] + 1, len(lens.surfaces)):
        if lens.surfaces[i].mirror or lens.media[i + 1] != lens.media[at[0] + 1]:
            break
        same.append(i)
    return change_index(lens, same, float(by[at]))


CHANGES: dict[str, Change] = {
    "curvature_per_mm": _curvature,
    "conic": _conic,
    "asphere": _asphere,
    "thickness_mm": _thickness,
    "decentre_mm": _decentre,
    "tilt_deg": _tilt,
    "index_offset": _index,
    "temperature_c": lambda lens, at, values, by: lens,
}
"""How a number of a surface is changed; the temperature comes last, on its own."""
