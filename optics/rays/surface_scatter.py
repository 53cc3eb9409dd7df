r"""Scatter of the surfaces of a lens on its detector, for sources in or outside the field.

A deterministic sum. Rays that image a point p of the detector are traced over the pupil; where such a ray crosses
surface k, the ray of the source through the same point is searched (Newton in its launch plane), and the surface
scatters a part of its light into the imaging ray. With the radiance over n^2 conserved along rays, q the tangential
part of n times a direction, and S(q) the BSDF per such direction (`optics.light.bsdf`),

.. math::

   \frac{E(p)}{E_{in}} = \sum_{pupil} \frac{dA_\perp\, d\Omega}{dA_p} \; T_{k \to p} \; S(|q_{ray} - q_{source}|) \;
   T_{\to k} \cos\theta \left| \frac{\partial(u, v)}{\partial(x, y)_k} \right| |N_z|

where :math:`dA_\perp d\Omega / dA_p` is the throughput of the pupil element in object space, (u, v) the launch plane,
:math:`(x, y)_k` and N the vertex plane and normal of the surface. Light scattered back, scattered twice or inside glass
is neglected; so are walls and edges of the lens barrel. Ghosts: `optics.rays.ghosts.ghost_irradiance`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import BoolArray, FloatArray
from optics.errors import DomainError
from optics.frames import light_direction
from optics.glass.coating import Coating
from optics.lens.system import LensSystem
from optics.rays.ghosts import GhostPath, entrance_depth_mm, entrance_radius_mm, reflects
from optics.rays.trace import OK, TOTAL_REFLECTION, Rays, surface_normal, trace
from optics.rays.vignetted_pupil import vignetted_pupils

ScatterLaw = Callable[[FloatArray], FloatArray]
"""BSDF [1/sr] at differences of n times sine: the ``bsdf`` of a law of `optics.light.bsdf`."""
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
class _RaysOnSurface:
    """Rays (n,) on a surface; points in its vertex frame, directions in the lens frame."""

    x: FloatArray
    y: FloatArray
    before: FloatArray  # (3, n)
    after: FloatArray  # (3, n)
    light: FloatArray  # Fraction of the light behind the surface
    arrived: BoolArray  # Whether the ray gets to the surface and through its aperture


class _Attenuation:
    """Transmission and reflection of rays by the surfaces of a lens at one wavelength."""

    def __init__(self, lens: LensSystem, wave: float, coating: Coating | None, absorption: bool) -> None:
        self.lens, self.wave, self.coating, self.absorption = lens, wave, coating, absorption
        self.relative = lens.indices(wave) / lens.indices(wave)[0]

    def trace(self, rays: Rays, last: int | None = None) -> tuple[list[_RaysOnSurface], Rays]:
        """Rays on all surfaces up to the image, or up to a surface."""
        crossings: list[_RaysOnSurface] = []

        def visit(number: int, now: Rays, before: FloatArray, after: FloatArray, light: FloatArray) -> None:
            crossings.append(_RaysOnSurface(now.x, now.y, before, after, light, _reached(now, number)))

        lens = self.lens if last is None else _up_to(self.lens, last)
        path = GhostPath(lens, None, None, self.coating, self.absorption)
        return crossings, path.trace(rays, np.ones(np.shape(rays.x)), visit=visit).rays


def _reached(rays: Rays, number: int) -> BoolArray:
    """Whether rays got to a surface and through its aperture, refracted or totally reflected there."""
    return np.asarray((rays.status == OK) | ((rays.status == TOTAL_REFLECTION) & (rays.failed_at == number)))


def _up_to(lens: LensSystem, last: int) -> LensSystem:
    """The lens as far as a surface, on whose vertex the image plane lies."""
    surfaces = tuple(replace(surface, is_stop=at == 0) for at, surface in enumerate(lens.surfaces[: last + 1]))
    return replace(lens, surfaces=surfaces, image_position_mm=surfaces[-1].position_mm, image_rotation=np.eye(3))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImagingRays:
    """Rays over the pupil for each of p points of the detector, j each; made by `imaging_rays`."""

    lens: LensSystem
    x_mm: FloatArray  # (p,) Points, in the frame of the image plane
    y_mm: FloatArray
    throughput: FloatArray  # (p, j) Of each ray: area x solid angle in object space per area of the detector [sr]
    transmission: FloatArray  # (p, j) Of the entire lens, 0 for rays that do not arrive
    attenuation: _Attenuation
    crossings: tuple[_RaysOnSurface, ...]

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
    `optics.rays.vignetted_pupil.vignetted_pupils`. `DomainError` for a lens without surfaces, and beyond the field.
    """
    lens.check_surfaces()
    wave = lens.design_wavelength_nm if wavelength_nm is None else float(wavelength_nm)
    stars = np.asarray(v_cam, dtype=np.float64)
    pupils = vignetted_pupils(lens, stars, np.array([wave]), rings=rings, arms=arms)
    x0, y0, area = (v[:, 0] for v in (pupils.x_mm, pupils.y_mm, pupils.area_mm2))
    attenuation = _Attenuation(lens, wave, coating, absorption)

    def traced(directions: FloatArray) -> tuple[list[_RaysOnSurface], Rays]:
        direction = np.repeat(light_direction(directions), x0.shape[1], axis=0)
        return attenuation.trace(
            Rays.create(
                x_mm=x0.ravel(), y_mm=y0.ravel(), z_mm=pupils.z_mm, direction=direction, wavelength_nm=np.array(wave)
            )
        )

    crossings, arrived = traced(stars)
    ok = np.asarray(arrived.status == OK).reshape(x0.shape) & (area > 0.0)
    if not ok.any(axis=1).all():
        raise DomainError(f"lens {lens.name!r}: {int((~ok.any(axis=1)).sum())} of the directions are not imaged")
    weight = np.where(ok, area, 0.0)
    weight = weight / weight.sum(axis=1, keepdims=True)

    def centroid(rays: Rays) -> FloatArray:
        return np.stack([(weight * np.where(ok, v.reshape(ok.shape), 0.0)).sum(axis=1) for v in (rays.x, rays.y)])

    # scale of the image: two neighbours of every direction in X and in Y, with the same rays
    columns = []  # of the Jacobian
    for axis in (0, 1):
        tangent = np.zeros_like(stars)
        tangent[:, axis], tangent[:, 2] = 1.0, -stars[:, axis] / stars[:, 2]
        ends = [stars + sign * FIELD_STEP * tangent for sign in (1.0, -1.0)]
        columns.append(np.subtract(*(centroid(traced(v / np.linalg.norm(v, axis=1, keepdims=True))[1]) for v in ends)))
    scale = np.abs(columns[0][0] * columns[1][1] - columns[0][1] * columns[1][0])
    solid_angle = (2.0 * FIELD_STEP) ** 2 / stars[:, 2]  # dx dy of the direction cosines over z
    x, y = centroid(arrived)
    return ImagingRays(
        lens=lens,
        x_mm=x,
        y_mm=y,
        throughput=area * (stars[:, 2] * solid_angle / scale)[:, None],
        transmission=np.where(ok, crossings[-1].light.reshape(ok.shape), 0.0),
        attenuation=attenuation,
        crossings=tuple(crossings),
    )


