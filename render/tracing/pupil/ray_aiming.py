"""Pupils of lenses with an inner stop: chief rays and beam outlines by ray aiming at the apertures.

A star's beam crosses the launch disk in a region whose outline is the image of the stop through the front of the lens,
or consists of arcs of several apertures. About the chief ray's launch point the outline is one radius per azimuth, the
smallest at which a ray touches an aperture. The height of a ray on a surface is nearly proportional to that radius, so
that a secant iteration in units of the aperture's radius, for every surface separately with the nearest crossing taken,
reaches rounding after a few steps. Launch points are in units of the launch disk's radius.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from optics.arrays import BoolArray, FloatArray, IntArray
from optics.frames import light_direction
from optics.lens.apertures import Circle
from optics.lens.system import LensSystem, Surface
from optics.rays.program import LensProgram
from optics.rays.ray_aiming import aim_at_stop, up_to_surface, without_apertures, without_obscurations
from optics.rays.trace import OK, VIGNETTED, Rays, trace_program
from render.engine import Engine
from render.engine.jit import dr
from render.engine.upload import uploaded
from render.tracing.rays.kernel import StarKernel

AIM_STEPS, AIM_TOLERANCE, AIM_DIFFERENCE = 6, 1e-11, 1e-5
"""Newton steps, residual and difference of the slopes, both in radii of the launch disk."""
WIDE_RAD = np.radians(15.0)
"""Field angle beyond which chief rays are aimed on NumPy, from the axis outwards (`optics.rays.ray_aiming`)."""
RIM_STEPS, RIM_TOLERANCE = 14, 1e-12
"""Secant steps and residual in units of the aperture's radius."""
INSIDE = 1e-7
"""How far inside its outline a ray is launched that has to get through the lens."""
FIRST_RADIUS, WIDEST = 0.8, 64.0
"""In radii of the launch disk: where the search begins; an outline wider than this is none."""


@dataclass(frozen=True, slots=True)
class AimedLens:
    """A lens compiled for aiming."""

    system: LensSystem
    front: LensProgram  # The lens up to its stop, without apertures
    full: LensProgram  # All of the lens
    theta: Any  # Parameters of both
    stop: int  # Number of the stop
    limits: tuple[tuple[int, float], ...]  # Number and radius [mm] of every clear aperture, with the stop's
    holes: tuple[tuple[int, float], ...]  # Of every central obscuration; both are empty with apertures of other shapes


@dataclass(frozen=True, slots=True)
class Chiefs:
    """Chief rays of n stars in b bands at one wavelength each."""

    points: FloatArray  # (n, b, 2) Launch points, in radii of the launch disk; NaN where the aim fails
    x_px: FloatArray  # (n, b) Columns where they land, ignoring rims of apertures; NaN where they do not
    y_px: FloatArray  # (n, b) Rows
    blocked: BoolArray  # (n, b) Whether the rim of an aperture stops them

    @property
    def position_px(self) -> FloatArray:
        """Columns and rows (n, b, 2)."""
        return np.stack([self.x_px, self.y_px], axis=-1)

    def take(self, stars: IntArray) -> Chiefs:
        """Some of the stars."""
        return Chiefs(self.points[stars], self.x_px[stars], self.y_px[stars], self.blocked[stars])


@dataclass(frozen=True, slots=True)
class Rims:
    """Outlines of the beams of n stars in b bands at k nodes, at m azimuths about the chief's launch point."""

    radius: FloatArray  # (n, b, k, m) Of the outline, in radii of the launch disk; NaN where none was found
    # (a, n, b, k, m) Heights of the ray that touches the outline on every aperture, in units of its radius; for an
    # outline by the stop alone (a = 1) the largest on the others
    height: FloatArray
    # (n, b, k, m) Whether the iteration ended on an aperture and the ray gets through when it is moved in by `INSIDE`
    good: BoolArray


