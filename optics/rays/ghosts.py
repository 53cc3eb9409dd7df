r"""Ghosts: light reflected by two surfaces on its way to the detector, including the detector itself.

Every pair of surfaces with a change of index defines a path: forward to the later surface, back to the earlier one,
forward again to the detector. Each path is a lens whose surfaces are in the order of the light, traced by
`optics.rays.trace` with all its apertures. A ray has the weight

.. math:: w = \prod_{passed} T_k \; R_j R_i \prod_{glasses} \tau(l)

with R and T of unpolarised light at the ray's angle (mean of s and p at each surface; polarisation by previous surfaces
is neglected) and internal transmittances over real path lengths. Light reflected a third time is counted but not
traced.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import BoolArray, FloatArray, IntArray
from optics.errors import DomainError
from optics.frames import light_direction
from optics.glass.catalogue import get_glass
from optics.glass.coating import BARE, Coating
from optics.lens.shapes.plane import Plane
from optics.lens.system import AMBIENT, HALF_TURN, LensSystem, Surface
from optics.rays.entrance_pupil import EntrancePupil, entrance_pupil, launch_disks, star_rays
from optics.rays.pupil_sampling import PupilSamples, gauss_disk
from optics.rays.reverse import right_handed
from optics.rays.trace import OK, TOTAL_REFLECTION, Rays, surface_normal, trace

RINGS, ARMS = 24, 48
"""Points of the beam, and as many of the rest of the first surface."""
SLACK = 1.25
"""Lit radius over the entrance pupil's, for a first surface without rim."""
SHARP_MM = 0.02
"""RMS radius of a ghost below which it looks like a star [mm]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FluxLedger:
    """Balance of the entering light as fractions; they sum to 1."""

    image: float
    """Absorbed by the detector without a reflection before."""
    ghosts: float
    """Absorbed by the detector after two reflections."""
    coatings: float
    """Absorbed in coatings."""
    glass: float
    """Absorbed in glass."""
    rims: float
    """Lost on rims, stops and outlines, or past a surface."""
    front: float
    """Back out of the front of the lens after one reflection."""
    more: float
    """Reflected a third time."""

    @property
    def total(self) -> float:
        """Sum of all; 1 but for rounding."""
        return sum(getattr(self, part.name) for part in fields(self))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GhostRays:
    """Rays at the end of a path, and their fractions of the entering light."""

    rays: Rays
    weight: FloatArray  # (n,) Light that reaches the plane at the end, 0 for lost rays
    lost: dict[str, float]  # Light lost behind the last reflection: rims, glass, coatings, reflected


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ghosts:
    """Ghosts of one source, g of them, brightest first; positions in the frame of the image plane."""

    # (g,) Surfaces of the first reflection (away from the detector) and of the second; ``len(lens.surfaces)`` is the
    # detector
    back: IntArray
    forward: IntArray
    flux: FloatArray  # (g,) Light on the detector plane over that of the image of the source
    x_mm: FloatArray  # (g,) Centroids
    y_mm: FloatArray
    rms_mm: FloatArray  # (g,) Root mean square and largest distance of rays from the centroid
    radius_mm: FloatArray
    image_x_mm: float  # Centroid of the image of the source
    image_y_mm: float
    ledger: FluxLedger  # Balance of the light that enters the front of the lens

    @property
    def magnitude(self) -> FloatArray:
        """Magnitudes by which each is fainter than the image."""
        return np.asarray(-2.5 * np.log10(self.flux))

    @property
    def sharp(self) -> BoolArray:
        """Whether it is small enough to be taken for a star."""
        return self.rms_mm < SHARP_MM

    def brightest_pixel(self, pixel_mm: float) -> FloatArray:
        """Light in the brightest pixel over that of the image: of a uniform disk of the same RMS radius.

        A disk of radius a has an RMS radius of a / sqrt(2); one smaller than a pixel is taken to lie in it.
        """
        return self.flux * pixel_mm**2 / np.maximum(2.0 * np.pi * self.rms_mm**2, pixel_mm**2)


def with_cover_glass(lens: LensSystem, glass: str, thickness_mm: float, gap_mm: float) -> LensSystem:
    """The lens with a plane plate in front of the image plane, which moves back by t (1 - n0 / n) to stay in focus.

    Parameters
    ----------
    lens : LensSystem
        A lens whose file leaves the detector's window out.
    glass : str
        Name of the glass.
    thickness_mm, gap_mm : float
        Thickness, and distance from its rear face to the image plane.

    Returns
    -------
    LensSystem
        The lens with two more surfaces.

    Raises
    ------
    DomainError
        Lengths that are not positive, or more than there is room for.
    """
    if not (thickness_mm > 0.0 and gap_mm > 0.0):
        raise DomainError(f"cover glass of {thickness_mm:g} mm, {gap_mm:g} mm away; both must be positive")
    axes, last = right_handed(lens.image_rotation), lens.surfaces[-1]
    glasses = {**lens.glasses, glass: get_glass(glass)}
    in_glass = replace(last, medium=glass, mirror=False, is_stop=False)
    indices = replace(lens, glasses=glasses, surfaces=(*lens.surfaces, in_glass)).indices(lens.design_wavelength_nm)
    image = lens.image_position_mm + axes[:, 2] * thickness_mm * (1.0 - 1.0 / (indices[-1] / indices[0]))
    front, back = (
        Surface(
            shape=Plane(), position_mm=image - axes[:, 2] * distance, rotation=axes, medium=medium,
            label=f"cover glass, {side}",
        )
        for side, medium, distance in (("front", glass, gap_mm + thickness_mm), ("back", AMBIENT, gap_mm))
    )  # fmt: skip
    if (front.position_mm - last.position_mm) @ axes[:, 2] <= 0.0:
        raise DomainError(f"no room for a cover glass of {thickness_mm:g} mm, {gap_mm:g} mm from the image plane")
    return replace(lens, glasses=glasses, surfaces=(*lens.surfaces, front, back), image_position_mm=image)


def reflects(lens: LensSystem, number: int) -> bool:
    """Whether a surface is between two media; the detector counts."""
    if number == len(lens.surfaces):
        return True
    surface = lens.surfaces[number]
    return not surface.mirror and not surface.shape.redirects and lens.media[number] != lens.media[number + 1]


def ghost_pairs(lens: LensSystem) -> list[tuple[int, int]]:
    """All pairs (back, forward) of surfaces that make a ghost; ``len(lens.surfaces)`` is the detector."""
    reflecting = [number for number in range(len(lens.surfaces) + 1) if reflects(lens, number)]
    return [(j, i) for j in reflecting for i in reflecting if i < j]


@dataclass(frozen=True, slots=True)
class _Crossing:
    """Passage of a path through a surface."""

    surface: int
    reflected: bool  # Whether the path is the reflected light of a surface that lets light pass
    beyond: int  # Number of the medium on its other side


class GhostPath:
    """A path through the lens: its surfaces in the order of the light, with their transmission or reflection.

    Lens, coating and absorption as of `find_ghosts`; ``back``, ``forward`` as of `ghost_pairs`: both None, the image
    itself; the second None, light that leaves through the front.
    """

    def __init__(
        self,
        lens: LensSystem,
        back: int | None,
        forward: int | None,
        coating: Coating | None = None,
        absorption: bool = True,
    ) -> None:
        self.lens, self.default, self.absorption = lens, coating, absorption
        end = len(lens.surfaces)
        self.crossings: list[_Crossing] = []
        surfaces: list[Surface] = []

        def cross(number: int, *, away: bool, reflected: bool = False) -> None:
            """Add a surface in its orientation to the light, which travels away from the object or towards it."""
            if number == end:
                axes = right_handed(lens.image_rotation)
                surface = Surface(
                    shape=Plane(), position_mm=lens.image_position_mm, rotation=axes, label="the detector"
                )
            else:
                surface = lens.surfaces[number]
            if not away and not surface.mirror:  # light meets a mirror from the same side both ways
                surface = surface.from_behind()
            name, offset = lens.media[number + (away != reflected)]
            surface = replace(surface, medium=name, index_offset=offset)
            surfaces.append(replace(surface, mirror=True, coating=None) if reflected else surface)
            self.crossings.append(_Crossing(number, reflected, number + away))

        for number in range(end if back is None else back):
            cross(number, away=True)
        if back is not None:
            cross(back, away=True, reflected=True)
            for number in range(back - 1, -1 if forward is None else forward, -1):
                cross(number, away=False)
        if forward is not None:
            cross(forward, away=False, reflected=True)
            for number in range(forward + 1, end):
                cross(number, away=True)
        self.last_reflection = max((at for at, crossing in enumerate(self.crossings) if crossing.reflected), default=-1)
        position, rotation = lens.image_position_mm, lens.image_rotation
        if back is not None and forward is None:
            last = surfaces[-1]
            position, rotation = last.position_mm, last.rotation @ (HALF_TURN if last.mirror else np.eye(3))
        ordered = tuple(replace(surface, is_stop=at == 0) for at, surface in enumerate(surfaces))
        self.folded = (
            replace(lens, surfaces=ordered, image_position_mm=position, image_rotation=rotation) if ordered else lens
        )

    def trace(
        self,
        rays: Rays,
        weight: FloatArray,
        detector: float = 0.0,
        visit: Callable[[int, Rays, FloatArray, FloatArray, FloatArray], None] | None = None,
    ) -> GhostRays:
        """Follow n rays of one wavelength in the lens frame, and the light (n,) that each carries.

        ``visit`` gets the number of every crossing, the rays there, directions (3, n) before and after it, and their
        light behind it.
        """
        rays = replace(rays, **{field.name: np.ravel(getattr(rays, field.name)) for field in fields(rays)})
        lens, wave = self.lens, rays.wavelength_nm.flat[0]
        index = lens.indices(wave)
        relative = index / index[0]
        medium, status, path_mm = 0, rays.status, rays.opl_mm
        direction = np.stack([rays.dx, rays.dy, rays.dz])
        light = np.where(rays.status == OK, weight, 0.0)
        lost = dict.fromkeys(("rims", "glass", "coatings", "reflected"), 0.0)

        def on_surface(number: int, now: Rays) -> None:
            nonlocal medium, status, direction, path_mm, light
            if number >= len(self.crossings):  # the image plane
                failed = (status == OK) & (now.status != OK)
                lost["rims"] += float(light[failed].sum())
                light = np.where(failed, 0.0, light)
                return
            crossing, counted = self.crossings[number], number > self.last_reflection
            leaving = self.folded.poses[number][1] @ np.stack([now.dx, now.dy, now.dz])
            glass = lens.glasses.get(lens.media[medium][0])
            if glass is not None and self.absorption:
                length = np.where(light > 0.0, (now.opl_mm - path_mm) / index[medium], 0.0)
                transmitted = light * glass.internal_transmittance(wave, np.maximum(length, 0.0))
                lost["glass"] += float((light - transmitted).sum()) if counted else 0.0
                light = transmitted
            failed = (status == OK) & (now.status != OK) & (now.status != TOTAL_REFLECTION)
            lost["rims"] += float(light[failed].sum()) if counted else 0.0
            light = np.where(failed, 0.0, light)
            followed, other = self._split(crossing, medium, relative, direction, leaving, light > 0.0, wave, detector)
            if counted:
                lost["reflected"] += float((light * other).sum())
                lost["coatings"] += float((light * (1.0 - followed - other)).sum())
            light = np.where(now.status == OK, light * followed, 0.0)
            if visit is not None:
                visit(number, now, direction, leaving, light)
            if not (crossing.reflected or lens.surfaces[crossing.surface].mirror):
                medium = crossing.beyond
            status, direction, path_mm = now.status, leaving, now.opl_mm

        arrived = trace(self.folded, rays, on_surface)
        return GhostRays(rays=arrived, weight=light, lost=lost)

    def _split(
        self, crossing: _Crossing, medium: int, relative: FloatArray, arriving: FloatArray, leaving: FloatArray,
        lit: BoolArray, wave: float, detector: float,
    ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        """Fractions of the light that follow the path, and that a surface sends the other way."""
        zero = np.zeros(lit.shape)
        if crossing.surface == len(self.lens.surfaces):
            return zero + detector, zero
        surface = self.lens.surfaces[crossing.surface]
        if not (surface.mirror or reflects(self.lens, crossing.surface)):
            return zero + 1.0, zero
        n1, n2 = relative[medium], relative[medium if surface.mirror else crossing.beyond]
        n_leaving = n1 if crossing.reflected or surface.mirror else n2
        cosine = np.abs((surface_normal(n1, arriving, n_leaving, leaving) * arriving).sum(axis=0))
        if surface.mirror:
            reflectance = 1.0 if surface.coating is None else surface.coating.split(wave, n1, n2, cosine).reflectance
            return np.where(lit, reflectance, 0.0), zero
        coating, (front, behind) = surface.coating, self.lens.media[crossing.surface : crossing.surface + 2]
        if coating is None and AMBIENT in (front[0], behind[0]):
            coating = self.default
        split = (coating or BARE).split(wave, n1, n2, np.where(lit, cosine, 1.0))
        passed, reflected = split.transmittance, split.reflectance
        return (reflected, passed) if crossing.reflected else (passed, reflected)


def trace_ghost(
    lens: LensSystem,
    pair: tuple[int, int] | None,
    rays: Rays,
    weight: FloatArray,
    *,
    coating: Coating | None = None,
    detector_reflectance: float = 0.0,
    absorption: bool = True,
) -> GhostRays:
    """Rays of a ghost on the image plane with their fractions of the light (`GhostPath.trace`); None: of the image."""
    back, forward = (None, None) if pair is None else pair
    return GhostPath(lens, back, forward, coating, absorption).trace(rays, weight, detector_reflectance)


def entrance_radius_mm(lens: LensSystem) -> float:
    """Radius of the first surface that light falls on: its clear aperture, or more than the entrance pupil."""
    rim = lens.surfaces[0].semi_diameter_mm
    return float(rim) if np.isfinite(rim) else SLACK * entrance_pupil(lens).radius_mm


def entrance_depth_mm(lens: LensSystem) -> float:
    """Largest sag of the first surface within `entrance_radius_mm`, either way."""
    rim = np.array([0.0, entrance_radius_mm(lens)])
    return float(np.nanmax(np.abs(np.nan_to_num(lens.surfaces[0].shape.sag(rim, 0.0 * rim)))))


def entering_rays(
    lens: LensSystem, star: FloatArray, wave: float, order: tuple[int, int] = (RINGS, ARMS)
) -> tuple[Rays, FloatArray]:
    """Rays over all of the first surface, closely where the beam of the image enters; weights sum to 1.

    Where the first surface has no rim they fill half as much again as the beam.
    """
    disks, first, direction = launch_disks(lens, star[None, :], [wave]), lens.surfaces[0], light_direction(star)
    x, y, beam = (float(v.item()) for v in (disks.x_mm, disks.y_mm, disks.radius_mm))
    outer = 1.5 * beam
    if np.isfinite(first.semi_diameter_mm):
        drift = direction[:2] / direction[2] * (disks.z_mm - first.position_mm[2])
        outer = max(beam, float(np.linalg.norm(first.position_mm[:2] + drift - [x, y])) + first.semi_diameter_mm)
    ratio = beam / outer
    core, rest = gauss_disk(*order), gauss_disk(*order, inner=ratio)
    points = PupilSamples(
        x=np.concatenate([core.x * beam / outer, rest.x]),
        y=np.concatenate([core.y * beam / outer, rest.y]),
        weight=np.concatenate([core.weight * ratio**2, rest.weight * (1.0 - ratio**2)]),
    )
    disk = EntrancePupil(x_mm=x, y_mm=y, z_mm=float(disks.z_mm), radius_mm=outer, exact=False)
    return star_rays(disk, points, star, wave, ambient_index=lens.indices(wave)[0]), points.weight


def front_rays(lens: LensSystem, v_source: ArrayLike, wave: float, order: tuple[int, int]) -> tuple[Rays, FloatArray]:
    """Rays of a distant source anywhere in front over all of the first surface, and areas [mm^2] that face it."""
    source = np.asarray(v_source, dtype=np.float64)
    if not source[2] > 0.0:
        raise DomainError("a source at 90 deg or more from the boresight does not shine into the lens")
    direction, sag = light_direction(source), entrance_depth_mm(lens)
    radius = entrance_radius_mm(lens) + sag * float(np.hypot(*direction[:2]) / direction[2])
    samples = gauss_disk(*order)
    x, y, z = lens.surfaces[0].position_mm - direction / direction[2] * (sag + 1.0)
    rays = Rays.create(
        x_mm=x + radius * samples.x, y_mm=y + radius * samples.y, z_mm=z, direction=direction, wavelength_nm=wave
    )
    return rays, samples.weight * np.pi * radius**2 * source[2]


def _check_source(lens: LensSystem, wavelength_nm: float | None, detector_reflectance: float) -> float:
    """Wavelength [nm] of a calculation that the lens and the detector allow."""
    lens.check_surfaces()
    if not 0.0 <= detector_reflectance <= 1.0:
        raise DomainError(f"detector_reflectance = {detector_reflectance:g}; it must lie in 0 ... 1")
    return lens.design_wavelength_nm if wavelength_nm is None else float(wavelength_nm)


def find_ghosts(
    lens: LensSystem,
    v_cam: Sequence[float] | FloatArray,
    *,
    wavelength_nm: float | None = None,
    coating: Coating | None = None,
    detector_reflectance: float = 0.2,
    absorption: bool = True,
    order: tuple[int, int] = (RINGS, ARMS),
) -> Ghosts:
    """All two-reflection ghosts of a distant source, and the balance of its light.

    Parameters
    ----------
    lens : LensSystem
        The lens, with the cover glass of its detector (`with_cover_glass`).
    v_cam : (3,)
        Unit vector towards the source in cam (`optics.frames.field_direction`).
    wavelength_nm : float, optional
        Wavelength; the design wavelength if left out.
    coating : Coating, optional
        On surfaces between air and glass for which the lens states none; bare glass if left out.
    detector_reflectance : float
        Fraction of the light that the detector reflects like a mirror; silicon 0.1 to 0.3.
    absorption : bool
        Whether glass absorbs; needs internal transmittances.
    order : (int, int)
        Rings and azimuths of the rays in the beam, and as many on the rest of the first surface.

    Returns
    -------
    Ghosts
        Ghosts that reach the image plane.

    Raises
    ------
    DomainError
        A detector reflectance outside 0 ... 1, a wavelength outside the range of a glass or coating, a measured lens,
        a source that the lens does not image.
    """
    wave = _check_source(lens, wavelength_nm, detector_reflectance)
    rays, entering = entering_rays(lens, np.asarray(v_cam, dtype=np.float64), wave, order)

    def follow(back: int | None, forward: int | None) -> GhostRays:
        return GhostPath(lens, back, forward, coating, absorption).trace(rays, entering, detector_reflectance)

    image, pairs = follow(None, None), ghost_pairs(lens)
    direct = float(image.weight.sum())
    if direct <= 0.0:
        raise DomainError(f"lens {lens.name!r}: no light of this source reaches the image plane")
    once = [follow(back, None) for back in range(len(lens.surfaces) + 1) if reflects(lens, back)]
    twice = [follow(*pair) for pair in pairs]
    light = [float(ghost.weight.sum()) for ghost in twice]
    rows = [(*pair, flux / direct, *_blur(g)) for pair, flux, g in zip(pairs, light, twice, strict=True) if flux > 0.0]
    rows.sort(key=lambda row: -row[2])
    back, forward, flux, x, y, rms, radius = np.array(rows, dtype=np.float64).reshape(-1, 7).T
    image_x, image_y, _, _ = _blur(image)
    absorbed, paths = 1.0 - detector_reflectance, [image, *once, *twice]
    return Ghosts(
        back=back.astype(int),
        forward=forward.astype(int),
        flux=flux,
        x_mm=x,
        y_mm=y,
        rms_mm=rms,
        radius_mm=radius,
        image_x_mm=image_x,
        image_y_mm=image_y,
        ledger=FluxLedger(
            image=absorbed * direct,
            ghosts=absorbed * sum(light),
            **{loss: sum(path.lost[loss] for path in paths) for loss in ("coatings", "glass", "rims")},
            front=sum(float(path.weight.sum()) for path in once),
            more=sum(path.lost["reflected"] for path in twice) + detector_reflectance * sum(light),
        ),
    )


def _blur(ghost: GhostRays) -> tuple[float, float, float, float]:
    """Centroid, RMS and largest distance from it of the rays that arrived [mm]."""
    lit = ghost.weight > 0.0
    weight = ghost.weight[lit] / ghost.weight[lit].sum()
    x, y = ghost.rays.x[lit], ghost.rays.y[lit]
    mean_x, mean_y = float(weight @ x), float(weight @ y)
    distance = np.hypot(x - mean_x, y - mean_y)
    return mean_x, mean_y, float(np.sqrt(weight @ distance**2)), float(distance.max())


def ghost_irradiance(
    lens: LensSystem,
    v_source: ArrayLike,
    half_mm: Sequence[float],
    *,
    wavelength_nm: float | None = None,
    coating: Coating | None = None,
    detector_reflectance: float = 0.2,
    absorption: bool = True,
    rings: int = 20,
    arms: int = 48,
) -> dict[tuple[int, int], tuple[float, float]]:
    """Mean irradiance of all ghosts on a detector of half sizes ``half_mm``, source anywhere in front.

    Pair -> irradiance over that of the source through a plane that faces it, and its error as if rays were random.
    Parameters and errors as of `find_ghosts`; ``rings`` x ``arms`` rays fill the first surface.
    """
    wave = _check_source(lens, wavelength_nm, detector_reflectance)
    rays, area = front_rays(lens, v_source, wave, (rings, arms))
    weight = area / (4.0 * half_mm[0] * half_mm[1])
    irradiance = {}
    for pair in ghost_pairs(lens):
        ghost = GhostPath(lens, *pair, coating, absorption).trace(rays, weight, detector_reflectance)
        inside = (np.abs(ghost.rays.x) <= half_mm[0]) & (np.abs(ghost.rays.y) <= half_mm[1])
        light = ghost.weight[(ghost.weight > 0.0) & inside]
        irradiance[pair] = float(light.sum()), float(np.sqrt((light**2).sum()))
    return irradiance
