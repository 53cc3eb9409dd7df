"""Perturbations of a lens; each function returns a new lens and leaves the given one as it is.

``what`` selects the moving part: the name of an element, the index of a surface, a sequence of indices, `ALL_SURFACES`
(the lens relative to its detector) or `EVERYTHING` (surfaces and image plane). All other parts stay, unless the
function states otherwise. Rotations are rotation vectors in the lens frame [deg], so that opposite rotations cancel
exactly; poses add up in the lens frame, in the order of the calls. Shape parameters are those seen by the light: behind
an odd number of mirrors radii have the opposite sign of the lens file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.glass.absolute_index import Environment
from optics.lens.heated_lens import Housing, ThermalState, heated_lens
from optics.lens.system import AMBIENT, LensSystem

What = str | int | Sequence[int]

ALL_SURFACES = "@surfaces"
EVERYTHING = "@everything"


def _selected(lens: LensSystem, what: What) -> tuple[tuple[int, ...], bool]:
    """Indices of the surfaces that move, and whether the image plane does."""
    lens.check_surfaces()
    if isinstance(what, str):
        if what in (ALL_SURFACES, EVERYTHING):
            return tuple(range(len(lens.surfaces))), what == EVERYTHING
        return lens.indices_of(what), False
    indices = (what,) if isinstance(what, int) else tuple(what)
    for index in indices:
        if not 0 <= index < len(lens.surfaces):
            last = len(lens.surfaces) - 1
            raise ConfigError(
                f"index {index}; lens {lens.name!r} has surfaces 0 ... {last}: {lens.label(0)} to {lens.label(last)} "
                "of its file"
            )
    if not indices:
        raise ConfigError(f"lens {lens.name!r}: no surface is named; at least one is needed")
    return tuple(sorted(set(indices))), False


def _finite(what: str, *values: float) -> None:
    if not all(math.isfinite(v) for v in values):
        raise DomainError(f"{what} {values}; finite numbers are needed")


def _moved(lens: LensSystem, what: What, rotation: FloatArray, pivot: FloatArray, shift: FloatArray) -> LensSystem:
    """Rigid motion x -> rotation (x - pivot) + pivot + shift of the named surfaces (and image plane)."""
    indices, image = _selected(lens, what)

    def place(position: FloatArray) -> FloatArray:
        return np.asarray(rotation @ (position - pivot) + pivot + shift)

    changed = {
        i: replace(
            lens.surfaces[i],
            position_mm=place(lens.surfaces[i].position_mm),
            rotation=rotation @ lens.surfaces[i].rotation,
        )
        for i in indices
    }
    moved = lens.with_surfaces(changed)
    if image:
        moved = replace(
            moved,
            image_position_mm=place(lens.image_position_mm),
            image_rotation=rotation @ lens.image_rotation,
        )
    return moved


def decentre(lens: LensSystem, what: What, x_mm: float = 0.0, y_mm: float = 0.0) -> LensSystem:
    """Shift across the axis.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    what : str, int or sequence of int
        See the module.
    x_mm, y_mm : float
        Shift in the lens frame [mm].

    Returns
    -------
    LensSystem
        A new lens.
    """
    _finite("decentre [mm]", x_mm, y_mm)
    return _moved(lens, what, np.eye(3), np.zeros(3), np.array([x_mm, y_mm, 0.0]))


def tilt(
    lens: LensSystem, what: What, x_deg: float = 0.0, y_deg: float = 0.0, *, pivot_mm: Sequence[float] | None = None
) -> LensSystem:
    """Rotate as one rigid body.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    what : str, int or sequence of int
        See the module.
    x_deg, y_deg : float
        Rotation vector about the axes of the lens frame [deg].
    pivot_mm : (3,), optional
        Point that stays; the vertex of the first named surface if left out.

    Returns
    -------
    LensSystem
        A new lens.
    """
    _finite("tilt [deg]", x_deg, y_deg)
    first = lens.surfaces[_selected(lens, what)[0][0]].position_mm
    pivot = np.array(first if pivot_mm is None else pivot_mm, float)
    if pivot.shape != (3,) or not np.all(np.isfinite(pivot)):
        raise DomainError(f"pivot_mm = {pivot_mm}; three finite numbers are needed")
    rotation = Rotation.from_rotvec([x_deg, y_deg, 0.0], degrees=True).as_matrix()
    return _moved(lens, what, rotation, pivot, np.zeros(3))


def despace(lens: LensSystem, what: What, z_mm: float, *, following: bool = False) -> LensSystem:
    """Shift along the axis.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    what : str, int or sequence of int
        See the module.
    z_mm : float
        Shift [mm].
    following : bool
        False: the gap before grows and the gap after shrinks. True: all later surfaces and the image plane move too (a
        thicker spacer in front of the named surfaces).

    Returns
    -------
    LensSystem
        A new lens.
    """
    _finite("despace [mm]", z_mm)
    shift = np.array([0.0, 0.0, z_mm])
    indices, image = _selected(lens, what)
    if following:
        indices, image = tuple(range(indices[0], len(lens.surfaces))), True
    moved = _moved(lens, indices, np.eye(3), np.zeros(3), shift)
    return replace(moved, image_position_mm=lens.image_position_mm + shift) if image else moved


def change_shape(lens: LensSystem, surface: int, name: str, by: float) -> LensSystem:
    """Add to a shape parameter of a surface.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    surface : int
        Index of the surface.
    name : str
        Field of its shape, e.g. ``"radius_mm"``.
    by : float
        What is added, in the unit of the field.

    Returns
    -------
    LensSystem
        A new lens.

    Raises
    ------
    DomainError
        If the shape has no such number, or the result is not a surface.
    """
    _finite(f"change of {name}", by)
    (index,), _ = _selected(lens, surface)
    try:
        shape = lens.surfaces[index].shape.changed(name, by)
    except DomainError as error:
        raise DomainError(f"{lens.label(index)} of lens {lens.name!r}: {error}") from None
    return lens.with_surfaces({index: replace(lens.surfaces[index], shape=shape)})


def change_index(lens: LensSystem, what: What, by: float) -> LensSystem:
    """Add a constant to the refractive index of the named glasses at all wavelengths.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    what : str, int or sequence of int
        See the module.
    by : float
        What is added.

    Returns
    -------
    LensSystem
        A new lens.

    Raises
    ------
    DomainError
        If nothing named is followed by glass.
    """
    _finite("index change", by)
    changed = {
        i: replace(lens.surfaces[i], index_offset=lens.surfaces[i].index_offset + by)
        for i in _selected(lens, what)[0]
        if lens.surfaces[i].medium != AMBIENT
    }
    for i, surface in enumerate(lens.surfaces):  # light goes back into the glass in front of a mirror
        if surface.mirror and i - 1 in changed and surface.medium != AMBIENT:
            changed[i] = replace(surface, index_offset=changed[i - 1].index_offset)
    if not changed:
        raise DomainError(f"lens {lens.name!r}: no glass follows {what!r}; name the surface in front of the glass")
    return lens.with_surfaces(changed)


def refocus(lens: LensSystem, z_mm: float) -> LensSystem:
    """Shift the image plane along its own normal; positive: away from the lens.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    z_mm : float
        Shift [mm].

    Returns
    -------
    LensSystem
        A new lens.
    """
    _finite("focus shift [mm]", z_mm)
    return replace(lens, image_position_mm=lens.image_position_mm + z_mm * lens.image_rotation[:, 2])


def tilt_image(lens: LensSystem, x_deg: float = 0.0, y_deg: float = 0.0) -> LensSystem:
    """Rotate the image plane about its own origin; rotation vector about the axes of the lens frame [deg].

    Parameters
    ----------
    lens : LensSystem
        The lens.
    x_deg, y_deg : float
        Rotation vector [deg].

    Returns
    -------
    LensSystem
        A new lens.
    """
    _finite("image tilt [deg]", x_deg, y_deg)
    rotation = Rotation.from_rotvec([x_deg, y_deg, 0.0], degrees=True).as_matrix()
    return replace(lens, image_rotation=rotation @ lens.image_rotation)


def change_temperature(
    lens: LensSystem, temperature_c: float, *, housing_cte_per_k: float, pressure_hpa: float | None = None
) -> LensSystem:
    """Lens at another uniform temperature; its dimensions hold at the present one.

    `optics.lens.heated_lens.heated_lens` without gradients, its spacers measured from vertex to vertex.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    temperature_c : float
        New temperature [C].
    housing_cte_per_k : float
        Linear expansion of the housing [1/K], e.g. 23.6e-6 aluminium 6061, 8.6e-6 titanium Ti-6Al-4V.
    pressure_hpa : float, optional
        New air pressure; unchanged if left out.

    Returns
    -------
    LensSystem
        A new lens.

    Raises
    ------
    DomainError
        If a glass has no expansion or dn/dT data, or the temperature is out of range.
    """
    _finite("expansion of the housing [1/K]", housing_cte_per_k)
    new = Environment(temperature_c=temperature_c)
    state = ThermalState(mean_k=new.temperature_c - lens.environment.temperature_c)
    return heated_lens(lens, state, Housing(expansion_per_k=housing_cte_per_k), pressure_hpa=pressure_hpa)