def aimed_lens(lens: LensSystem, program: LensProgram, theta: FloatArray) -> AimedLens:
    """A lens, compiled as it is traced, ready for aiming."""
    limits = [(i, float(s.semi_diameter_mm)) for i, s in enumerate(lens.surfaces) if np.isfinite(s.semi_diameter_mm)]
    holes = [(i, hole) for i, surface in enumerate(lens.surfaces) if (hole := _hole_mm(surface)) > 0.0]
    if not all(np.isfinite(hole) for _, hole in holes):
        limits, holes = [], []
    front = up_to_surface(without_apertures(program), lens.stop_index)
    numbers = Engine.active().arrays.parameters(theta.tolist())
    return AimedLens(lens, front, program, numbers, lens.stop_index, tuple(limits), tuple(holes))


def _hole_mm(surface: Surface) -> float:
    """Radius of the circle about a surface's vertex that stops light, infinite if an aperture is of another shape."""
    radii = [surface.inner_semi_diameter_mm]
    for aperture in surface.apertures:
        centred = isinstance(aperture, Circle) and aperture.obscures and aperture.centre_mm == (0.0, 0.0)
        radii.append(aperture.radius_mm if isinstance(aperture, Circle) and centred else math.inf)
    return max(radii)


def find_chiefs(
    lens: AimedLens, kernel: StarKernel, wavelength_nm: FloatArray, points: FloatArray | None = None
) -> Chiefs:
    """Aim at the stop's centre: Newton's method in two unknowns with slopes from differences.

    Rays far from the axis, and those for which that does not end soon, are aimed by
    `optics.rays.ray_aiming.aim_at_stop`.
    """
    # wavelength_nm (b,), points (n, b, 2)
    F, shape = kernel.F, (kernel.count, len(wavelength_nm))
    band, star = kernel.numbered(kernel.count * shape[1], shape[1])
    wavelength = dr.gather(F, F(wavelength_nm), band)
    error = kernel.error_of(dr.arange(kernel.U, len(star)), dr.opaque(kernel.U, 0), wavelength_nm[:, None])
    if points is None:
        points = _aimed(lens, kernel, wavelength_nm)
    px, py = (uploaded(F, points[..., axis]) for axis in (0, 1))
    x, y, free = kernel.launch(star, px, py, wavelength, error, without_apertures(lens.full))
    status = kernel.launch(star, px, py, wavelength, error, without_obscurations(lens.full))[2]
    dr.eval(x, y, free, status)
    arrived, stopped = (v.numpy().reshape(shape) for v in (free, status))
    landed = np.isfinite(points).all(-1) & (arrived == OK)
    column, row = (np.where(landed, v.numpy().reshape(shape), np.nan) for v in (x, y))
    return Chiefs(points, column, row, blocked=landed & (stopped == VIGNETTED))


def _aimed(lens: AimedLens, kernel: StarKernel, wavelength_nm: FloatArray) -> FloatArray:
    """Launch points (n, b, 2) of chief rays, NaN without."""
    F, shape = kernel.F, (kernel.count, len(wavelength_nm))
    band, star = kernel.numbered(kernel.count * shape[1], shape[1])
    wavelength = dr.gather(F, F(wavelength_nm), band)
    h = dr.opaque(F, AIM_DIFFERENCE)
    unit = dr.opaque(F, 1.0 / kernel.geometry.pupil_radius_mm)

    def at_stop(px: Any, py: Any) -> tuple[Any, Any]:
        position: list[Any] = []

        def visit(number: int, rays: Rays) -> None:
            if number == lens.stop:
                position.extend((rays.x * unit, rays.y * unit))

        trace_program(lens.front, lens.theta, kernel.rays(star, px, py, wavelength), kernel.xp, visit)
        return position[0], position[1]

    def step(px: Any, py: Any, error: Any, steps: Any) -> tuple[Any, Any, Any, Any]:
        (u, v), right, up = at_stop(px, py), at_stop(px + h, py), at_stop(px, py + h)
        a, b, c, d = right[0] - u, up[0] - u, right[1] - v, up[1] - v
        scale = h / (a * d - b * c)
        return px - (d * u - b * v) * scale, py - (a * v - c * u) * scale, u * u + v * v, steps - 1

    zero, ones = dr.zeros(F, len(star)), dr.full(F, 1.0, len(star))
    px, py, error, _ = dr.while_loop(
        (zero, zero, ones, dr.full(kernel.I, AIM_STEPS, len(star))),
        lambda px, py, error, steps: (steps > 0) & (error > AIM_TOLERANCE**2),
        step,
        mode="symbolic",
    )
    dr.eval(px, py, error)
    points = np.stack([v.numpy().reshape(shape) for v in (px, py)], axis=-1)
    near = kernel.direction[:, 0, 2] >= np.cos(WIDE_RAD)
    aimed = (error.numpy().reshape(shape) <= AIM_TOLERANCE**2) & near[:, None]
    points[~aimed] = _aimed_outwards(lens, kernel, wavelength_nm, *np.nonzero(~aimed))
    return points


