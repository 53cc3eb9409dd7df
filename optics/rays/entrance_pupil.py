"""Entrance pupil of a lens as a launch disk, and the rays of stars from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConvergenceError
from optics.frames import light_direction
from optics.lens.system import LensSystem
from optics.rays.program import compile_lens
from optics.rays.pupil_sampling import PupilSamples
from optics.rays.trace import Rays, trace
from optics.rays.vignetted_pupil import pupil_outlines
from optics.records import freeze_alike

ARMS = 24
"""Number of azimuths of outlines."""
MARGIN = 1.01 / math.cos(math.pi / ARMS)
"""Room of a disk: for the arc between two of those points, and 1 %."""
INSIDE = 1e-7
"""Relative distance inside an outline at which a ray is launched that has to get through the lens."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EntrancePupil:
    """Disk in a plane z = const of object space from which rays are launched."""

    z_mm: float  # Centre in the lens frame
    radius_mm: float
    # Whether the disk is the clear stop itself, so that every ray in it passes the stop and none outside does. If
    # not, the disk only contains the pupil, and the trace decides
    exact: bool
    x_mm: float = 0.0
    y_mm: float = 0.0

    @property
    def area_mm2(self) -> float:
        """Area of the disk; times cos(field) it is the cross-section of the launched beam [mm^2]."""
        return math.pi * self.radius_mm**2


@dataclass(frozen=True, slots=True, kw_only=True)
class LaunchDisks:
    """Disks in a plane z = const of object space, one for each of f stars, that hold its beam and little more."""

    z_mm: float  # The plane, in the lens frame
    x_mm: FloatArray  # (f, 1, 1) Centres and radii
    y_mm: FloatArray  # (f, 1, 1)
    radius_mm: FloatArray  # (f, 1, 1)

    def __post_init__(self) -> None:
        freeze_alike(self, "x_mm", "y_mm", "radius_mm", shape=("f", 1, 1))

    @property
    def area_mm2(self) -> FloatArray:
        """Areas (f, 1, 1) of the disks [mm^2]."""
        return np.pi * self.radius_mm**2


def star_rays(
    pupil: EntrancePupil | LaunchDisks,
    samples: PupilSamples,
    v_cam: ArrayLike,
    wavelength_nm: ArrayLike,
    *,
    ambient_index: float | FloatArray = 1.0,
) -> Rays:
    """Rays of stars from the sampled launch disk.

    Parameters
    ----------
    pupil : EntrancePupil or LaunchDisks
        One launch disk for all, or one for each of f stars, (f, 1, 3), at w wavelengths.
    samples : PupilSamples
        Points of the unit disk, n of them.
    v_cam : (..., 3)
        Unit vectors towards the stars in cam.
    wavelength_nm : (...)
        Wavelengths, broadcastable with the stars.
    ambient_index : float or (...)
        Index of the surroundings; scales the initial optical path.

    Returns
    -------
    Rays
        Shape (..., n). ``opl_mm`` starts as the distance to the plane wavefront through the lens frame's origin, so
        that differences at the end are wavefront errors.
    """
    d = light_direction(v_cam)[..., None, :]
    x, y = pupil.x_mm + pupil.radius_mm * samples.x, pupil.y_mm + pupil.radius_mm * samples.y
    rays = Rays.create(
        x_mm=x, y_mm=y, z_mm=pupil.z_mm, direction=d, wavelength_nm=np.asarray(wavelength_nm, float)[..., None]
    )
    start = rays.x * rays.dx + rays.y * rays.dy + rays.z * rays.dz
    rays.opl_mm[...] = np.asarray(ambient_index, float)[..., None] * start
    return rays


def entrance_pupil(
    lens: LensSystem, *, max_field_deg: float | None = None, wavelength_nm: Sequence[float] | None = None
) -> EntrancePupil:
    """Launch disk of a lens.

    If a clear, untilted stop stands in front of all glass it is that stop, exactly. Otherwise it is a disk about the
    paraxial entrance pupil's centre that holds the beams of the whole field by real rays
    (`optics.rays.vignetted_pupil`), with 2 % of room. For a wide lens, whose pupil wanders with the field, it is much
    wider than any beam: `launch_disks` are disks for single stars.

    Parameters
    ----------
    lens : LensSystem
        The lens; may be perturbed.
    max_field_deg : float, optional
        Half field angle that has to be covered (circular field); that of the lens if left out.
    wavelength_nm : sequence of float, optional
        Wavelengths that have to be covered; if left out, the design wavelength, 0.75 and 1.4 times that (within the
        range of the glasses).

    Returns
    -------
    EntrancePupil
        Centre and radius of the disk [mm].

    Raises
    ------
    ConvergenceError
        If no ray at all reaches the image plane, or nothing limits the beam.
    """
    if stop_in_front(lens):
        stop = lens.surfaces[lens.stop_index]
        x, y, z = (float(v) for v in stop.position_mm)
        return EntrancePupil(x_mm=x, y_mm=y, z_mm=z, radius_mm=float(stop.semi_diameter_mm), exact=True)
    field = lens.max_field_deg if max_field_deg is None else float(max_field_deg)
    spread = np.clip(lens.design_wavelength_nm * np.array([0.75, 1.0, 1.4]), *lens.wavelength_range_nm)
    waves = np.unique(spread if wavelength_nm is None else np.asarray(wavelength_nm, float))
    return _enclosing_disk(_State(lens), field, tuple(waves.tolist()))


