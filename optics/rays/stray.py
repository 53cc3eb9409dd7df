r"""Stray light of a lens on its detector: scatter of every surface, and ghosts, for sources in or outside the field.

**Scatter** is a deterministic sum. Rays that image a point p of the detector are traced over the pupil; where such a
ray crosses surface k, the ray of the source through the same point is looked for (Newton in the plane where it starts),
and the surface turns a part of its light into the imaging ray. With the radiance over n^2 kept along rays, q the
tangential part of n times a direction, and S(q) the BSDF per such direction (`optics.light.scatter`),

.. math::

   \frac{E(p)}{E_{in}} = \sum_{pupil} \frac{dA_\perp\, d\Omega}{dA_p} \; T_{k \to p} \; S(|q_{ray} - q_{source}|) \;
   T_{\to k} \cos\theta \left| \frac{\partial(u, v)}{\partial(x, y)_k} \right| |N_z|

where :math:`dA_\perp d\Omega / dA_p` is the throughput of the pupil element in object space, (u, v) the plane of start,
:math:`(x, y)_k` and N the vertex plane and normal of the surface. Light scattered back, scattered twice or inside glass
is neglected; so are walls and edges of the lens barrel.

**Ghosts** are those of `optics.rays.ghosts`, traced for light over the whole first surface.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.frames import light_direction
from optics.glass.coating import Coating
from optics.lens.system import LensSystem
from optics.rays.beam import find_beams
from optics.rays.ghosts import GhostPath, entrance_radius_mm, front_rays, ghost_pairs, reflects, trace_ghost
from optics.rays.trace import OK, TOTAL_REFLECTION, Rays, trace

ScatterLaw = Callable[[FloatArray], FloatArray]
"""BSDF [1/sr] at differences of n times sine: the ``bsdf`` of a law of `optics.light.scatter`."""
NEWTON_STEPS, NEWTON_MM, FAR = 10, 1e-6, 6.0
"""Steps towards a point of a surface, the distance at which it is reached, and how many radii of the entrance away from
the axis the search is given up."""
STEP_MM = 1e-4
START = 15
"""Rays along each side of the grid that the search starts from."""
FIELD_STEP = 1e-4
"""Of direction cosines, for the scale of the image."""


def scattering_surfaces(lens: LensSystem) -> list[int]:
    """Numbers of the surfaces between two media, and of mirrors."""
    return [number for number, surface in enumerate(lens.surfaces) if surface.mirror or reflects(lens, number)]


@dataclass(frozen=True, slots=True, eq=False)
class _Crossing:
    """Rays (n,) on a surface; points in its vertex frame, directions in the lens frame."""

    x: FloatArray
    y: FloatArray
    before: FloatArray  # (3, n)
    after: FloatArray  # (3, n)
    share: FloatArray  # Light that is left behind the surface
    arrived: np.typing.NDArray[np.bool_]  # Whether the ray gets to the surface and through its aperture


class _Light:
    """Light that the surfaces of a lens transmit and reflect at one wavelength."""

    def __init__(self, lens: LensSystem, wave: float, coating: Coating | None, absorption: bool) -> None:
        self.lens, self.wave, self.coating, self.absorption = lens, wave, coating, absorption
        self.relative = lens.indices(wave) / lens.indices(wave)[0]

    def follow(self, rays: Rays) -> tuple[list[_Crossing], Rays]:
        """All crossings up to the image."""
        found = list[_Crossing]()

        def seen(number: int, now: Rays, before: FloatArray, after: FloatArray, share: FloatArray) -> None:
            got = (now.status == OK) | ((now.status == TOTAL_REFLECTION) & (now.failed_at == number))
            found.append(_Crossing(now.x, now.y, before, after, share, np.asarray(got)))

        path = GhostPath(self.lens, None, None, self.coating, self.absorption)
        return found, path.trace(rays, np.ones(np.shape(rays.x)), seen=seen).rays


def _at_surface(lens: LensSystem, rays: Rays) -> Rays:
    """Rays on the last surface of a lens, in its vertex frame."""
    kept: list[Rays] = []
    trace(lens, rays, lambda _, now: kept.append(now))
    return kept[len(lens.surfaces) - 1]


def _up_to(lens: LensSystem, last: int) -> LensSystem:
    """The lens as far as a surface, on whose vertex the image plane lies."""
    surfaces = tuple(replace(one, is_stop=at == 0) for at, one in enumerate(lens.surfaces[: last + 1]))
    return replace(lens, surfaces=surfaces, image_position_mm=surfaces[-1].position_mm, image_rotation=np.eye(3))


# --- Rays that image points of the detector


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImagingRays:
    """Rays over the pupil for each of p points of the detector, j each; made by `imaging_rays`."""

    lens: LensSystem
    wavelength_nm: float
    x_mm: FloatArray  # (p,) Points, in the frame of the image plane
    y_mm: FloatArray
    throughput: FloatArray  # (p, j) Of each ray: area x solid angle in object space per area of the detector [sr]
    transmission: FloatArray  # (p, j) Of the whole lens, 0 for rays that do not arrive
    light: _Light
    crossings: tuple[_Crossing, ...]

    @property
    def irradiance(self) -> FloatArray:
        """Irradiance on the detector (p,) under a sky of unit radiance."""
        return np.asarray((self.throughput * self.transmission).sum(axis=1))


def imaging_rays(
    lens: LensSystem,
    v_cam: ArrayLike,
    *,
    wavelength_nm: float | None = None,
    coating: Coating | None = None,
    absorption: bool = True,
    rings: int = 4,
    arms: int = 10,
) -> ImagingRays:
    """Rays of the stars at unit vectors (p, 3) in cam, which stand for the points of the detector that they fall on.

    Wavelength, coating and absorption as of `optics.rays.ghosts.find_ghosts`; rings and arms of the pupil as of
    `optics.rays.beam.find_beams`. `DomainError` for a lens without surfaces that scatter, and beyond the field.
    """
    lens.check_surfaces()
    wave = lens.design_wavelength_nm if wavelength_nm is None else float(wavelength_nm)
    stars = np.asarray(v_cam, dtype=np.float64)
    beams = find_beams(lens, stars, np.array([wave]), rings=rings, arms=arms)
    x0, y0, area = (v[:, 0] for v in (beams.x_mm, beams.y_mm, beams.area_mm2))
    light = _Light(lens, wave, coating, absorption)

    def traced(directions: FloatArray) -> tuple[list[_Crossing], Rays]:
        along = np.repeat(light_direction(directions), x0.shape[1], axis=0)
        rays = Rays.create(
            x_mm=x0.ravel(), y_mm=y0.ravel(), z_mm=beams.z_mm, direction=along, wavelength_nm=np.full(x0.size, wave)
        )
        return light.follow(rays)

    crossings, arrived = traced(stars)
    shape = x0.shape
    ok = np.asarray(arrived.status == OK).reshape(shape) & (area > 0.0)
    if not ok.any(axis=1).all():
        raise DomainError(f"lens {lens.name!r}: {int((~ok.any(axis=1)).sum())} of the directions are not imaged")
    weight = np.where(ok, area, 0.0)
    weight = weight / weight.sum(axis=1, keepdims=True)

    def centroid(rays: Rays) -> FloatArray:
        return np.stack([(weight * np.where(ok, v.reshape(shape), 0.0)).sum(axis=1) for v in (rays.x, rays.y)])

    # scale of the image: two neighbours of every direction, with the same rays
    first = np.stack([np.ones(len(stars)), np.zeros(len(stars)), -stars[:, 0] / stars[:, 2]], axis=-1)
    second = np.stack([np.zeros(len(stars)), np.ones(len(stars)), -stars[:, 1] / stars[:, 2]], axis=-1)
    moved = []
    for along in (first, second):
        ends = [stars + sign * FIELD_STEP * along for sign in (-1.0, 1.0)]
        ends = [one / np.linalg.norm(one, axis=1, keepdims=True) for one in ends]
        moved.append(np.subtract(*(centroid(traced(one)[1]) for one in reversed(ends))))
    scale = np.abs(moved[0][0] * moved[1][1] - moved[0][1] * moved[1][0])
    solid = (2.0 * FIELD_STEP) ** 2 / stars[:, 2]  # dx dy of the direction cosines over z
    x, y = centroid(arrived)
    share = crossings[-1].share.reshape(shape)
    return ImagingRays(
        lens=lens,
        wavelength_nm=wave,
        x_mm=x,
        y_mm=y,
        throughput=area * (stars[:, 2] * solid / scale)[:, None],
        transmission=np.where(ok, share, 0.0),
        light=light,
        crossings=tuple(crossings),
    )


# --- Scatter


def lens_scatter_light(
    imaging: ImagingRays, v_source: ArrayLike, laws: Mapping[str, Mapping[int, ScatterLaw]]
) -> dict[str, FloatArray]:
    """Scatter of a distant point source in front of the lens, unit vector (3,) in cam, by all its surfaces.

    ``laws``: cause -> number of a surface -> its law. Returns cause -> irradiance (p, k) on the points, over that of
    the source through a plane that faces it, by each surface.
    """
    source = np.asarray(v_source, dtype=np.float64)
    if not source[2] > 0.0:
        raise DomainError("a source at 90 deg or more from the boresight does not illuminate the lens")
    known = scattering_surfaces(imaging.lens)
    numbers = tuple(sorted({number for one in laws.values() for number in one}))
    for number in set(numbers) - set(known):
        raise DomainError(f"{imaging.lens.label(number)} lies between equal media and does not scatter")
    shape = imaging.throughput.shape
    found = {cause: np.zeros((shape[0], len(numbers))) for cause in laws}
    for at, number in enumerate(numbers):
        delta, flux = _scattered(imaging, source, number)
        for cause, own in laws.items():
            if number in own:
                found[cause][:, at] = (flux * own[number](delta)).reshape(shape).sum(axis=1)
    return found


def _scattered(imaging: ImagingRays, source: FloatArray, number: int) -> tuple[FloatArray, FloatArray]:
    """Difference of n sine, and what a BSDF of 1 / sr would scatter, for all rays (p j,) at a surface."""
    light, lens, own = imaging.light, imaging.lens, imaging.crossings[number]
    n1, n2 = light.relative[number], light.relative[number + 1]
    mirror = lens.surfaces[number].mirror
    normal = (n1 if mirror else n2) * own.after - n1 * own.before
    normal = normal / np.maximum(np.linalg.norm(normal, axis=0), 1e-300)
    lit, (source_before, share, jacobian) = _meet(light, source, number, own)
    used = imaging.transmission.ravel() > 0.0
    n = n1 if mirror else n2
    ray, came = n * own.after, n1 * source_before
    apart = (ray - normal * (ray * normal).sum(axis=0)) - (came - normal * (came * normal).sum(axis=0))
    tilt = np.abs(lens.surfaces[number].rotation[:, 2] @ normal)
    behind = imaging.transmission.ravel() / np.where(own.share > 0.0, own.share, 1.0)
    own_share = own.share if number == 0 else own.share / np.maximum(imaging.crossings[number - 1].share, 1e-300)
    flux = imaging.throughput.ravel() * behind * own_share * share * source[2] * jacobian * tilt
    good = lit & used
    return np.where(good, np.linalg.norm(apart, axis=0), 0.0), np.where(good, flux, 0.0)


def _meet(
    light: _Light, source: FloatArray, number: int, own: _Crossing
) -> tuple[np.typing.NDArray[np.bool_], tuple[FloatArray, FloatArray, FloatArray]]:
    """The source's ray at points of a surface: whether it gets there, its direction before the surface (3, n), what
    is left of its light in front of it, and d(u, v) / d(x, y); NaN where it was not found.
    """  # fmt: skip
    lens, direction = light.lens, light_direction(source)
    radius = entrance_radius_mm(lens)
    first = lens.surfaces[0]
    # the plane of start lies in front of all of the first surface
    rim = np.array([0.0, radius])
    depth = float(np.nanmax(np.abs(np.nan_to_num(first.shape.sag(rim, 0.0 * rim))))) + 1.0
    centre = first.position_mm - direction / direction[2] * depth

    short = _up_to(lens, number)

    def launched(u: FloatArray, v: FloatArray) -> Rays:
        return Rays.create(
            x_mm=centre[0] + u, y_mm=centre[1] + v, z_mm=centre[2], direction=direction, wavelength_nm=light.wave
        )

    def through(u: FloatArray, v: FloatArray) -> FloatArray:
        there = _at_surface(short, launched(u, v))
        return np.stack([there.x, there.y])

    target = np.stack([own.x, own.y])
    count = target.shape[1]
    nothing = np.full(count, np.nan)
    unlit = np.zeros(count, bool), (np.zeros((3, count)), nothing, nothing)
    span = np.linspace(-1.0, 1.0, START) * 1.1 * radius
    u, v = (w.ravel() for w in np.meshgrid(span, span))
    there = _at_surface(short, launched(u, v))
    finite = np.isfinite(there.x) & np.isfinite(there.y)
    seen = finite & ((there.status == OK) | ((there.status == TOTAL_REFLECTION) & (there.failed_at == number)))
    if not seen.any():
        return unlit[0], (unlit[1][0], 0.0 * nothing, np.zeros(count))
    seen = seen if seen.sum() >= 3 else finite
    basis = np.stack([there.x, there.y, np.ones_like(there.x)], axis=-1)[seen]
    fit, *_ = np.linalg.lstsq(basis, np.stack([u, v], axis=-1)[seen], rcond=None)
    place = (np.stack([*target, np.ones(count)], axis=-1) @ fit).T
    determinant, active = np.full(count, np.nan), np.arange(count)
    with np.errstate(all="ignore"):
        for _ in range(NEWTON_STEPS):
            u, v = place[:, active]
            moved = through(np.concatenate([u, u + STEP_MM, u]), np.concatenate([v, v, v + STEP_MM]))
            here, right, up = np.split(moved, 3, axis=1)
            dx, dy = (right - here) / STEP_MM, (up - here) / STEP_MM
            determinant[active] = d = dx[0] * dy[1] - dx[1] * dy[0]
            miss = target[:, active] - here
            going = ~(np.hypot(*miss) < NEWTON_MM) & np.isfinite(miss).all(axis=0)
            step = np.stack([miss[0] * dy[1] - miss[1] * dy[0], dx[0] * miss[1] - dx[1] * miss[0]]) / d
            length = np.linalg.norm(step, axis=0)
            step = np.nan_to_num(step * np.minimum(1.0, radius / np.maximum(length, 1e-300)))
            place[:, active] += np.where(going, step, 0.0)
            active = active[going & (np.hypot(*place[:, active]) < FAR * radius)]
            if not len(active):
                break
        crossed, _ = _Light(short, light.wave, light.coating, light.absorption).follow(launched(*place))
    final = crossed[number]
    miss = np.hypot(final.x - target[0], final.y - target[1])
    reached = np.isfinite(miss) & (miss < 1e3 * NEWTON_MM)
    share = crossed[number - 1].share if number else np.ones(count)
    jacobian = np.where(reached, 1.0 / np.abs(np.where(determinant == 0.0, np.nan, determinant)), np.nan)
    return reached & final.arrived, (final.before, share, jacobian)


# --- Ghosts


def ghost_light(
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
    """Light that all pairs of reflections throw on a detector of half sizes ``half_mm``, source anywhere in front.

    Pair -> mean irradiance over that of the source through a plane that faces it, and its error as if rays were drawn.

    Parameters as of `optics.rays.ghosts.find_ghosts`; ``rings`` x ``arms`` rays fill the first surface.
    """
    lens.check_surfaces()
    if not 0.0 <= detector_reflectance <= 1.0:
        raise DomainError(f"detector_reflectance = {detector_reflectance:g}; it must lie in 0 ... 1")
    wave = lens.design_wavelength_nm if wavelength_nm is None else float(wavelength_nm)
    rays, area = front_rays(lens, v_source, wave, (rings, arms))
    weight = area / (4.0 * half_mm[0] * half_mm[1])
    found = {}
    for pair in ghost_pairs(lens):
        one = trace_ghost(
            lens,
            pair,
            rays,
            weight,
            coating=coating,
            detector_reflectance=detector_reflectance,
            absorption=absorption,
        )
        on = (one.weight > 0.0) & (np.abs(one.rays.x) <= half_mm[0]) & (np.abs(one.rays.y) <= half_mm[1])
        found[pair] = float(one.weight[on].sum()), float(np.sqrt((one.weight[on] ** 2).sum()))
    return found
