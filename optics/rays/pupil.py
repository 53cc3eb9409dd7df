"""Entrance pupil of a lens, and sampling points of its disk."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.frames import light_direction
from optics.lens.system import LensSystem
from optics.rays.beam import beam_outlines
from optics.rays.program import compile_lens
from optics.rays.trace import Rays, trace
from optics.records import freeze

ARMS = 24
"""Number of azimuths of beam outlines."""
MARGIN = 1.01 / math.cos(math.pi / ARMS)
"""Room of a disk: for the arc between two of those points, and 1 %."""
INSIDE = 1e-7
"""How far inside an outline a ray is launched that has to get through the lens."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PupilSamples:
    """Points of the unit disk with weights that sum to 1."""

    x: FloatArray  # (n,) Points
    y: FloatArray  # (n,) Points
    weight: FloatArray  # (n,) Weights; equal for Sobol points

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("x", "y", "weight"):
            freeze(self, name, shape=("n",), sizes=sizes)


@dataclass(frozen=True, slots=True, kw_only=True)
class EntrancePupil:
    """Disk in a plane z = const of object space from which rays are launched."""

    z_mm: float  # Centre in the lens frame
    radius_mm: float  # Radius
    # Whether the disk is the clear stop itself, so that every ray in it passes the stop and none outside does. If
    # not, the disk only contains the pupil, and the trace decides
    exact: bool
    x_mm: float = 0.0  # Centre in the lens frame
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
        sizes: dict[str, int] = {}
        for name in ("x_mm", "y_mm", "radius_mm"):
            freeze(self, name, shape=("f", 1, 1), sizes=sizes)

    @property
    def area_mm2(self) -> FloatArray:
        """Areas (f, 1, 1) of the disks [mm^2]."""
        return np.pi * self.radius_mm**2


def gauss_disk(rings: int, arms: int) -> PupilSamples:
    """Gauss-Legendre in r^2 times trapezoid in phi.

    Exact for polynomials in (x, y) of degree min(4 rings - 1, arms - 1) (Peirce 1957, J. Soc. Indust. Appl. Math. 5,
    66): the trapezoid removes every angular order below ``arms``, what is left is a
    polynomial in r^2 that Gauss-Legendre integrates up to degree 2 rings - 1. For ``arms`` divisible by 4 the points
    are symmetric about both axes.

    Parameters
    ----------
    rings, arms : int
        Number of radii and of azimuths.

    Returns
    -------
    PupilSamples
        rings x arms points of the unit disk, with weights.

    Raises
    ------
    DomainError
        If either is below 1.
    """
    if rings < 1 or arms < 1:
        raise DomainError(f"pupil sampling of {rings} rings x {arms} arms; at least 1 x 1 is needed")
    node, weight = np.polynomial.legendre.leggauss(rings)
    r, phi = np.sqrt(0.5 * (1.0 + node)), 2.0 * np.pi * (np.arange(arms) + 0.5) / arms
    return PupilSamples(
        x=np.outer(r, np.cos(phi)).ravel(),
        y=np.outer(r, np.sin(phi)).ravel(),
        weight=np.repeat(0.5 * weight / arms, arms),
    )


