"""Perturbations: each returns a new lens.

What moves is named by ``what``: an element's name, the index of a surface, a sequence of indices, `ALL_SURFACES` (the
lens against its detector) or `EVERYTHING` (surfaces and image plane). What is not named stays where it is, except where
a function says so. Rotations are rotation vectors in the lens frame [deg], so that opposite ones cancel exactly; poses
add up in the lens frame, in the order of the calls. The numbers of a shape are those of the surface as light meets it:
behind an odd number of mirrors radii have the opposite sign of those in the lens file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.glass.media import Environment
from optics.lens.system import AMBIENT, LensSystem, Surface

__all__ = [
    "ALL_SURFACES",
    "EVERYTHING",
    "change_index",
    "change_shape",
    "change_temperature",
    "decentre",
    "despace",
    "refocus",
    "tilt",
    "tilt_image",
]

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
        raise ConfigError(f"no surface of lens {lens.name!r} is named")
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
    """Add to one of the numbers that make the shape of a surface.

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
    """Add to the refractive index of the glass (all glasses) of what is named, at every wavelength alike.

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


def _expansion(lens: LensSystem, medium: str) -> float:
    cte = lens.glasses[medium].cte_per_k
    if cte is None:
        raise DomainError(
            f"glass {medium} in lens {lens.name!r} has no expansion coefficient; give cte_per_k in the lens file"
        )
    return cte


def _warmed_surface(lens: LensSystem, index: int, vertex: FloatArray, kelvin: float, housing: float) -> Surface:
    """Surface at its new vertex, its shape expanded with the glass or the mirror it belongs to."""
    surface = lens.surfaces[index]
    before = lens.surfaces[index - 1].medium if index else AMBIENT
    ctes = [_expansion(lens, m) for m in (before, surface.medium) if m != AMBIENT]
    if surface.cte_per_k is not None:
        ctes = [surface.cte_per_k]
    shape_cte = sum(ctes) / len(ctes) if ctes else housing
    growth = math.exp(shape_cte * kelvin)
    return replace(
        surface,
        shape=surface.shape.scaled(growth),
        position_mm=vertex,
        semi_diameter_mm=surface.semi_diameter_mm * growth,
        inner_semi_diameter_mm=surface.inner_semi_diameter_mm * growth,
        apertures=tuple(aperture.scaled(growth) for aperture in surface.apertures),
        error=None if surface.error is None else surface.error.scaled(growth),
    )


def change_temperature(
    lens: LensSystem, temperature_c: float, *, housing_cte_per_k: float, pressure_hpa: float | None = None
) -> LensSystem:
    """Bring the whole lens to another uniform temperature; its dimensions are taken to hold at its present one.

    Glass: index by the maker's dn/dT, radii and centre thicknesses by its expansion (a cemented surface takes the mean
    of the two glasses). A mirror takes the expansion of its substrate (``Surface.cte_per_k``), or that of the housing.
    Air gaps, stop and the distance to the image plane follow the housing, along the axis: that spacers touch the lenses
    at the rim, at another z than the vertex, is left out. Shifts across the axis follow the housing. A length L becomes
    L exp(cte dT), so going back cancels exactly.

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
    lens.check_surfaces()
    _finite("expansion of the housing [1/K]", housing_cte_per_k)
    environment = Environment(
        temperature_c=temperature_c,
        pressure_hpa=lens.environment.pressure_hpa if pressure_hpa is None else pressure_hpa,
    )
    kelvin = temperature_c - lens.environment.temperature_c
    old, growth = [position for position, _ in lens.poses], math.exp(housing_cte_per_k * kelvin)
    new = [old[0] * growth]
    for surface, start, end, axis in zip(lens.surfaces, old[:-1], old[1:], lens.axis[1:], strict=True):
        cte = housing_cte_per_k if surface.medium == AMBIENT else _expansion(lens, surface.medium)
        along = ((end - start) @ axis) * axis
        new.append(new[-1] + along * math.exp(cte * kelvin) + (end - start - along) * growth)
    surfaces = tuple(_warmed_surface(lens, i, new[i], kelvin, housing_cte_per_k) for i in range(len(lens.surfaces)))
    warmed = replace(lens, surfaces=surfaces, image_position_mm=new[-1], environment=environment)
    warmed.indices(lens.design_wavelength_nm)  # refuses glasses without dn/dT now, not at the first trace
    return warmed
