"""Plane waves of the rays of stars, traced on Dr.Jit, and their sum over windows of the detector.

The method is that of `optics.waves.pupil_field`; here lengths are pixels, and light is a fraction of what a star sends
into the launch disk, as everywhere in this package. With ``u`` a point of the unit disk and ``f`` the
spatial frequency [cycles/px] of the wave that the ray from there is, the field at X is

    U(X) = sum_j pi w_j sqrt(J_j) exp{ 2 pi i [t_j + f_j (X - x_j)] },   J = |df / du|,   light per px^2 = |U|^2 / pi

Rays between few traced ones follow from series (`WaveSeries`): directions, phases and amplitudes change smoothly over a
pupil whose outline is smooth, so that rays on some rings and azimuths determine a Fourier series in azimuth and
Legendre polynomials in radius. Sums over pupils need many more rays, which are cheaper to interpolate than to trace,
and fewer near the middle, where circles are short.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import BoolArray, FloatArray, IntArray
from optics.rays.trace import OK, VIGNETTED, trace_program
from render.engine.jit import dr
from render.engine.upload import uploaded
from render.tracing.pupil.outlines import rings
from render.tracing.pupil.points import PupilPoints
from render.tracing.rays.kernel import Shade, StarKernel

DIFFERENCE = 1e-6
"""Distance of the rays whose directions give the Jacobian, in radii of the launch disk."""

RayArrays = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""x, y, fx, fy, turns and amplitude of rays (p,) as in `PlaneWaves`."""


@dataclass(frozen=True, slots=True)
class PlaneWaves:
    """Rays of s stars in b bands at k wavelengths, p of each; arrays (s, b, k, p)."""

    x: FloatArray  # Columns of the landing points [px]
    y: FloatArray  # Rows
    fx: FloatArray  # Spatial frequency of the plane wave along columns [cycles/px]
    fy: FloatArray  # Along rows
    turns: FloatArray  # Optical path in vacuum wavelengths, from a plane wavefront
    amplitude: FloatArray  # ``w sqrt(J)``; 0 for lost rays
    weight: FloatArray  # Fractions of the launch disk times the transmission over that of the axis; 0 for lost rays
    lost: FloatArray  # (s, b, k) Fraction of the launched light that is lost at apertures
    clear: FloatArray  # (s, b, k) Fraction that apertures let through

    @property
    def mean(self) -> FloatArray:
        """Mean landing point (s, b, k, 2) [px]: the centroid of all light of every wavelength's image."""
        with np.errstate(invalid="ignore"):
            light = self.weight.sum(-1)
            return np.stack([(self.weight * v).sum(-1) / light for v in (self.x, self.y)], axis=-1)

    def take(self, stars: IntArray | BoolArray) -> PlaneWaves:
        """The same of some of the stars."""
        return PlaneWaves(*(getattr(self, field.name)[stars] for field in fields(self)))

    def rays(self, at: tuple[int, int], colour: int) -> RayArrays:
        """Rays of one star and band at one wavelength that get through."""
        lit = self.amplitude[*at, colour] > 0.0
        x, y, fx, fy, turns, amplitude = (
            v[*at, colour][lit] for v in (self.x, self.y, self.fx, self.fy, self.turns, self.amplitude)
        )
        return x, y, fx, fy, turns, amplitude

    @property
    def highest(self) -> FloatArray:
        """Highest spatial frequency (s, b) along an axis of the images' intensity [cycles/px]."""
        return self.spans().max(2)

    @property
    def lowest_cutoff(self) -> FloatArray:
        """The same of the longest wavelength (s,), which makes the widest image."""
        return self.spans().min((1, 2))

    def spans(self) -> FloatArray:
        lit = self.weight > 0.0
        spans = [np.where(lit, f, -np.inf).max(-1) - np.where(lit, f, np.inf).min(-1) for f in (self.fx, self.fy)]
        return np.asarray(np.where(lit.any(-1), np.maximum(*spans), 1.0))

    @property
    def spot_px(self) -> FloatArray:
        """Largest distance (s,) of a landing point from the mean of its wavelength."""
        mean = self.mean[..., None, :]
        distance = np.hypot(self.x - mean[..., 0], self.y - mean[..., 1])
        return np.asarray(np.where(self.weight > 0.0, distance, 0.0).max((1, 2, 3)))