def disk_from_square(u: ArrayLike, v: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Area-preserving map of the unit square to the unit disk: r = sqrt(u), phi = 2 pi v."""
    r, phi = np.sqrt(np.asarray(u, float)), 2.0 * np.pi * np.asarray(v, float)
    return r * np.cos(phi), r * np.sin(phi)


def sobol_disk(count: int, *, seed: int) -> PupilSamples:
    """Scrambled Sobol points in the unit disk.

    Parameters
    ----------
    count : int
        Number of points, a power of two (what the balance of a Sobol set needs).
    seed : int
        Seed of the scrambling.

    Returns
    -------
    PupilSamples
        Points of the unit disk, of equal weights.

    Raises
    ------
    DomainError
        If ``count`` is not a power of two from 1 to 2^30.
    """
    if not (0 < count <= 1 << 30) or count & (count - 1):
        raise DomainError(f"{count} Sobol points; a power of two from 1 to 2^30 is needed")
    from scipy.stats import qmc  # slow to import

    square = qmc.Sobol(2, scramble=True, rng=np.random.default_rng(seed)).random_base2(count.bit_length() - 1)
    x, y = disk_from_square(square[:, 0], square[:, 1])
    return PupilSamples(x=x, y=y, weight=np.full(count, 1.0 / count))


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
    paraxial entrance pupil's centre that holds the beams from the whole field as real rays find them
    (`optics.rays.beam`), with 2 % of room. For a wide lens, whose pupil wanders with the field, it is much wider than
    any beam: `launch_disks` gives every star its own.

    Parameters
    ----------
    lens : LensSystem
        The lens; may be perturbed.
    max_field_deg : float, optional
        Half field angle that has to be covered (circular field); the lens's own if left out.
    wavelength_nm : sequence of float, optional
        Wavelengths that have to be covered; if left out, the design wavelength, 0.75 and 1.4 times that (as far as the
        glasses are known there).

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
    return _searched(_State(lens), field, tuple(waves.tolist()))


def launch_disks(lens: LensSystem, v_cam: FloatArray, wavelength_nm: ArrayLike) -> LaunchDisks:
    """A launch disk for every star.

    Shapes: ``v_cam`` (f, 3), ``wavelength_nm`` (w,).
    """
    waves = np.asarray(wavelength_nm, float)
    ends = np.unique([waves.min(), np.median(waves), waves.max()])
    found = beam_outlines(lens, v_cam, ends, arms=ARMS)
    lit = found.lit[..., None]
    low, high = (
        np.stack([f(np.where(lit, v, end), axis=(1, 2)) for v in (found.x_mm, found.y_mm)])
        for f, end in ((np.min, np.inf), (np.max, -np.inf))
    )
    some = found.lit.any(1)
    centre = np.where(some, 0.5 * (np.where(some, low, 0.0) + np.where(some, high, 0.0)), 0.0)[..., None, None]
    radius = _bound(np.where(lit, np.hypot(found.x_mm - centre[0], found.y_mm - centre[1]), 0.0))
    return LaunchDisks(z_mm=found.z_mm, x_mm=centre[0], y_mm=centre[1], radius_mm=radius.max((1, 2), keepdims=True))


def _bound(distance_mm: FloatArray) -> FloatArray:
    """The farthest an outline gets from a centre from each of `ARMS` to the next, from its distances (..., m) there; a
    corner of two apertures sticks out at most as far as both tangents lead."""
    before, here, ahead, beyond = (np.roll(distance_mm, -k, axis=-1) for k in (-1, 0, 1, 2))
    corner = np.minimum(here + np.maximum(here - before, 0.0), ahead + np.maximum(ahead - beyond, 0.0))
    return np.asarray(MARGIN * np.maximum(np.maximum(here, ahead), corner))


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
def _searched(state: _State, field: float, wavelength_nm: tuple[float, ...]) -> EntrancePupil:
    """The disk that holds every ray; see `entrance_pupil`."""
    lens, turn = state.lens, 2.0 * np.pi * np.arange(8) / 8
    angle = np.radians(np.array([0.0, *np.repeat([0.5, 0.8, 1.0], 8)]) * field)
    azimuth = np.array([0.0, *np.tile(turn, 3)])
    stars = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1)
    found = beam_outlines(lens, stars, np.array(wavelength_nm), arms=ARMS)
    x, y = (
        centre + (1.0 - INSIDE) * (v - centre)
        for v, centre in ((found.x_mm, found.centre_mm[..., :1]), (found.y_mm, found.centre_mm[..., 1:]))
    )
    waves, light = np.array(wavelength_nm)[:, None], light_direction(stars)[:, None, None]
    rim = Rays.create(x_mm=x, y_mm=y, z_mm=found.z_mm, direction=light, wavelength_nm=waves)
    if not (trace(lens, rim).ok & found.lit[..., None]).any():  # holes are no part of an outline
        raise ConvergenceError(f"lens {lens.name!r}: no ray of any field reaches the image plane")
    reach = _bound(np.hypot(found.x_mm, found.y_mm))[found.lit].max()
    return EntrancePupil(z_mm=found.z_mm, radius_mm=float(reach), exact=False)
