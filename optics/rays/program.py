"""A lens compiled for tracing: a structure (sequence of steps) and one flat vector of numbers.

Lenses of the same structure (a perturbed copy, another temperature) differ only in the vector. A just-in-time compiled
trace is therefore compiled once for all of them, and the gradient with respect to the prescription is one vector.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from optics.arrays import FloatArray
from optics.glass.absolute_index import IndexFormula, index_parameters
from optics.lens.apertures import Aperture
from optics.lens.sag_map import SagMap
from optics.lens.shapes.base import Shape
from optics.lens.shapes.plane import Plane
from optics.lens.system import AMBIENT, LensSystem
from optics.records import locked


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceStep:
    """One surface in the trace; ``*_at`` are offsets into the parameter vector."""

    shape: type[Shape]  # Shape class whose ``intersect`` is called
    shape_at: int  # Its parameters
    shape_size: int
    shift_at: int  # Three numbers: the previous vertex in this frame, added after the rotation
    lateral: bool  # Whether the shift has x and y components
    # Nine numbers (row-major) that turn the previous frame into this one; -1 when the axes are parallel
    rotation_at: int
    aperture_at: int  # Squared outer and inner radius; -1 without a clear aperture
    annular: bool  # Whether there is an inner radius
    before: int  # Numbers of the media; equal for a surface that does not refract
    after: int
    mirror: bool = False  # Whether it reflects
    # (type, int, int, bool) Class of every further aperture, its parameters (offset, number), and whether it obscures
    outlines: tuple[tuple[type[Aperture], int, int, bool], ...] = ()
    error: SagMap | None = None  # Deviation that is added to the sag


@dataclass(frozen=True, slots=True, kw_only=True)
class LensProgram:
    """Structure of a compiled lens; hashable, so that kernels can be cached by it."""

    steps: tuple[SurfaceStep, ...]
    media: tuple[IndexFormula, ...]
    size: int


class _Vector:
    """Parameter vector under construction."""

    def __init__(self) -> None:
        self.values: list[float] = []

    def add(self, numbers: Iterable[float]) -> int:
        """Append numbers; returns the offset of the first."""
        offset = len(self.values)
        self.values.extend(float(number) for number in numbers)
        return offset


def _media(lens: LensSystem, vector: _Vector, general: bool) -> tuple[list[IndexFormula], list[int]]:
    """Index formulas of the media (one for each distinct medium, or in general for the glass behind every surface), and
    for each surface the number of the medium that follows it."""
    formulas: list[IndexFormula] = []
    medium_of: list[int] = []
    numbers: dict[object, int] = {}
    for i, (name, offset) in enumerate(lens.media):
        glass = None if name == AMBIENT else lens.glasses[name]
        if general and i and lens.surfaces[i - 1].mirror:
            medium_of.append(medium_of[-1])
            continue
        key = (name, offset, i if general and glass is not None else 0)
        if key not in numbers:
            parameters, form, thermal = index_parameters(glass, lens.environment, offset)
            numbers[key] = len(formulas)
            formulas.append(IndexFormula(at=vector.add(parameters), form=form, thermal=thermal))
        medium_of.append(numbers[key])
    return formulas, medium_of


def _outline(aperture: Aperture, vector: _Vector) -> tuple[type[Aperture], int, int, bool]:
    """An aperture as `SurfaceStep.outlines` holds it."""
    parameters = aperture.parameters()
    return type(aperture), vector.add(parameters), len(parameters), aperture.obscures


def compile_lens(lens: LensSystem, *, general: bool = False) -> tuple[LensProgram, FloatArray]:
    """Structure and parameter vector of a lens; the image plane is the last step.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    general : bool
        Keep every pose general even if it is centred, and one glass per surface, so that all perturbations of the lens
        have the same structure.

    Returns
    -------
    program : LensProgram
        The structure.
    theta : (size,)
        The numbers [mm, 1/mm, 1].
    """
    lens.check_surfaces()
    vector = _Vector()
    media, medium_of = _media(lens, vector, general)
    steps = []
    position, rotation = np.zeros(3), np.eye(3)
    for i, (new_position, new_rotation) in enumerate(lens.poses):
        surface = lens.surfaces[i] if i < len(lens.surfaces) else None
        shift = new_rotation.T @ (position - new_position)
        rotated = general or not np.array_equal(new_rotation, rotation)
        shape: Shape = Plane() if surface is None else surface.shape
        limited = surface is not None and (np.isfinite(surface.semi_diameter_mm) or surface.inner_semi_diameter_mm > 0)
        steps.append(
            SurfaceStep(
                shape=type(shape),
                shape_at=vector.add(shape.parameters()),
                shape_size=len(shape.parameters()),
                shift_at=vector.add(shift),
                lateral=general or bool(np.any(shift[:2] != 0.0)),
                rotation_at=vector.add((new_rotation.T @ rotation).ravel()) if rotated else -1,
                aperture_at=vector.add([surface.semi_diameter_mm**2, surface.inner_semi_diameter_mm**2])
                if limited and surface is not None
                else -1,
                annular=surface is not None and surface.inner_semi_diameter_mm > 0,
                before=medium_of[min(i, len(lens.surfaces))],
                after=medium_of[min(i + 1, len(lens.surfaces))],
                mirror=surface is not None and surface.mirror,
                outlines=tuple(_outline(aperture, vector) for aperture in surface.apertures) if surface else (),
                error=surface.error if surface else None,
            )
        )
        position, rotation = new_position, new_rotation
    theta = locked(vector.values)
    return LensProgram(steps=tuple(steps), media=tuple(media), size=len(theta)), theta