def _aimed_outwards(
    lens: AimedLens, kernel: StarKernel, wavelength_nm: FloatArray, stars: IntArray, bands: IntArray
) -> FloatArray:
    """Launch points (m, 2) of the chief rays of some pairs of stars and bands; NaN without."""
    if not len(stars):
        return np.zeros((0, 2))
    x0, y0, _ = kernel.geometry.pupil_mm
    rays = aim_at_stop(lens.system, light_direction(kernel.direction[stars, 0]), wavelength_nm[bands])
    points = np.stack([rays.x_mm - x0, rays.y_mm - y0], axis=-1) / kernel.geometry.pupil_radius_mm
    return np.where(rays.converged[:, None], points, np.nan)


class OutlineSearch:
    """Rays along azimuths about launch points, one lane per star, band, wavelength and azimuth; outlines of beams.

    The k nodes of the azimuths are c wavelengths at every time of the kernel, which holds the stars.
    """

    def __init__(
        self,
        lens: AimedLens,
        kernel: StarKernel,
        chief: FloatArray,
        wavelength_nm: FloatArray,
        azimuth: FloatArray,
        stars: IntArray | None = None,
    ) -> None:
        # chief (n, b, 2), wavelength_nm (b, c), azimuth (k, m) or (n, b, k, m) [rad], stars (n,)
        F, U = kernel.F, kernel.U
        self.circles = dict(lens.limits)
        nodes, arms = azimuth.shape[-2:]
        self.shape = (*chief.shape[:2], nodes, arms)
        self.lens, self.kernel = lens, kernel
        arm, node, slot = kernel.numbered(int(np.prod(self.shape)), nodes, arms)
        which = None if stars is None else stars.astype(np.uint32)
        self.star, self.wavelength = kernel.light_of(slot, node, wavelength_nm, which)
        self.cx, self.cy = (dr.gather(F, uploaded(F, chief[..., i]), slot) for i in (0, 1))
        at = dr.arange(U, len(arm)) if azimuth.ndim == 4 else node * dr.opaque(U, arms) + arm
        self.sine, self.cosine = dr.sincos(dr.gather(F, uploaded(F, azimuth), at))

    def _heights(self, radius: Any, program: LensProgram, numbers: tuple[int, ...]) -> tuple[Rays, list[Any]]:
        """Rays at a radius, and their heights on surfaces in units of the apertures."""
        px, py = self.cx + radius * self.cosine, self.cy + radius * self.sine
        heights = {}

        def visit(number: int, rays: Rays) -> None:
            if number in numbers:
                unit = dr.opaque(self.kernel.F, 1.0 / self.circles[number])
                heights[number] = dr.sqrt(rays.x * rays.x + rays.y * rays.y) * unit

        rays = self.kernel.rays(self.star, px, py, self.wavelength)
        rays = trace_program(program, self.lens.theta, rays, self.kernel.xp, visit)
        return rays, [heights[number] for number in numbers]

    def _solve(self, program: LensProgram, numbers: tuple[int, ...]) -> tuple[Any, Any]:
        """First radius at which a ray touches one of the surfaces, and whether there is one."""
        F, count = self.kernel.F, int(np.prod(self.shape))

        def heights(radius: Any) -> list[Any]:
            return self._heights(radius, program, numbers)[1]

        def step(radius: Any, before: Any, steps: Any, at: list[Any], was: list[Any]) -> tuple[Any, ...]:
            run = radius - before
            following = 2.0 * dr.abs(radius) + FIRST_RADIUS  # where no height rises
            for now, then in zip(at, was, strict=True):
                rise = now - then
                reach = radius + (1.0 - now) * run / rise
                following = dr.select((rise * run > 0.0) & (reach < following), reach, following)
            return following, radius, steps - 1, heights(following), at

        def open_(radius: Any, before: Any, steps: Any, at: list[Any], was: list[Any]) -> Any:
            return (steps > 0) & (dr.abs(_largest(at) - 1.0) > RIM_TOLERANCE) & (radius != before) & (radius < WIDEST)

        start, first = dr.zeros(F, count), dr.full(F, FIRST_RADIUS, count)
        centre = heights(start)
        state = (first, start, dr.full(self.kernel.I, RIM_STEPS, count), heights(first), centre)
        radius, _, _, at, _ = dr.while_loop(state, open_, step, mode="symbolic")
        return radius, (dr.abs(_largest(at) - 1.0) < 1e3 * RIM_TOLERANCE) & (_largest(centre) < 1.0)

    def _rims(self, radius: Any, solved: Any, numbers: tuple[int, ...], largest: bool = False) -> Rims:
        """Fate of rays at these radii in the whole lens; heights on some surfaces, or the largest of them."""
        lens = self.lens
        rays, heights = self._heights(radius * (1.0 - INSIDE), lens.full, numbers)
        heights = [_largest(heights)] if largest and heights else heights  # a stop may be the only aperture
        good = solved & (rays.status == OK)
        dr.eval(radius, solved, good, *heights)
        height = np.stack([h.numpy().reshape(self.shape) for h in heights]) if heights else np.zeros((1, *self.shape))
        radius = np.where(solved.numpy().astype(bool), radius.numpy(), np.nan)
        return Rims(radius.reshape(self.shape), height, good.numpy().astype(bool).reshape(self.shape))

    def stop_rims(self) -> Rims:
        """Outlines as the stop alone would make them, and the heights of their rays on all other apertures."""
        lens = self.lens
        others = tuple(number for number, _ in lens.limits if number != lens.stop)
        return self._rims(*self._solve(lens.front, (lens.stop,)), others, largest=True)

    def rims(self) -> Rims:
        """Outlines of beams cut by all apertures."""
        numbers = tuple(number for number, _ in self.lens.limits)
        return self._rims(*self._solve(self.lens.full, numbers), numbers)

    def shadow(self) -> tuple[FloatArray, BoolArray]:
        """Inner outlines (n, b, k, m) of beams with a hole about the chief ray, and where they were found.

        They are found where the chief ray meets every circle of ``lens.holes`` inside, and a ray that is moved out by
        `INSIDE` gets through.
        """
        lens, self.circles = self.lens, dict(self.lens.holes)
        parts = [self._solve(without_apertures(lens.full), (number,)) for number, _ in lens.holes]
        radius = _largest([part for part, _ in parts])
        rays, _ = self._heights(radius * (1.0 + INSIDE), lens.full, ())
        self.circles = dict(lens.limits)
        good = rays.status == OK
        for _, solved in parts:
            good = good & solved
        dr.eval(radius, good)
        return radius.numpy().reshape(self.shape), good.numpy().astype(bool).reshape(self.shape)


def _largest(values: list[Any]) -> Any:
    """Elementwise maximum of a list of non-negative values; 0 of an empty one."""
    result = values[0] if values else 0.0
    for value in values[1:]:
        result = dr.maximum(result, value)
    return result