def trace_waves(
    kernel: StarKernel,
    pupil: PupilPoints,
    wavelength_nm: FloatArray,
    image_index: FloatArray,
    stars: NDArray[np.uint32],
    coverage: FloatArray | None = None,
) -> PlaneWaves:
    """Trace the plane waves of some stars of a kernel."""
    # wavelength_nm, image_index (b, k), stars (s,), coverage (s, b, k, p)
    F, U = kernel.F, kernel.U
    shape = (len(stars), len(wavelength_nm), wavelength_nm.shape[1], pupil.count)
    variant, point, node, slot = kernel.numbered(3 * math.prod(shape), shape[2], shape[3], 3)
    star, wavelength = kernel.light_of(slot, node, wavelength_nm, stars)
    px, py, weight = pupil.sample(kernel.types, slot, node, point)
    steps = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]) * DIFFERENCE
    px, py = (p + dr.gather(F, uploaded(F, steps[:, i]), variant) for i, p in enumerate((px, py)))
    error = kernel.error_of(slot, node, wavelength_nm)
    start = kernel.rays(star, px, py, wavelength, error)
    transmission = kernel.ray_transmission(px, py, slot, node, wavelength_nm, stars)
    ambient = kernel.program.media[kernel.program.steps[0].before].index(kernel.theta, wavelength, kernel.xp)
    phase = ambient * _launch_path(kernel, star, px, py, error)
    out = trace_program(kernel.program, kernel.theta, start, kernel.xp)
    path = out.opl_mm + phase
    ok = U((out.status == OK) if coverage is None else (out.status == OK) | (out.status == VIGNETTED))
    dr.eval(out.x, out.y, out.dx, out.dy, path, ok, weight, transmission)

    def every(values: object) -> FloatArray:
        return np.asarray(values.numpy()).reshape(*shape, 3)  # type: ignore[attr-defined]

    pitch, (cx, cy) = kernel.geometry.pitch_mm, kernel.geometry.centre_px
    per_px = (image_index * (pitch * 1e6) / wavelength_nm)[..., None]
    fx, fy = every(out.dx), every(out.dy)
    (ax, bx), (ay, by) = ((f[..., 1] - f[..., 0], f[..., 2] - f[..., 0]) for f in (fx, fy))
    jacobian = np.abs(ax * by - bx * ay) / DIFFERENCE**2
    arrived = every(ok)[..., 0] > 0
    arrived &= np.isfinite(jacobian)
    weights = every(weight)[..., 0]
    clear = np.where(arrived, weights if coverage is None else weights * coverage, 0.0)
    relative = 1.0 if transmission is None else every(transmission)[..., 0]
    lit = clear * relative

    def of_lit(values: FloatArray) -> FloatArray:
        return np.where(lit > 0.0, values[..., 0], 0.0)

    return PlaneWaves(
        x=np.where(lit > 0.0, cx + every(out.x)[..., 0] / pitch, 0.0),
        y=np.where(lit > 0.0, cy - every(out.y)[..., 0] / pitch, 0.0),
        fx=of_lit(fx) * per_px,
        fy=-of_lit(fy) * per_px,
        turns=of_lit(every(path)) * (1e6 / wavelength_nm)[..., None],
        amplitude=clear * np.sqrt(np.where(lit > 0.0, jacobian * relative, 0.0)) * per_px,
        weight=lit,
        lost=(weights - clear).sum(-1),
        clear=clear.sum(-1),
    )


def _launch_path(kernel: StarKernel, star: Any, px: Any, py: Any, error: Any) -> Any:
    """Optical path over the index from the wavefront of a star, or of a source not quite at infinity, to a ray's start.

    With ``error`` (a, b and the vergence v) the light comes from a point 1 / v away: its distance less that of the
    disk's centre, in a form that stays exact when v goes to 0.
    """
    radius = kernel.disk[3]
    x, y = px * radius, py * radius
    dx, dy, dz = (dr.gather(kernel.F, component, star) for component in kernel.light)
    if error is None:
        return x * dx + y * dy
    a, b, vergence = dx + error[0], dy - error[1], error[2]
    near = dr.sqrt(a * a + b * b + dz * dz)
    here = dr.sqrt((a + vergence * x) ** 2 + (b + vergence * y) ** 2 + dz * dz)
    return (2.0 * (a * x + b * y) + vergence * (x * x + y * y)) / (near + here)


