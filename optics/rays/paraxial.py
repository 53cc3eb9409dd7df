r"""Paraxial (Gaussian) optics by ABCD matrices; independent of the code of the ray trace.

A ray is :math:`(y, \nu)` with :math:`\nu = n u`. Refraction: :math:`\nu' = \nu - (n' - n) c\, y`; transfer over a
distance t: :math:`y' = y + (t / n) \nu` (Kloos 2007, *Matrix Methods for Optical Layout*, SPIE TT77). With the matrix
[[A, B], [C, D]] from the first to the last refracting vertex and the index n of the surroundings: f = -n/C, back focus
-n A/C, front focus n D/C.

Indices are absolute: the focal length is that in the surrounding air or vacuum. Distances are unfolded, counted along
the light through all mirrors (`LensSystem.axis`); a mirror of curvature c has the power -2 n c.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.system import LensSystem
from optics.units import DEG_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class ParaxialLens:
    """First-order quantities at one wavelength; ``*_z_mm`` are positions in the lens frame."""

    wavelength_nm: float  # Wavelength [nm]
    efl_mm: float  # Effective focal length (rear principal plane to rear focus)
    bfl_mm: float  # From the last refracting vertex to the rear focus
    ffl_mm: float  # From the first refracting vertex to the front focus (usually negative)
    front_focus_z_mm: float  # Cardinal planes
    rear_focus_z_mm: float
    front_principal_z_mm: float
    rear_principal_z_mm: float
    entrance_pupil_z_mm: float  # Images of the stop; infinite for a telecentric lens
    entrance_pupil_radius_mm: float
    exit_pupil_z_mm: float
    exit_pupil_radius_mm: float
    f_number: float  # efl / (2 entrance pupil radius)


def _require_centred(lens: LensSystem) -> None:
    axis = lens.axis
    for i, (position, rotation) in enumerate(lens.poses):
        if np.any(position[:2] != 0.0) or not np.array_equal(rotation[:, 2], axis[i]) or np.any(axis[i][:2] != 0.0):
            raise DomainError(
                f"lens {lens.name!r}: {lens.label(i)} is tilted or decentred; paraxial quantities exist for centred "
                "lenses only"
            )
    for i, surface in enumerate(lens.surfaces):
        if not surface.shape.rotational:
            raise DomainError(
                f"lens {lens.name!r}: {lens.label(i)} ({surface.shape.kind}) is not a surface of revolution; paraxial "
                "quantities exist for surfaces of revolution only"
            )


def _power(lens: LensSystem, n: FloatArray, i: int) -> float:
    """Power of a surface [1/mm]."""
    surface = lens.surfaces[i]
    return surface.shape.power(n[i], -n[i] if surface.mirror else n[i + 1], n[0])


def _distance(lens: LensSystem, i: int, at: FloatArray) -> float:
    """Distance along the axis from a point on it to the vertex of surface i (or to the image plane)."""
    return float((lens.poses[i][0] - at) @ lens.axis[i])


def _transfer(distance: float, index: float) -> FloatArray:
    return np.array([[1.0, distance / index], [0.0, 1.0]])


def _through(
    lens: LensSystem, n: FloatArray, start: FloatArray, first: int, last: int
) -> tuple[FloatArray, FloatArray]:
    """Matrix from a point of the axis through surfaces ``first`` ... ``last - 1``, and the last vertex."""
    matrix, at, axis = np.eye(2), start, lens.axis
    for i in range(first, last):
        surface = lens.surfaces[i]
        distance = float((surface.position_mm - at) @ axis[i])
        refraction = np.array([[1.0, 0.0], [-_power(lens, n, i), 1.0]])
        matrix, at = refraction @ _transfer(distance, n[i]) @ matrix, surface.position_mm
    return matrix, at


def _refracting(lens: LensSystem, n: FloatArray) -> tuple[int, int]:
    """First and last surface that refract or reflect."""
    powered = [i for i, s in enumerate(lens.surfaces) if n[i] != n[i + 1] or s.mirror or s.shape.redirects]
    if not powered:
        raise DomainError(f"lens {lens.name!r} has no refracting or reflecting surface; it has no focal length")
    return powered[0], powered[-1]


def axial_paraxial(lens: LensSystem, wavelength_nm: float) -> ParaxialLens:
    """As `paraxial`, but tilts and decentres are ignored instead of refused (a starting point for real rays)."""
    n = lens.indices(float(wavelength_nm))
    first, last = _refracting(lens, n)
    start = lens.surfaces[first].position_mm
    (a, _), (c, d) = _through(lens, n, start, first, last + 1)[0]
    if c == 0.0:
        raise DomainError(f"lens {lens.name!r} is afocal at {wavelength_nm:g} nm; it has no focal length")
    n_in, n_out = float(n[0]), float(n[-1])
    efl, bfl, ffl = -n_out / c, -n_out * a / c, n_in * d / c
    stop = lens.surfaces[lens.stop_index]
    before, at = _through(lens, n, start, 0, lens.stop_index)
    before = _transfer(_distance(lens, lens.stop_index, at), float(n[lens.stop_index])) @ before
    after, end = _through(lens, n, stop.position_mm, lens.stop_index, len(lens.surfaces))
    # z of points on the axis in front of the lens, and behind its last surfaces
    z_first, z_last, z_end = (float(point[2]) for point in (start, lens.surfaces[last].position_mm, end))
    along_in, along_out = float(lens.axis[0][2]), float(lens.axis[-1][2])
    with np.errstate(divide="ignore", over="ignore"):
        entrance_z = z_first + along_in * n_in * np.divide(before[0, 1], before[0, 0])
        exit_z = z_end - along_out * n_out * np.divide(after[0, 1], after[1, 1])
        entrance_radius = np.abs(np.divide(stop.semi_diameter_mm, before[0, 0]))
        exit_radius = np.abs(np.divide(stop.semi_diameter_mm, after[1, 1]))
        f_number = np.divide(abs(efl), 2.0 * entrance_radius)
    return ParaxialLens(
        wavelength_nm=float(wavelength_nm),
        efl_mm=float(efl),
        bfl_mm=float(bfl),
        ffl_mm=float(ffl),
        front_focus_z_mm=float(z_first + along_in * ffl),
        rear_focus_z_mm=float(z_last + along_out * bfl),
        front_principal_z_mm=float(z_first + along_in * (ffl + efl * n_in / n_out)),
        rear_principal_z_mm=float(z_last + along_out * (bfl - efl)),
        entrance_pupil_z_mm=float(entrance_z),
        entrance_pupil_radius_mm=float(entrance_radius),
        exit_pupil_z_mm=float(exit_z),
        exit_pupil_radius_mm=float(exit_radius),
        f_number=float(f_number),
    )


def paraxial(lens: LensSystem, wavelength_nm: float | None = None) -> ParaxialLens:
    """First-order quantities of a centred lens.

    Parameters
    ----------
    lens : LensSystem
        A centred lens.
    wavelength_nm : float, optional
        Wavelength; the design wavelength if left out.

    Returns
    -------
    ParaxialLens
        Focal length, principal planes, pupils [mm].

    Raises
    ------
    DomainError
        If the lens is tilted or decentred, afocal, or the wavelength is outside the range of its glasses.
    """
    _require_centred(lens)
    return axial_paraxial(lens, lens.design_wavelength_nm if wavelength_nm is None else wavelength_nm)


def image_of(lens: LensSystem, object_z_mm: float, wavelength_nm: float | None = None) -> tuple[float, float]:
    """Position [mm, lens frame] and transverse magnification of the image of an axial object plane."""
    p = paraxial(lens, wavelength_nm)
    # Newton: x x' = -f f', with f' / f = n' / n, equal here because both sides are the surroundings
    x = object_z_mm - p.front_focus_z_mm
    if x == 0.0:
        raise DomainError(f"object at z = {object_z_mm} mm stands in the front focal plane; its image is at infinity")
    return p.rear_focus_z_mm - float(lens.axis[-1][2]) * p.efl_mm**2 / x, p.efl_mm / x


def chief_ray(lens: LensSystem, field_deg: float, wavelength_nm: float | None = None) -> tuple[FloatArray, FloatArray]:
    """Heights [mm] and slopes (surfaces + 1,) of the paraxial chief ray of a star, in the meridional plane."""
    p = paraxial(lens, wavelength_nm)
    n = lens.indices(p.wavelength_nm)
    slope = float(np.tan(field_deg * DEG_RAD))
    at = lens.surfaces[0].position_mm
    ray = np.array([(float(at[2]) - p.entrance_pupil_z_mm) * slope, n[0] * slope])
    heights, slopes = [], []
    for i, surface in enumerate(lens.surfaces):
        ray = _transfer(_distance(lens, i, at), n[i]) @ ray
        ray[1] -= _power(lens, n, i) * ray[0]
        at = surface.position_mm
        heights.append(ray[0])
        slopes.append(ray[1] / n[i + 1])
    heights.append(heights[-1] + _distance(lens, len(lens.surfaces), at) * slopes[-1])
    return np.array(heights), np.array([*slopes, slopes[-1]])


def focus_behind_mm(lens: LensSystem) -> float:
    """Paraxial focus behind the image plane, along the light, at the design wavelength; also of a perturbed lens."""
    p = axial_paraxial(lens, lens.design_wavelength_nm)
    return float(lens.axis[-1][2]) * (p.rear_focus_z_mm - float(lens.image_position_mm[2]))


def image_scale_mm(lens: LensSystem) -> float:
    """Height of the paraxial chief ray on the detector over the slope of the star, in focus or not.

    Through the rear nodal point a star stays at efl x slope in the focal plane; from there along the chief ray.
    """
    p = axial_paraxial(lens, lens.design_wavelength_nm)
    if not np.isfinite(p.exit_pupil_z_mm):
        return p.efl_mm
    z = float(lens.image_position_mm[2])
    return p.efl_mm * (z - p.exit_pupil_z_mm) / (p.rear_focus_z_mm - p.exit_pupil_z_mm)


def axial_colour_mm(lens: LensSystem, wavelength_nm: ArrayLike, reference_nm: float | None = None) -> FloatArray:
    """Shift of the rear focus [mm] from that of the reference wavelength (default: design wavelength).

    Parameters
    ----------
    lens : LensSystem
        The lens.
    wavelength_nm : array_like
        Wavelengths [nm].
    reference_nm : float, optional
        Reference wavelength.

    Returns
    -------
    array
        Shifts, of the shape of the wavelengths [mm].
    """
    focus = np.vectorize(lambda wave: paraxial(lens, wave).rear_focus_z_mm, otypes=[float])
    return np.asarray(focus(wavelength_nm) - paraxial(lens, reference_nm).rear_focus_z_mm)


def lateral_colour_mm(
    lens: LensSystem, field_deg: float, wavelength_nm: ArrayLike, reference_nm: float | None = None
) -> FloatArray:
    """Chief-ray height in the image plane [mm] against that of the reference wavelength."""
    height = np.vectorize(lambda wave: chief_ray(lens, field_deg, wave)[0][-1], otypes=[float])
    return np.asarray(height(wavelength_nm) - chief_ray(lens, field_deg, reference_nm)[0][-1])


def refocused(lens: LensSystem, wavelength_nm: float | None = None) -> LensSystem:
    """The lens with its image plane moved to the paraxial focus."""
    focus = np.array([0.0, 0.0, paraxial(lens, wavelength_nm).rear_focus_z_mm])
    return replace(lens, image_position_mm=focus)


F_ROUNDING = 0.005


def stopped_down(lens: LensSystem, f_number: float) -> LensSystem:
    """Copy of a lens whose stop is closed to an F-number at the design wavelength.

    The paraxial entrance pupil is the image of the stop, so its diameter is proportional to that of the stop.
    The F-number of the open lens as it is printed, to `F_ROUNDING`, leaves it open.
    """
    lens.check_surfaces()
    open_f = axial_paraxial(lens, lens.design_wavelength_nm).f_number
    stop = lens.surfaces[lens.stop_index]
    darkest = open_f * stop.semi_diameter_mm / stop.inner_semi_diameter_mm if stop.inner_semi_diameter_mm else np.inf
    if not open_f - F_ROUNDING <= f_number < darkest:
        limit = f" and below F/{darkest:.3g}, its obscuration" if np.isfinite(darkest) else ""
        raise DomainError(
            f"f_number = {f_number:g}; lens {lens.name!r} is F/{open_f:.4g} fully open: at least F/{open_f:.4g}{limit} "
            "is possible"
        )
    closed = replace(stop, semi_diameter_mm=stop.semi_diameter_mm * min(open_f / f_number, 1.0))
    return lens.with_surfaces({lens.stop_index: closed})
