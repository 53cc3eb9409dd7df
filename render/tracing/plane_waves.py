"""Plane waves of the rays of stars, traced on Dr.Jit, and their sum over windows of the detector.

The method is that of `optics.waves.pupil_field`; here lengths are pixels and the light is counted in shares of what a
star sends into the launch disk, as everywhere in this package. With ``u`` a point of the unit disk and ``f`` the
spatial frequency [cycles/px] of the wave that the ray from there is, the field at X is

    U(X) = sum_j pi w_j sqrt(J_j) exp{ 2 pi i [t_j + f_j (X - x_j)] },   J = |df / du|,   share per px^2 = |U|^2 / pi

U holds no frequency beyond the aperture of the light, |U|^2 none beyond twice that: U is summed at little more than its
own rate of sampling and interpolated to that of |U|^2, which leaves a quarter of the terms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import i0e

from optics.arrays import BoolArray, FloatArray
from optics.rays.trace import OK, VIGNETTED, trace_program
from render.engine.jit import dr
from render.tracing.kernel import Shade, StarKernel
from render.tracing.pupil_points import PupilPoints

__all__ = [
    "BandLimited",
    "FieldSampling",
    "PixelTable",
    "PlaneWaves",
    "hidden_points",
    "phase_changes",
    "trace_waves",
    "window_light",
    "window_samples",
]


DIFFERENCE = 2e-4
"""Distance of the rays whose directions give the Jacobian, in radii of the launch disk."""
FIELD_RATE = 1.5
"""Samples of U per cycle of its highest frequency and px, over the least that would do."""
LIGHT_RATE = 2.3
"""The same for |U|^2, whose integrals over pixels follow from the samples."""
KERNEL_ERROR = 1e-6
"""At which the kernel of a pixel ends."""
TAPS = 8.0
"""How far the interpolation of U reaches, in cycles of the highest frequency of |U|^2: errors of 1e-6."""

ComplexArray = NDArray[np.complexfloating]


@dataclass(frozen=True, slots=True)
class PlaneWaves:
    """Rays of s stars in b bands at k wavelengths, p of each; arrays (s, b, k, p).

    Attributes
    ----------
    x, y : array
        Landing points [px].
    fx, fy : array
        Spatial frequency of the plane wave [cycles/px].
    turns : array
        Optical path in vacuum wavelengths, from a plane wavefront.
    amplitude : array
        ``w sqrt(J)``; 0 for lost rays.
    weight : array
        Shares of the launch disk; 0 for lost rays.
    lost : (s, b, k)
        Share of the launched light that these points stand for and that is lost.
    """

    x: FloatArray
    y: FloatArray
    fx: FloatArray
    fy: FloatArray
    turns: FloatArray
    amplitude: FloatArray
    weight: FloatArray
    lost: FloatArray

    @property
    def mean(self) -> FloatArray:
        """Mean landing point (s, b, k, 2) [px]: the centroid of all light of every wavelength's image."""
        with np.errstate(invalid="ignore"):
            light = self.weight.sum(-1)
            return np.stack([(self.weight * v).sum(-1) / light for v in (self.x, self.y)], axis=-1)

    @property
    def highest(self) -> FloatArray:
        """Highest spatial frequency (s,) along an axis of the images' intensity [cycles/px]."""
        return self._spans().max((1, 2))

    @property
    def lowest_cutoff(self) -> FloatArray:
        """The same of the longest wavelength (s,), which makes the widest image."""
        return self._spans().min((1, 2))

    def _spans(self) -> FloatArray:
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
    """Trace the plane waves of some stars of a kernel.

    Parameters
    ----------
    kernel : StarKernel
        Holds the stars, each in one direction.
    pupil : PupilPoints
        Points of the launch disk for each of the k nodes.
    wavelength_nm, image_index : (b, k)
        Wavelengths, and the index of the image space at each.
    stars : (s,)
        Which stars.
    coverage : (s, b, k, p), optional
        Which part of the area that a point stands for gets through the lens; all of it, where the ray does, if left
        out.
    """
    F, U = kernel.F, kernel.U
    shape = (len(stars), len(wavelength_nm), wavelength_nm.shape[1], pupil.count)
    variant, point, node, slot = kernel.numbered(5 * math.prod(shape), shape[2], shape[3], 5)
    star, wavelength = kernel.light_of(slot, node, wavelength_nm, stars)
    px, py, weight = pupil.sample(kernel.types, slot, node, point)
    steps = np.array([(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]) * DIFFERENCE
    px, py = (p + dr.gather(F, F(np.ascontiguousarray(steps[:, i])), variant) for i, p in enumerate((px, py)))
    error = kernel.error_of(slot, node, wavelength_nm)
    start = kernel.rays(star, px, py, wavelength, error)
    ambient = kernel.program.media[kernel.program.steps[0].before].index(kernel.theta, wavelength, kernel.xp)
    phase = ambient * _launch_path(kernel, star, px, py, error)
    out = trace_program(kernel.program, kernel.theta, start, kernel.xp)
    path = out.opl_mm + phase
    ok = U((out.status == OK) if coverage is None else (out.status == OK) | (out.status == VIGNETTED))
    dr.eval(out.x, out.y, out.dx, out.dy, path, ok, weight)

    def every(values: object) -> FloatArray:
        return np.asarray(values.numpy()).reshape(*shape, 5)  # type: ignore[attr-defined]

    pitch, (cx, cy) = kernel.geometry.pitch_mm, kernel.geometry.centre_px
    per_px = (image_index * (pitch * 1e6) / wavelength_nm)[..., None]
    fx, fy = every(out.dx), every(out.dy)
    jacobian = np.abs((fx[..., 1] - fx[..., 2]) * (fy[..., 3] - fy[..., 4])
                      - (fx[..., 3] - fx[..., 4]) * (fy[..., 1] - fy[..., 2])) / (4.0 * DIFFERENCE**2)  # fmt: skip
    arrived = every(ok)[..., 0] > 0
    arrived &= np.isfinite(jacobian)
    weights = every(weight)[..., 0]
    lit = np.where(arrived, weights if coverage is None else weights * coverage, 0.0)

    def kept(values: FloatArray) -> FloatArray:
        return np.where(lit > 0.0, values[..., 0], 0.0)

    return PlaneWaves(
        x=np.where(lit > 0.0, cx + every(out.x)[..., 0] / pitch, 0.0),
        y=np.where(lit > 0.0, cy - every(out.y)[..., 0] / pitch, 0.0),
        fx=kept(fx) * per_px,
        fy=-kept(fy) * per_px,
        turns=kept(every(path)) * (1e6 / wavelength_nm)[..., None],
        amplitude=lit * np.sqrt(np.where(lit > 0.0, jacobian, 0.0)) * per_px,
        weight=lit,
        lost=(weights - lit).sum(-1),
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
    """Largest change of phase along a radius of the pupil [rad], and per radian around it, (s,), over a circle.

    Parameters
    ----------
    waves : PlaneWaves
        On rings x azimuths points, azimuths last.
    order : (int, int)
        These numbers.
    radius_px : (s,) or float
        Of the circle about each mean landing point.
    """
    mean = np.nan_to_num(waves.mean)[..., None, :]
    lit = (waves.weight > 0.0).reshape(*waves.weight.shape[:3], *order)
    radial, around = np.zeros(len(lit)), np.zeros(len(lit))
    radius = np.reshape(radius_px, (-1, 1, 1, 1))
    for angle in np.arange(8) * (np.pi / 4.0):
        dx, dy = (radius * f(angle) for f in (math.cos, math.sin))
        turns = waves.turns + waves.fx * (mean[..., 0] + dx - waves.x) + waves.fy * (mean[..., 1] + dy - waves.y)
        phase = 2.0 * np.pi * turns.reshape(lit.shape)
        along = np.where(lit[..., 1:, :] & lit[..., :-1, :], np.abs(np.diff(phase, axis=-2)), 0.0).sum(-2)
        turn = np.where(lit & np.roll(lit, -1, -1), np.abs(np.roll(phase, -1, -1) - phase), 0.0)
        radial = np.maximum(radial, along.max((1, 2, 3)))
        around = np.maximum(around, turn.max((1, 2, 3, 4)) * (order[1] / (2.0 * np.pi)))
    return radial, around


@lru_cache(maxsize=64)
def _roll_off(nodes: int, low: float, high: float, reach_px: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies of a Gauss rule on (0, high), and its weights times a smooth step from 1 at low to 0 at high.

    The step is the integral of the Kaiser-Bessel window whose transform has fallen off at the reach.
    """
    node, weight = np.polynomial.legendre.leggauss(nodes)
    f = 0.5 * high * (1.0 + node)
    t = np.linspace(-1.0, 1.0, 4001)
    window = _window(t, math.pi * (high - low) * reach_px)
    fall = 1.0 - np.concatenate([[0.0], np.cumsum(0.5 * (window[1:] + window[:-1]))]) / np.sum(
        0.5 * (window[1:] + window[:-1])
    )
    step = np.interp((f - low) / (0.5 * (high - low)) - 1.0, t, fall, left=1.0, right=0.0)
    return f, 0.5 * high * weight * step


def _window(t: FloatArray, beta: float) -> FloatArray:
    """Kaiser-Bessel window at t in [-1, 1], scaled to 1 in the middle."""
    root = np.sqrt(np.maximum(1.0 - t * t, 0.0))
    return np.asarray(i0e(beta * root) / i0e(beta) * np.exp(beta * (root - 1.0)))


@dataclass(frozen=True, slots=True)
class BandLimited:
    """A box convolved with a Gaussian, its spectrum ended smoothly between two frequencies; 0 beyond its reach.

    Integrals of a function without frequencies above ``low``, sampled at no less than ``low + high``, are sums with
    this kernel, but for exp(-pi (high - low) reach). A box of width 0 stands for a point: interpolation.

    Attributes
    ----------
    low, high : float
        Frequencies [cycles/px].
    reach_px : float
        Where it ends.
    box_px, sigma_px : float
        Width of the box, standard deviation of the Gaussian.
    """

    low: float
    high: float
    reach_px: float
    box_px: float = 0.0
    sigma_px: float = 0.0

    def __call__(self, distance_px: FloatArray) -> FloatArray:
        """Values at distances from its centre."""
        distance = np.abs(distance_px)
        values = _spline(self)(np.minimum(distance, self.reach_px))
        return np.where(distance < self.reach_px, values, 0.0)


@lru_cache(maxsize=64)
def _spline(kernel: BandLimited) -> CubicSpline:
    """The kernel on a table of 60 points per cycle of its highest frequency."""
    high, reach = kernel.high, kernel.reach_px
    f, weight = _roll_off(64 + 16 * math.ceil(reach * high), kernel.low, high, reach)
    spectrum = weight * np.exp(-2.0 * (np.pi * kernel.sigma_px * f) ** 2)
    if kernel.box_px > 0.0:
        spectrum = spectrum * kernel.box_px * np.sinc(kernel.box_px * f)
    table = np.linspace(0.0, reach, 8 + math.ceil(reach * 60.0 * high))
    return CubicSpline(table, 2.0 * (np.cos(2.0 * np.pi * np.outer(table, f)) @ spectrum))


@dataclass(frozen=True, slots=True)
class FieldSampling:
    """How the fields of a camera's stars are sampled.

    Attributes
    ----------
    highest : float
        Highest frequency of the intensity [cycles/px].
    """

    highest: float

    @property
    def field_step(self) -> float:
        """Distance of the samples of U [px]."""
        return 1.0 / (FIELD_RATE * self.highest)

    @property
    def light_step(self) -> float:
        """Distance of the samples of |U|^2 [px]."""
        return 1.0 / math.ceil(LIGHT_RATE * self.highest)

    def pixel(self, box_px: float, sigma_px: float) -> BandLimited:
        """Kernel that makes light on pixels or cells, after diffusion, of samples of |U|^2."""
        high = 1.0 / self.light_step - self.highest
        left = math.exp(-2.0 * (math.pi * sigma_px * high) ** 2) / (math.pi * high)
        tail = math.log(max(left, KERNEL_ERROR) / KERNEL_ERROR) / (math.pi * (high - self.highest))
        reach = max(0.5 * box_px + 5.5 * sigma_px + 0.5, tail)
        return BandLimited(self.highest, high, reach, box_px, sigma_px)

    def table(self, sigma_px: float) -> PixelTable:
        """Weights of samples for pixels that lie anywhere between them."""
        return _pixel_table(self, sigma_px)


@dataclass(frozen=True, slots=True, eq=False)
class PixelTable:
    """Kernel of a pixel as a table, for many windows.

    Attributes
    ----------
    values : (n,)
        Share of a sample's light, against its distance from the middle of a pixel.
    step_px : float
        Of the table.
    pad_px : float
        Margin of samples around a window.
    """

    values: FloatArray
    step_px: float
    pad_px: float

    def __call__(self, centre_px: FloatArray, sample_px: FloatArray, shift_px: FloatArray) -> NDArray[np.float32]:
        """Weights (s, n, m) for pixels at n centres of m samples that are shifted by s distances."""
        distance = np.abs(centre_px[:, None] - sample_px - shift_px[:, None, None]) / self.step_px
        index = np.minimum(distance.astype(np.int64), len(self.values) - 2)
        part = np.minimum(distance - index, 1.0)
        return np.asarray(self.values[index] * (1.0 - part) + self.values[index + 1] * part, np.float32)


@cache
def _pixel_table(field: FieldSampling, sigma_px: float) -> PixelTable:
    kernel = field.pixel(1.0, sigma_px)
    step = 1.0 / 2048.0
    distance = np.asarray(np.arange(math.ceil(kernel.reach_px / step) + 2) * step, np.float64)
    values = kernel(distance) * field.light_step
    values[-1] = 0.0
    return PixelTable(values, step, kernel.reach_px - 0.5)


@cache
def _interpolation(
    field: FieldSampling, window_px: float, pad_px: float
) -> tuple[FloatArray, FloatArray, NDArray[np.float32]]:
    """Where U is summed (j,) and |U|^2 wanted (i,), from the window's corner, and what leads from one to the other."""
    step, fine = field.field_step, field.light_step
    count = math.ceil((window_px + 2.0 * pad_px) / fine)
    to = (np.arange(count) - 0.5 * (count - 1)) * fine + 0.5 * window_px
    reach = TAPS / field.highest
    many = math.ceil((window_px + 2.0 * (pad_px + reach)) / step)
    at = (np.arange(many) - 0.5 * (many - 1)) * step + 0.5 * window_px
    low = 0.5 * field.highest
    weights = BandLimited(low, 1.0 / step - low, reach)(to[:, None] - at)
    return np.asarray(at, np.float64), np.asarray(to, np.float64), (weights * step).astype(np.float32)


def _powers(frequency: FloatArray, start: float, step: float, count: int) -> NDArray[np.complex64]:
    """exp(2 pi i f (start + n step)) as (f, n), by products of two short tables."""
    inner = max(1, round(math.sqrt(count)))
    outer = -(-count // inner)

    def table(turns: FloatArray) -> NDArray[np.complex64]:
        angle = ((turns - np.rint(turns)) * (2.0 * np.pi)).astype(np.float32)
        result = np.empty(turns.shape, np.complex64)
        np.cos(angle, out=result.real)
        np.sin(angle, out=result.imag)
        return result

    coarse = table(np.outer(frequency, start + step * inner * np.arange(outer)))
    near = table(np.outer(frequency, step * np.arange(inner)))
    return (coarse[:, :, None] * near[:, None, :]).reshape(len(frequency), -1)[:, :count]


def window_samples(field: FieldSampling, window_px: float, pad_px: float) -> FloatArray:
    """Where `window_light` gives the light, along either axis, from the window's corner [px]."""
    return _interpolation(field, window_px, pad_px)[1]


def window_light(
    waves: PlaneWaves,
    at: tuple[int, int],
    shares: FloatArray,
    corner_px: FloatArray,
    window_px: float,
    field: FieldSampling,
    *,
    pad_px: float,
) -> NDArray[np.float32]:
    """Light per px^2 (i, i) of one star and band on the samples of a window, rows first.

    Parameters
    ----------
    waves : PlaneWaves
        Traced.
    at : (int, int)
        Star and band.
    shares : (k,)
        Share of each wavelength.
    corner_px : (2,)
        Outer corner (column, row) of the window.
    window_px, pad_px : float
        Size of the window and of a margin around it.
    field : FieldSampling
        Sampling.
    """
    points, to, up = _interpolation(field, window_px, pad_px)
    step, count = field.field_step, len(points)
    light = np.zeros((len(to), len(to)), np.float32)
    for k, share in enumerate(shares):
        lit = waves.amplitude[*at, k] > 0.0
        if not (share > 0.0 and lit.any()):
            continue
        x, y, fx, fy, turns, amplitude = (
            v[*at, k][lit] for v in (waves.x, waves.y, waves.fx, waves.fy, waves.turns, waves.amplitude)
        )
        fx, fy, bent = _untilted(fx, fy, x, y, turns, corner_px + points[0])
        coefficient = (amplitude * math.sqrt(math.pi * share)) * np.exp(2j * np.pi * bent)
        left, right = (_powers(f, 0.0, step, count) for f in (fy, fx))
        right *= coefficient.astype(np.complex64)[:, None]
        u = up @ (left.T @ right) @ up.T
        light += u.real**2 + u.imag**2
    return light


def _untilted(
    fx: FloatArray, fy: FloatArray, x: FloatArray, y: FloatArray, turns: FloatArray, origin: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies about the middle of their range, which leaves |U| as it is, and phases at the origin [turns]."""
    phase = turns + fx * (origin[0] - x) + fy * (origin[1] - y)
    middle = [0.5 * (f.min() + f.max()) for f in (fx, fy)]
    phase = phase - phase[0]
    return fx - middle[0], fy - middle[1], phase - np.rint(phase)