def hidden_points(kernel: StarKernel, shade: Shade, pupil: PupilPoints, stars: NDArray[np.uint32]) -> BoolArray:
    """Which points (s, p) of the launch disk do not see some of a kernel's stars; the same for every node."""
    point, position = kernel.numbered(len(stars) * pupil.count, pupil.count)
    px, py, _ = pupil.sample(kernel.types, position, dr.zeros(kernel.U, 1), point)
    star = dr.gather(kernel.U, kernel.U(stars), position)
    hidden = kernel.U(shade.hides(kernel.rays(star, px, py, kernel.F(0.0)), star))
    return np.asarray(hidden.numpy()).reshape(len(stars), pupil.count) > 0


def phase_changes(
    waves: PlaneWaves, order: tuple[int, int], radius_px: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Largest change of phase along a radius of the pupil [rad], and per radian around it, (s, b, k), over a circle."""
    # radius_px (s,)
    mean = np.nan_to_num(waves.mean)[..., None, :]
    lit = (waves.weight > 0.0).reshape(*waves.weight.shape[:3], *order)
    radial, around = (np.zeros(lit.shape[:3]) for _ in range(2))
    radius = np.reshape(radius_px, (-1, 1, 1, 1))
    for angle in np.arange(8) * (np.pi / 4.0):
        dx, dy = (radius * f(angle) for f in (math.cos, math.sin))
        turns = waves.turns + waves.fx * (mean[..., 0] + dx - waves.x) + waves.fy * (mean[..., 1] + dy - waves.y)
        phase = 2.0 * np.pi * turns.reshape(lit.shape)
        along = np.where(lit[..., 1:, :] & lit[..., :-1, :], np.abs(np.diff(phase, axis=-2)), 0.0).sum(-2)
        turn = np.where(lit & np.roll(lit, -1, -1), np.abs(np.roll(phase, -1, -1) - phase), 0.0)
        radial = np.maximum(radial, along.max(3))
        around = np.maximum(around, turn.max((3, 4)) * (order[1] / (2.0 * np.pi)))
    return radial, around


TAIL = 2e-6
"""Largest of the last coefficients of a series that is resolved: phase [turns], or fraction of the amplitude."""
REACH_PX = 25.0
"""Distance from the mean of the rays at which frequencies have to give phases that well."""
LAST_RINGS, LAST_TURNS = 2, 4
"""Coefficients at either end of a series by which it counts as resolved."""
ROUNDED = 16
"""Steps of the number of azimuths, so that few tables are needed."""


def azimuths(around: FloatArray) -> FloatArray:
    """Number of azimuths for a ring with a phase change per radian.

    Bessel functions J_m(x) vanish for m > x + some x^(1/3).
    """
    return np.asarray(around + 2.5 * np.cbrt(around) + 3.0)


def nodes_along(radial: FloatArray) -> FloatArray:
    """Number of rings for a radius with a phase change.

    The error of Gauss's rule of n nodes is of the order J_2n of half the change; with 5 nodes more than a quarter of
    the change it was 1e-4 of the light at 350 rad.
    """
    return np.asarray(radial / 4.0 + np.maximum(5.0, 1.6 * np.cbrt(radial / 2.0)))


@dataclass(frozen=True, slots=True, eq=False)
class WaveSeries:
    """Plane waves of s stars in b bands at k wavelengths."""

    # (s, b, k, rings, 4, turns) Of Legendre polynomials in the radius, and waves in azimuth, of the frequencies fx,
    # fy [cycles/px], of the phase about `mean` [turns] and of the amplitude per part of the pupil
    coefficient: NDArray[np.complex128]
    mean: FloatArray  # (s, b, k, 2) Mean landing point [px]
    resolved: BoolArray  # (s,) Whether the series end with small numbers

    @classmethod
    def of(cls, waves: PlaneWaves, order: tuple[int, int], turn: FloatArray) -> WaveSeries:
        """Series of traced waves."""
        # turn (k, rings)
        count, arms = order
        mean = waves.mean
        x0, y0 = mean[..., 0, None], mean[..., 1, None]
        phase = waves.turns + waves.fx * (x0 - waves.x) + waves.fy * (y0 - waves.y)
        with np.errstate(invalid="ignore"):
            density = waves.amplitude * arms / np.repeat(rings(count)[1], arms)
            values = np.stack([waves.fx, waves.fy, phase - phase[..., :1], density], axis=-2)
            values = values.reshape(*mean.shape[:3], 4, count, arms)
            rotation = np.exp(-2j * np.pi / arms * turn[:, :, None] * np.arange(arms // 2))
            spectrum = np.fft.rfft(values, axis=-1)[..., :-1] * (rotation[:, None] / arms)
            coefficient = np.ascontiguousarray(np.moveaxis(_legendre(count) @ spectrum, 4, 3))
            size = np.abs(coefficient)
            tail = np.maximum(size[:, :, :, -LAST_RINGS:].max((3, 5)), size[..., -LAST_TURNS:].max((3, 5)))
            scale = np.broadcast_to(np.array([REACH_PX, REACH_PX, 1.0, 1.0]), tail.shape).copy()
            scale[..., 3] = 1.0 / size[:, :, :, 0, 3, 0]
            good = (tail * scale < TAIL).all((1, 2, 3)) & (waves.weight > 0.0).all((1, 2, 3))
        return cls(coefficient, mean, np.asarray(good))

    def take(self, stars: BoolArray) -> WaveSeries:
        """The same of some of the stars."""
        return WaveSeries(self.coefficient[stars], self.mean[stars], self.resolved[stars])

    def rays(self, at: tuple[int, int], order: tuple[int, int], colour: int) -> RayArrays:
        """Rays of one star and band at one wavelength, on the rings and azimuths of an order at the rim."""
        (x, y), shape = self.mean[*at, colour], self.coefficient.shape[3:]
        spectrum = self.coefficient[*at, colour].view(np.float64).reshape(shape[0], -1)
        polynomials, weight, arms = _rings(order, shape[0])
        along = (polynomials @ spectrum).reshape(-1, shape[1], 2 * shape[2])
        parts = [along[part] @ _waves(shape[2], count) for count, part in arms]
        fx, fy, turns, amplitude = np.concatenate([np.moveaxis(p, 1, 0).reshape(shape[1], -1) for p in parts], axis=1)
        return np.full(len(fx), x), np.full(len(fx), y), fx, fy, turns, amplitude * weight


@cache
def _legendre(count: int) -> FloatArray:
    """Matrix from values at rings to coefficients of Legendre polynomials."""
    return np.asarray(np.linalg.inv(np.polynomial.legendre.legvander(2.0 * rings(count)[0] - 1.0, count - 1)))


@cache
def _waves(turns: int, arms: int) -> FloatArray:
    """Matrix (2 turns, arms): from real and imaginary parts of waves to values at equidistant azimuths."""
    turned = np.exp(2j * np.pi / arms * np.outer(np.arange(turns), np.arange(arms)))
    turned[1:] *= 2.0
    return np.stack([turned.real, -turned.imag], axis=1).reshape(2 * turns, arms)


@cache
def _rings(order: tuple[int, int], count: int) -> tuple[FloatArray, FloatArray, tuple[tuple[int, slice], ...]]:
    """Legendre polynomials (rings, count) at the rings of a sum, weights of rays, and numbers of azimuths of rings."""
    ring, weight = rings(order[0])
    around = np.linspace(0.0, order[1], 4 * order[1])
    wanted = azimuths(ring * np.interp(order[1], azimuths(around), around))
    arms = np.clip(ROUNDED * np.ceil(wanted / ROUNDED), ROUNDED, order[1]).astype(int)
    starts = np.flatnonzero(np.diff(arms, prepend=0))
    ends = [*starts[1:].tolist(), len(ring)]
    parts = tuple((int(arms[a]), slice(int(a), int(b))) for a, b in zip(starts, ends, strict=True))
    polynomials = np.polynomial.legendre.legvander(2.0 * ring - 1.0, count - 1)
    return np.asarray(polynomials, np.float64), np.repeat(weight / arms, arms), parts