def launch_disks(lens: LensSystem, v_cam: FloatArray, wavelength_nm: ArrayLike) -> LaunchDisks:
    """Launch disks of stars at unit vectors (f, 3) in cam for wavelengths (w,); errors as `entrance_pupil`."""
    waves = np.asarray(wavelength_nm, float)
    ends = np.unique([waves.min(), np.median(waves), waves.max()])
    outlines = pupil_outlines(lens, v_cam, ends, arms=ARMS)
    lit = outlines.lit[..., None]
    low, high = (
        np.stack([f(np.where(lit, v, end), axis=(1, 2)) for v in (outlines.x_mm, outlines.y_mm)])
        for f, end in ((np.min, np.inf), (np.max, -np.inf))
    )
    any_lit = outlines.lit.any(1)
    centre = np.where(any_lit, 0.5 * (np.where(any_lit, low, 0.0) + np.where(any_lit, high, 0.0)), 0.0)
    x, y = centre[..., None, None]
    radius = _bound(np.where(lit, np.hypot(outlines.x_mm - x, outlines.y_mm - y), 0.0))
    return LaunchDisks(z_mm=outlines.z_mm, x_mm=x, y_mm=y, radius_mm=radius.max((1, 2), keepdims=True))


def _bound(distance_mm: FloatArray) -> FloatArray:
    """Largest distance of an outline from a centre between each of `ARMS` azimuths and the next, from its distances
    (..., m) there; a corner of two apertures sticks out at most as far as both tangents lead."""
    before, start, end, beyond = (np.roll(distance_mm, -k, axis=-1) for k in (-1, 0, 1, 2))
    corner = np.minimum(start + np.maximum(start - before, 0.0), end + np.maximum(end - beyond, 0.0))
    return np.asarray(MARGIN * np.maximum(np.maximum(start, end), corner))


def stop_in_front(lens: LensSystem) -> bool:
    """Whether a clear, untilted stop in front of all glass is the entrance pupil itself."""
    stop = lens.surfaces[lens.stop_index]
    upright = np.array_equal(stop.rotation[:, 2], [0.0, 0.0, 1.0])
    return bool(lens.stop_in_front and upright and stop.inner_semi_diameter_mm == 0.0)


class _State:
    """A lens, compared by what a trace depends on: one search serves all calls for the same state."""

    def __init__(self, lens: LensSystem) -> None:
        program, theta = compile_lens(lens)
        self.lens, self._key = lens, (program, theta.tobytes(), lens.stop_index, lens.design_wavelength_nm)

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _State) and self._key == other._key


@lru_cache(maxsize=64)
def _enclosing_disk(state: _State, field_deg: float, wavelength_nm: tuple[float, ...]) -> EntrancePupil:
    """The disk that holds every ray; see `entrance_pupil`."""
    lens, waves = state.lens, np.array(wavelength_nm)
    angle = np.radians(np.array([0.0, *np.repeat([0.5, 0.8, 1.0], 8)]) * field_deg)
    azimuth = np.array([0.0, *np.tile(2.0 * np.pi * np.arange(8) / 8, 3)])
    stars = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1)
    outlines = pupil_outlines(lens, stars, waves, arms=ARMS)
    x, y = (
        centre + (1.0 - INSIDE) * (v - centre)
        for v, centre in ((outlines.x_mm, outlines.centre_mm[..., :1]), (outlines.y_mm, outlines.centre_mm[..., 1:]))
    )
    light = light_direction(stars)[:, None, None]
    rim = Rays.create(x_mm=x, y_mm=y, z_mm=outlines.z_mm, direction=light, wavelength_nm=waves[:, None])
    if not (trace(lens, rim).ok & outlines.lit[..., None]).any():  # holes are no part of an outline
        raise ConvergenceError(f"lens {lens.name!r}: no ray of any field reaches the image plane")
    radius = _bound(np.hypot(outlines.x_mm, outlines.y_mm))[outlines.lit].max()
    return EntrancePupil(z_mm=outlines.z_mm, radius_mm=float(radius), exact=False)
