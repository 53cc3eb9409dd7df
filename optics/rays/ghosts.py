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

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.frames import light_direction
from optics.glass.catalogue import get_glass
from optics.glass.coating import BARE, Coating
from optics.lens.shapes.plane import Plane
from optics.lens.system import AMBIENT, HALF_TURN, LensSystem, Surface
from optics.rays.pupil import EntrancePupil, PupilSamples, entrance_pupil, gauss_disk, launch_disks, star_rays
from optics.rays.trace import OK, TOTAL_REFLECTION, Rays, trace

RINGS, ARMS = 24, 48
"""Points of the beam, and as many of the rest of the first surface."""
SLACK = 1.25
"""Lit radius over the entrance pupil's, for a first surface without rim."""
SHARP_MM = 0.02
"""RMS radius of a ghost below which it looks like a star [mm]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FluxLedger:
    """Balance of the entering light as shares; they sum to 1."""

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
        return sum(getattr(self, one.name) for one in fields(self))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GhostRays:
    """Rays at the end of one path; ``weight`` are shares of what entered, 0 for rays that are lost."""

    rays: Rays
    weight: FloatArray  # (n,) What reaches the plane at the end
    lost: dict[str, float]  # What is lost behind the last reflection: rims, glass, coatings, reflected


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ghosts:
    """Ghosts of one source, g of them, brightest first; places in the frame of the image plane."""

    back: IntArray  # (g,) Surfaces that turn the light back, then forward again; ``len(lens.surfaces)`` is the detector
    forward: IntArray
    flux: FloatArray  # (g,) Light on the detector plane as a share of the source's image
    x_mm: FloatArray  # (g,) Centroids
    y_mm: FloatArray
    rms_mm: FloatArray  # (g,) Root mean square and largest distance of rays from the centroid
    radius_mm: FloatArray
    image_x_mm: float  # Centroid of the image of the source
    image_y_mm: float
    ledger: FluxLedger  # Where the light goes that enters the front of the lens

    @property
    def magnitude(self) -> FloatArray:
        """Magnitudes by which each is fainter than the image."""
        return np.asarray(-2.5 * np.log10(self.flux))

    @property
    def sharp(self) -> np.typing.NDArray[np.bool_]:
        """Whether it is small enough to be taken for a star."""
        return self.rms_mm < SHARP_MM

    def pixel_share(self, pixel_mm: float) -> FloatArray:
        """Light in the brightest pixel as a share of the source's image: that of a uniform disk of the same RMS radius.

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
        The lens with its two more surfaces.

    Raises
    ------
    DomainError
        Lengths that are not positive, or more than there is room for.
    """
    if not (thickness_mm > 0.0 and gap_mm > 0.0):
        raise DomainError(f"cover glass of {thickness_mm:g} mm, {gap_mm:g} mm away; both must be positive")
    axes = _right_handed(lens.image_rotation)
    last = lens.surfaces[-1]
    with_glass = {**lens.glasses, glass: get_glass(glass)}
    plate = replace(
        lens, glasses=with_glass, surfaces=(*lens.surfaces, replace(last, medium=glass, mirror=False, is_stop=False))
    )
    index = plate.indices(lens.design_wavelength_nm)[-1] / plate.indices(lens.design_wavelength_nm)[0]
    image = lens.image_position_mm + axes[:, 2] * thickness_mm * (1.0 - 1.0 / index)
    faces = [image - axes[:, 2] * distance for distance in (gap_mm + thickness_mm, gap_mm)]
    if (faces[0] - last.position_mm) @ axes[:, 2] <= 0.0:
        raise DomainError(f"no room for a cover glass of {thickness_mm:g} mm, {gap_mm:g} mm from the image plane")
    return replace(
        lens,
        glasses=with_glass,
        surfaces=(
            *lens.surfaces,
            *(
                Surface(shape=Plane(), position_mm=face, rotation=axes, medium=medium, label=f"cover glass, {side}")
                for face, medium, side in zip(faces, (glass, AMBIENT), ("front", "back"), strict=True)
            ),
        ),
        image_position_mm=image,
    )


def _right_handed(axes: FloatArray) -> FloatArray:
    return np.asarray(axes * [np.sign(np.linalg.det(axes)), 1.0, 1.0])


def reflects(lens: LensSystem, number: int) -> bool:
    """Whether a surface is one between two media; the detector counts."""
    if number == len(lens.surfaces):
        return True
    surface = lens.surfaces[number]
    return not surface.mirror and not surface.shape.redirects and lens.media[number] != lens.media[number + 1]


def ghost_pairs(lens: LensSystem) -> list[tuple[int, int]]:
    """All pairs (back, forward) of surfaces that make a ghost; ``len(lens.surfaces)`` is the detector."""
    reflecting = [number for number in range(len(lens.surfaces) + 1) if reflects(lens, number)]
    return [(j, i) for j in reflecting for i in reflecting if i < j]


@dataclass(frozen=True, slots=True)
class _Meeting:
    """Passage of a path through one surface."""

    surface: int
    turns: bool  # Whether the path is the reflected light of a surface that lets light pass
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
        self.meetings: list[_Meeting] = []
        self.surfaces: list[Surface] = []
        for number in range(end if back is None else back):
            self._pass(number, away=True)
        if back is not None:
            self._turn(back, away=True)
            for number in range(back - 1, -1 if forward is None else forward, -1):
                self._pass(number, away=False)
        if forward is not None:
            self._turn(forward, away=False)
            for number in range(forward + 1, end):
                self._pass(number, away=True)
        self.last_turn = max((at for at, one in enumerate(self.meetings) if one.turns), default=-1)
        self.surfaces = [replace(one, is_stop=at == 0) for at, one in enumerate(self.surfaces)]
        position, rotation = lens.image_position_mm, lens.image_rotation
        if back is not None and forward is None:
            last = self.surfaces[-1]
            position, rotation = last.position_mm, last.rotation @ (HALF_TURN if last.mirror else np.eye(3))
        self.folded = (
            replace(lens, surfaces=tuple(self.surfaces), image_position_mm=position, image_rotation=rotation)
            if self.surfaces
            else lens
        )

    def _pass(self, number: int, *, away: bool) -> None:
        surface, (name, offset) = self.lens.surfaces[number], self.lens.media[number + 1 if away else number]
        if not away and not surface.mirror:  # light meets a mirror from the same side both ways
            surface = surface.from_behind()
        self.surfaces.append(replace(surface, medium=name, index_offset=offset))
        self.meetings.append(_Meeting(number, False, number + 1 if away else number))

    def _turn(self, number: int, *, away: bool) -> None:
        lens = self.lens
        name, offset = lens.media[number if away else number + 1]
        if number == len(lens.surfaces):
            axes = _right_handed(lens.image_rotation)
            surface = Surface(shape=Plane(), position_mm=lens.image_position_mm, rotation=axes, label="the detector")
        else:
            surface = lens.surfaces[number]
        surface = surface if away else surface.from_behind()
        self.surfaces.append(replace(surface, medium=name, index_offset=offset, mirror=True, coating=None))
        self.meetings.append(_Meeting(number, True, number + 1 if away else number))

    def trace(
        self,
        rays: Rays,
        weight: FloatArray,
        detector: float = 0.0,
        seen: Callable[[int, Rays, FloatArray, FloatArray, FloatArray], None] | None = None,
    ) -> GhostRays:
        """Follow n rays of one wavelength in the lens frame, and the light (n,) that each carries.

        ``seen`` gets the number of every meeting, the rays there, directions (3, n) before and after it, and what is
        left of their light behind it.
        """
        rays = replace(rays, **{one.name: np.ravel(getattr(rays, one.name)) for one in fields(rays)})
        lens, wave = self.lens, rays.wavelength_nm.flat[0]
        index = lens.indices(wave)
        relative = index / index[0]
        before, status = 0, rays.status
        direction = np.stack([rays.dx, rays.dy, rays.dz])
        path, share = rays.opl_mm, np.where(rays.status == OK, weight, 0.0)
        lost = dict.fromkeys(("rims", "glass", "coatings", "reflected"), 0.0)

        def visit(number: int, now: Rays) -> None:
            nonlocal before, status, direction, path, share
            if number >= len(self.meetings):
                gone = (status == OK) & (now.status != OK)
                lost["rims"] += float(share[gone].sum())
                share = np.where(gone, 0.0, share)
                return
            one, counted = self.meetings[number], number > self.last_turn
            turned = self.folded.poses[number][1] @ np.stack([now.dx, now.dy, now.dz])
            glass = lens.glasses.get(lens.media[before][0])
            if glass is not None and self.absorption:
                length = np.where(share > 0.0, (now.opl_mm - path) / index[before], 0.0)
                left = share * glass.internal_transmittance(wave, np.maximum(length, 0.0))
                lost["glass"] += float((share - left).sum()) if counted else 0.0
                share = left
            gone = (status == OK) & (now.status != OK) & (now.status != TOTAL_REFLECTION)
            lost["rims"] += float(share[gone].sum()) if counted else 0.0
            share = np.where(gone, 0.0, share)
            on = share > 0.0
            kept, other = self._shares(one, before, relative, direction, turned, on, wave, detector)
            if counted:
                lost["reflected"] += float((share * other).sum())
                lost["coatings"] += float((share * (1.0 - kept - other)).sum())
            share = np.where(now.status == OK, share * kept, 0.0)
            if seen is not None:
                seen(number, now, direction, turned, share)
            if not one.turns:
                before = one.beyond if not lens.surfaces[one.surface].mirror else before
            status, direction, path = now.status, turned, now.opl_mm

        arrived = trace(self.folded, rays, visit)
        return GhostRays(rays=arrived, weight=share, lost=lost)

    def _shares(
        self, one: _Meeting, before: int, relative: FloatArray, arriving: FloatArray, leaving: FloatArray,
        on: np.typing.NDArray[np.bool_], wave: float, detector: float,
    ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        """Share of the light that goes on along the path, and that a surface sends the other way."""
        nothing = np.zeros(on.shape)
        if one.surface == len(self.lens.surfaces):
            return nothing + detector, nothing
        surface = self.lens.surfaces[one.surface]
        ends = [self.lens.media[one.surface], self.lens.media[one.surface + 1]]
        coating = surface.coating
        if coating is None and AMBIENT in (name for name, _ in ends):
            coating = self.default
        if surface.mirror:
            mirror = nothing + 1.0
            if surface.coating is not None:
                cosine = 0.5 * np.linalg.norm(leaving - arriving, axis=0)
                mirror = surface.coating.split(wave, relative[before], relative[before], cosine).reflectance
            return np.where(on, mirror, 0.0), nothing
        if not reflects(self.lens, one.surface):
            return nothing + 1.0, nothing
        # Snell's law in vector form: n2 d2 - n1 d1 lies along the normal
        n1, n2 = relative[before], relative[one.beyond]
        across = (n1 if one.turns else n2) * leaving - n1 * arriving
        length = np.linalg.norm(across, axis=0)
        cosine = np.abs((across * arriving).sum(axis=0)) / np.where(length > 0.0, length, 1.0)
        split = (coating or BARE).split(wave, n1, n2, np.where(on, cosine, 1.0))
        passed, reflected = split.transmittance, split.reflectance
        return (reflected, passed) if one.turns else (passed, reflected)


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
    """Rays of one ghost with their shares of the light, on the image plane; None: of the image (`GhostPath.trace`)."""
    back, forward = (None, None) if pair is None else pair
    return GhostPath(lens, back, forward, coating, absorption).trace(rays, weight, detector_reflectance)


def entrance_radius_mm(lens: LensSystem) -> float:
    """Radius of the first surface that light falls on: its clear aperture, or more than the entrance pupil."""
    rim = lens.surfaces[0].semi_diameter_mm
    return float(rim) if np.isfinite(rim) else SLACK * entrance_pupil(lens).radius_mm


def entering_rays(
    lens: LensSystem, star: FloatArray, wave: float, order: tuple[int, int] = (RINGS, ARMS)
) -> tuple[Rays, FloatArray]:
    """Rays over all of the first surface, closely where the beam of the image enters; weights sum to 1.

    Where the first surface has no rim they fill half as much again as the beam.
    """
    count, arms = order
    disks, first, direction = launch_disks(lens, star[None, :], [wave]), lens.surfaces[0], light_direction(star)
    inner = float(disks.radius_mm.item())
    centre = np.array([disks.x_mm.item(), disks.y_mm.item()])
    outer = 1.5 * inner
    if np.isfinite(first.semi_diameter_mm):
        drift = direction[:2] / direction[2] * (float(disks.z_mm) - first.position_mm[2])
        away = float(np.linalg.norm(first.position_mm[:2] + drift - centre))
        outer = max(inner, away + first.semi_diameter_mm)
    core, share = gauss_disk(count, arms), (inner / outer) ** 2
    node, weight = np.polynomial.legendre.leggauss(count)
    r, phi = np.sqrt(share + (1.0 - share) * 0.5 * (1.0 + node)), 2.0 * np.pi * (np.arange(arms) + 0.5) / arms
    points = PupilSamples(
        x=np.concatenate([core.x * inner / outer, np.outer(r, np.cos(phi)).ravel()]),
        y=np.concatenate([core.y * inner / outer, np.outer(r, np.sin(phi)).ravel()]),
        weight=np.concatenate([core.weight * share, np.repeat(0.5 * weight / arms, arms) * (1.0 - share)]),
    )
    disk = EntrancePupil(
        x_mm=float(centre[0]), y_mm=float(centre[1]), z_mm=float(disks.z_mm), radius_mm=outer, exact=False
    )
    return star_rays(disk, points, star, wave, ambient_index=lens.indices(wave)[0]), points.weight


def front_rays(lens: LensSystem, v_source: ArrayLike, wave: float, order: tuple[int, int]) -> tuple[Rays, FloatArray]:
    """Rays of a distant source anywhere in front over all of the first surface, and areas [mm^2] that face it."""
    source = np.asarray(v_source, dtype=np.float64)
    if not source[2] > 0.0:
        raise DomainError("a source at 90 deg or more from the boresight does not shine into the lens")
    direction, first, radius = light_direction(source), lens.surfaces[0], entrance_radius_mm(lens)
    rim = np.array([0.0, radius])
    sag = float(np.nanmax(np.abs(np.nan_to_num(first.shape.sag(rim, 0.0 * rim)))))
    wide = radius + sag * float(np.hypot(*direction[:2]) / direction[2])
    samples, (x, y, z) = gauss_disk(*order), first.position_mm - direction / direction[2] * (sag + 1.0)
    rays = Rays.create(
        x_mm=x + wide * samples.x, y_mm=y + wide * samples.y, z_mm=z, direction=direction, wavelength_nm=wave
    )
    return rays, samples.weight * np.pi * wide**2 * source[2]


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
        Share of the light that the detector reflects like a mirror; silicon 0.1 to 0.3.
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
        A detector reflectance outside 0 ... 1, a wavelength that a glass or coating is not known at, a measured lens,
        a source that the lens does not image.
    """
    lens.check_surfaces()
    if not 0.0 <= detector_reflectance <= 1.0:
        raise DomainError(f"detector_reflectance = {detector_reflectance:g}; it must lie in 0 ... 1")
    wave = lens.design_wavelength_nm if wavelength_nm is None else float(wavelength_nm)
    star = np.asarray(v_cam, dtype=np.float64)
    rays, entering = entering_rays(lens, star, wave, order)

    def follow(back: int | None, forward: int | None) -> GhostRays:
        return GhostPath(lens, back, forward, coating, absorption).trace(rays, entering, detector_reflectance)

    image, pairs = follow(None, None), ghost_pairs(lens)
    direct = float(image.weight.sum())
    if direct <= 0.0:
        raise DomainError(f"lens {lens.name!r}: no light of this source reaches the image plane")
    once = [follow(back, None) for back in range(len(lens.surfaces) + 1) if reflects(lens, back)]
    twice = [follow(*pair) for pair in pairs]
    light = [float(one.weight.sum()) for one in twice]
    rows = [
        (*pair, flux / direct, *_blur(one)) for pair, flux, one in zip(pairs, light, twice, strict=True) if flux > 0.0
    ]
    rows.sort(key=lambda row: -row[2])
    table = np.array(rows, dtype=np.float64).reshape(-1, 7).T
    absorbed = 1.0 - detector_reflectance
    x, y, _, _ = _blur(image)
    flows = [image, *once, *twice]
    return Ghosts(
        back=table[0].astype(int),
        forward=table[1].astype(int),
        flux=table[2],
        x_mm=table[3],
        y_mm=table[4],
        rms_mm=table[5],
        radius_mm=table[6],
        image_x_mm=x,
        image_y_mm=y,
        ledger=FluxLedger(
            image=absorbed * direct,
            ghosts=absorbed * sum(light),
            coatings=sum(one.lost["coatings"] for one in flows),
            glass=sum(one.lost["glass"] for one in flows),
            rims=sum(one.lost["rims"] for one in flows),
            front=sum(float(one.weight.sum()) for one in once),
            more=sum(one.lost["reflected"] for one in twice) + detector_reflectance * sum(light),
        ),
    )


def _blur(one: GhostRays) -> tuple[float, float, float, float]:
    """Centroid, RMS and largest distance from it of the rays that arrived [mm]."""
    lit = one.weight > 0.0
    weight = one.weight[lit] / one.weight[lit].sum()
    x, y = one.rays.x[lit], one.rays.y[lit]
    middle_x, middle_y = float(weight @ x), float(weight @ y)
    distance = np.hypot(x - middle_x, y - middle_y)
    return middle_x, middle_y, float(np.sqrt(weight @ distance**2)), float(distance.max())