def scattered_irradiance(
    imaging: ImagingRays, v_source: ArrayLike, laws: Mapping[str, Mapping[int, ScatterLaw]]
) -> dict[str, FloatArray]:
    """Scatter of a distant point source in front of the lens, unit vector (3,) in cam, by all its surfaces.

    ``laws``: cause -> number of a surface -> its law. Returns cause -> irradiance (p, k) on the points, over that of
    the source through a plane that faces it, by each surface.
    """
    source = np.asarray(v_source, dtype=np.float64)
    if not source[2] > 0.0:
        raise DomainError("a source at 90 deg or more from the boresight does not illuminate the lens")
    numbers = tuple(sorted({number for by_surface in laws.values() for number in by_surface}))
    for number in set(numbers) - set(scattering_surfaces(imaging.lens)):
        raise DomainError(f"{imaging.lens.label(number)} lies between equal media and does not scatter")
    shape = imaging.throughput.shape
    irradiance = {cause: np.zeros((shape[0], len(numbers))) for cause in laws}
    for at, number in enumerate(numbers):
        sine_difference, flux = _scattered(imaging, source, number)
        for cause, by_surface in laws.items():
            if number in by_surface:
                irradiance[cause][:, at] = (flux * by_surface[number](sine_difference)).reshape(shape).sum(axis=1)
    return irradiance


def _scattered(imaging: ImagingRays, source: FloatArray, number: int) -> tuple[FloatArray, FloatArray]:
    """Difference of n sine, and what a BSDF of 1 / sr would scatter, for all rays (p j,) at a surface."""
    lens, relative, rays = imaging.lens, imaging.attenuation.relative, imaging.crossings[number]
    n1 = relative[number]
    n2 = n1 if lens.surfaces[number].mirror else relative[number + 1]
    normal = surface_normal(n1, rays.before, n2, rays.after)
    lit, source_before, source_light, jacobian = _source_rays(imaging.attenuation, source, number, rays)
    transmission = imaging.transmission.ravel()
    difference = n2 * rays.after - n1 * source_before
    tangential = difference - normal * (difference * normal).sum(axis=0)
    tilt = np.abs(lens.surfaces[number].rotation[:, 2] @ normal)
    behind = transmission / np.where(rays.light > 0.0, rays.light, 1.0)
    in_front = 1.0 if number == 0 else np.maximum(imaging.crossings[number - 1].light, 1e-300)
    flux = imaging.throughput.ravel() * behind * (rays.light / in_front) * source_light * source[2] * jacobian * tilt
    valid = lit & (transmission > 0.0)
    return np.where(valid, np.linalg.norm(tangential, axis=0), 0.0), np.where(valid, flux, 0.0)


def _source_rays(
    attenuation: _Attenuation, source: FloatArray, number: int, target: _RaysOnSurface
) -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
    """The source's rays at points of a surface: whether they get there, direction before the surface (3, n), light in
    front of it, and d(u, v) / d(x, y); NaN where there is none."""
    lens, direction = attenuation.lens, light_direction(source)
    radius = entrance_radius_mm(lens)
    # the launch plane lies in front of all of the first surface
    centre = lens.surfaces[0].position_mm - direction / direction[2] * (entrance_depth_mm(lens) + 1.0)
    front = _up_to(lens, number)

    def launch(u: FloatArray, v: FloatArray) -> Rays:
        return Rays.create(
            x_mm=centre[0] + u, y_mm=centre[1] + v, z_mm=centre[2], direction=direction, wavelength_nm=attenuation.wave
        )

    def on_surface(u: FloatArray, v: FloatArray) -> Rays:
        """In its vertex frame."""
        visited: list[Rays] = []
        trace(front, launch(u, v), lambda _, now: visited.append(now))
        return visited[number]

    target_mm = np.stack([target.x, target.y])
    count = target_mm.shape[1]
    side = np.linspace(-1.0, 1.0, START) * 1.1 * radius
    u, v = (w.ravel() for w in np.meshgrid(side, side))
    grid = on_surface(u, v)
    finite = np.isfinite(grid.x) & np.isfinite(grid.y)
    used = finite & _reached(grid, number)
    if not used.any():
        return np.zeros(count, bool), np.zeros((3, count)), np.zeros(count), np.zeros(count)
    used = used if used.sum() >= 3 else finite
    affine = np.stack([grid.x, grid.y, np.ones_like(grid.x)], axis=-1)[used]
    coefficients, *_ = np.linalg.lstsq(affine, np.stack([u, v], axis=-1)[used], rcond=None)
    start_mm = (np.stack([*target_mm, np.ones(count)], axis=-1) @ coefficients).T
    determinant, active = np.full(count, np.nan), np.arange(count)
    with np.errstate(all="ignore"):
        for _ in range(NEWTON_STEPS):
            u, v = start_mm[:, active]
            shifted = on_surface(np.concatenate([u, u + STEP_MM, u]), np.concatenate([v, v, v + STEP_MM]))
            point, right, up = np.split(np.stack([shifted.x, shifted.y]), 3, axis=1)
            dx, dy = (right - point) / STEP_MM, (up - point) / STEP_MM
            determinant[active] = d = dx[0] * dy[1] - dx[1] * dy[0]
            residual = target_mm[:, active] - point
            open_ = ~(np.hypot(*residual) < NEWTON_MM) & np.isfinite(residual).all(axis=0)
            step = np.stack([residual[0] * dy[1] - residual[1] * dy[0], dx[0] * residual[1] - dx[1] * residual[0]]) / d
            step = np.nan_to_num(step * np.minimum(1.0, radius / np.maximum(np.linalg.norm(step, axis=0), 1e-300)))
            start_mm[:, active] += np.where(open_, step, 0.0)
            active = active[open_ & (np.hypot(*start_mm[:, active]) < FAR * radius)]
            if not len(active):
                break
        crossings, _ = attenuation.trace(launch(*start_mm), number)
    final = crossings[number]
    distance = np.hypot(final.x - target_mm[0], final.y - target_mm[1])
    reached = np.isfinite(distance) & (distance < 1e3 * NEWTON_MM)
    light = crossings[number - 1].light if number else np.ones(count)
    jacobian = np.where(reached, 1.0 / np.abs(np.where(determinant == 0.0, np.nan, determinant)), np.nan)
    return reached & final.arrived, final.before, light, jacobian
