"""The beam of a star as the apertures of the lens cut it out: its outline in the launch plane, and points inside.

About an inner point, the chief ray's if that gets through, the outline is one radius per azimuth: the one at which a
ray touches the rim of an aperture, the stop's or another's. It is found by false position within a bracket; a ray that
misses a surface counts as outside. Inside the outline points lie by Gauss-Legendre in the square of the relative radius
and evenly in azimuth (Stroud 1971, *Approximate Calculation of Multiple Integrals*, sec. 2.6). Where the stop alone
limits the beam the outline is smooth and this converges as fast as `optics.rays.pupil.gauss_disk`; a kink, where
another aperture takes over, costs its change of slope times the square of the step in azimuth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import NUMPY, BoolArray, FloatArray, IntArray
from optics.errors import ConvergenceError
from optics.frames import light_direction
from optics.lens.system import LensSystem
from optics.rays.paraxial import axial_paraxial
from optics.rays.program import compile_lens
from optics.rays.trace import OK, VIGNETTED, Rays, trace_program
from optics.records import freeze

__all__ = ["Beams", "find_beams"]


AIM_STEPS, AIM_TOLERANCE, AIM_DIFFERENCE = 12, 1e-7, 1e-4
"""Newton steps towards the stop's centre; residual and difference of the slopes in radii of the stop. The centre only
has to lie inside."""
RIM_STEPS, RIM_TOLERANCE = 60, 1e-8
"""Steps of false position; residual in radii of the aperture."""
WIDEST = 64.0
"""In paraxial pupil radii: a beam wider than this has no edge."""
SCAN = 41
"""Rays along each side of the grid that looks for a beam whose chief ray does not get through."""
NODES = 4
"""Most wavelengths at which outlines are found; a polynomial in 1/wavelength^2 leads to the others."""
SMOOTH = 1e-4
"""Relative amplitude of the highest harmonic of an outline's radius below which it counts as smooth."""
LEAST_ARMS, FINER = 16, 8
"""Fewest azimuths, and how many times as many there are where outlines have kinks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """Points inside the beams of f stars at w wavelengths.

    Attributes
    ----------
    z_mm : float
        Launch plane, in the lens frame.
    x_mm, y_mm : (f, w, n)
        Where rays are launched.
    area_mm2 : (f, w, n)
        Part of the plane that each ray stands for; their sum is the beam's cross-section there, 0 where none passes.
    """

    z_mm: float
    x_mm: FloatArray
    y_mm: FloatArray
    area_mm2: FloatArray

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("x_mm", "y_mm", "area_mm2"):
            freeze(self, name, shape=("f", "w", "n"), sizes=sizes)


class _Apertures:
    """How near rays come to the rims of a lens."""

    def __init__(self, lens: LensSystem) -> None:
        self.program, theta = compile_lens(lens)
        self.theta = NUMPY.parameters(theta)
        self.stop = lens.stop_index
        self.radius = {i: s.semi_diameter_mm for i, s in enumerate(lens.surfaces) if np.isfinite(s.semi_diameter_mm)}
        first = axial_paraxial(lens, lens.design_wavelength_nm)
        near = np.isfinite(first.entrance_pupil_z_mm) and np.isfinite(first.entrance_pupil_radius_mm)
        self.z_mm = float(first.entrance_pupil_z_mm if near else lens.surfaces[0].position_mm[2])
        self.scale_mm = float(first.entrance_pupil_radius_mm if near else max(self.radius.values(), default=math.inf))
        if not (near or self.radius):
            raise ConvergenceError(f"lens {lens.name!r} has no aperture that limits a beam")
        self.unit_mm = self.radius.get(self.stop, self.scale_mm)

    def trace(
        self, x: FloatArray, y: FloatArray, direction: FloatArray, wave: FloatArray
    ) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
        """Largest height (...) of rays on any aperture in radii of it, infinite where they miss; on which; the stop."""
        highest, which, stop = np.zeros(x.shape), np.full(x.shape, -1), np.zeros((2, *x.shape))

        def visit(number: int, rays: Rays) -> None:
            if number == self.stop:
                stop[:] = rays.x, rays.y
            if number in self.radius:
                height = np.hypot(rays.x, rays.y) / self.radius[number]
                which[height > highest] = number
                np.maximum(highest, height, out=highest)  # NaN stays NaN

        rays = Rays.create(x_mm=x, y_mm=y, z_mm=self.z_mm, direction=direction, wavelength_nm=wave)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            status = trace_program(self.program, self.theta, rays, NUMPY, visit).status
        through = np.isfinite(highest) & ((status == OK) | (status == VIGNETTED))
        return np.where(through, highest, np.inf), which, stop[0] / self.unit_mm, stop[1] / self.unit_mm


def find_beams(lens: LensSystem, v_cam: FloatArray, wavelength_nm: ArrayLike, *, rings: int, arms: int) -> Beams:
    """Points inside the beams of stars.

    Parameters
    ----------
    lens : LensSystem
        The lens; may be perturbed. Apertures with holes are the caller's affair: outlines know outer rims only.
    v_cam : (f, 3)
        Unit vectors towards the stars in cam.
    wavelength_nm : (w,)
        Wavelengths [nm].
    rings, arms : int
        Radii and azimuths; more azimuths where an outline is not smooth.

    Raises
    ------
    DomainError
        If a wavelength is outside the range of one of the glasses.
    ConvergenceError
        If nothing limits a beam.
    """
    wavelength_nm = np.asarray(wavelength_nm, float)
    lens.check_wavelength(wavelength_nm)
    apertures = _Apertures(lens)
    picks, factors = _picks(wavelength_nm)
    direction = np.repeat(light_direction(v_cam)[:, None], len(picks), axis=1)
    wave = np.broadcast_to(picks, direction.shape[:2])
    centre, lit = _centres(apertures, direction, wave)
    count = max(arms, LEAST_ARMS)
    radius, rim = _outline(apertures, centre, lit, direction, wave, count)
    harmonic = np.abs(np.fft.rfft(radius, axis=-1))[..., -2:].max(-1) * 2.0 / count
    if (harmonic > SMOOTH * np.maximum(radius.mean(-1), 1e-300)).any():
        count *= FINER
        radius, rim = _outline(apertures, centre, lit, direction, wave, count)
    share = _shares(radius, rim)
    radius = np.where(lit[..., None], radius, 0.0)
    radius, share, centre = (np.einsum("wp,fpm->fwm", factors, v) for v in (radius, share, centre))
    node, weight = np.polynomial.legendre.leggauss(rings)
    part = np.sqrt(0.5 * (1.0 + node))[:, None]
    azimuth = _azimuth(count)
    reach = radius[..., None, :] * part
    x, y = (centre[..., axis, None, None] + reach * v for axis, v in enumerate((np.cos(azimuth), np.sin(azimuth))))
    area = (radius**2 * share)[..., None, :] * (0.5 * weight[:, None] * np.pi / count)
    shape = (*radius.shape[:2], rings * count)
    return Beams(z_mm=apertures.z_mm, x_mm=x.reshape(shape), y_mm=y.reshape(shape), area_mm2=area.reshape(shape))


def _azimuth(count: int) -> FloatArray:
    """Equidistant azimuths [rad]; for multiples of four points lie symmetrically about both axes."""
    return 2.0 * np.pi * (np.arange(count) + 0.5) / count


def _shares(radius: FloatArray, rim: IntArray) -> FloatArray:
    """Weights (f, p, m) of the azimuths, 1 where the outline is smooth.

    At a kink between two azimuths, a steps after the first and b before the second, the sum of a periodic function is
    short of the integral by (a b / 2 - 1 / 12) times the drop of its slope per step: the triangle above the chord, less
    the end terms of the Euler-Maclaurin formula on both sides. The slopes are those of the steps beside it.
    """
    before, after, beyond = (np.roll(radius, -k, axis=-1) - np.roll(radius, -k + 1, axis=-1) for k in (0, 1, 2))
    bend = before - beyond
    aperture = [np.roll(rim, -k, axis=-1) for k in (-1, 0, 1, 2)]
    kink = (aperture[0] == aperture[1]) & (aperture[1] != aperture[2]) & (aperture[2] == aperture[3])
    with np.errstate(invalid="ignore", divide="ignore"):
        a = (after - beyond) / bend  # where the tangents meet, in steps
    kink &= (a > 0.0) & (a < 1.0)
    more = np.where(kink, 0.5 * a * (1.0 - a) - 1.0 / 12.0, 0.0)
    share = np.ones(radius.shape)
    for offset, sign in ((-1, -1.0), (0, 1.0), (1, 1.0), (2, -1.0)):
        share += sign * np.roll(more, offset, axis=-1)
    return share


def _picks(wavelength_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Wavelengths (p,) at which outlines are found, and factors (w, p) that lead from these to all."""
    distinct = np.unique(wavelength_nm)
    if len(distinct) <= NODES:
        return distinct, (wavelength_nm[:, None] == distinct).astype(float)
    t = np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    low, high = distinct[-1] ** -2.0, distinct[0] ** -2.0
    at = 0.5 * (low + high) + 0.5 * (high - low) * t
    here = wavelength_nm**-2.0
    factors = np.ones((len(wavelength_nm), NODES))
    for p in range(NODES):
        for other in np.delete(at, p):
            factors[:, p] *= (here - other) / (at[p] - other)
    return np.clip(at**-0.5, distinct[0], distinct[-1]), factors


def _centres(apertures: _Apertures, direction: FloatArray, wave: FloatArray) -> tuple[FloatArray, BoolArray]:
    """A point (f, p, 2) inside each beam, and whether there is one (f, p)."""
    x, y = np.zeros(wave.shape), np.zeros(wave.shape)
    h = AIM_DIFFERENCE * apertures.scale_mm
    highest, _, u, v = apertures.trace(x, y, direction, wave)
    for _ in range(AIM_STEPS):
        if not (np.hypot(u, v) > AIM_TOLERANCE).any():
            break
        _, _, ux, vx = apertures.trace(x + h, y, direction, wave)
        _, _, uy, vy = apertures.trace(x, y + h, direction, wave)
        a, b, c, d = (ux - u) / h, (uy - u) / h, (vx - v) / h, (vy - v) / h
        with np.errstate(invalid="ignore", divide="ignore"):
            dx, dy = -(d * u - b * v) / (a * d - b * c), -(a * v - c * u) / (a * d - b * c)
        going = np.isfinite(dx + dy) & (np.hypot(x + dx, y + dy) < WIDEST * apertures.scale_mm)
        x, y = np.where(going, x + dx, x), np.where(going, y + dy, y)
        highest, _, u, v = apertures.trace(x, y, direction, wave)
    lit = np.asarray(highest < 1.0)
    if not lit.all():
        where = np.nonzero(~lit)
        x[where], y[where], lit[where] = _scanned(apertures, direction[where], wave[where])
    return np.stack([x, y], axis=-1), lit


def _scanned(
    apertures: _Apertures, direction: FloatArray, wave: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Mean launch point (n,) of those rays of a grid that get through, and whether any does."""
    reach = 1.5 * apertures.scale_mm
    for _ in range(4):
        side = reach * np.linspace(-1.0, 1.0, SCAN)
        x, y = (np.broadcast_to(v.ravel(), (len(wave), SCAN * SCAN)) for v in np.meshgrid(side, side))
        through = apertures.trace(x, y, direction[:, None], wave[:, None])[0] < 1.0
        count = through.sum(1)
        if (count > 0).all():
            break
        reach *= 2.0
    share = through / np.maximum(count, 1)[:, None]
    return (share * x).sum(1), (share * y).sum(1), count > 0


def _outline(
    apertures: _Apertures, centre: FloatArray, lit: BoolArray, direction: FloatArray, wave: FloatArray, arms: int
) -> tuple[FloatArray, IntArray]:
    """Radius (f, p, arms) [mm] of each outline about its centre, and the surface whose rim it is.

    False position with the Illinois rule; bisection where a ray misses a surface.
    """
    cosine, sine = np.cos(_azimuth(arms)), np.sin(_azimuth(arms))
    shape = (*wave.shape, arms)
    x0, y0, c, s, colour = (
        np.broadcast_to(v, shape).ravel() for v in (centre[..., :1], centre[..., 1:], cosine, sine, wave[..., None])
    )
    towards = np.broadcast_to(direction[:, :, None], (*shape, 3)).reshape(-1, 3)
    open_ = np.flatnonzero(np.broadcast_to(lit[..., None], shape).ravel())

    def excess(lanes: IntArray, radius: FloatArray) -> FloatArray:
        x, y = x0[lanes] + radius * c[lanes], y0[lanes] + radius * s[lanes]
        return apertures.trace(x, y, towards[lanes], colour[lanes])[0] - 1.0

    low, high = np.zeros(len(x0)), np.full(len(x0), np.nan)
    at_low, at_high = np.full(len(x0), -1.0), np.full(len(x0), np.inf)
    at_low[open_] = excess(open_, low[open_])
    lanes, reach = open_, 1.05 * apertures.scale_mm
    while len(lanes):
        if reach > WIDEST * apertures.scale_mm:
            raise ConvergenceError(f"rays pass even {reach:.1f} mm from the axis; no aperture limits the beam")
        value = excess(lanes, np.full(len(lanes), reach))
        outside = value >= 0.0
        high[lanes[outside]], at_high[lanes[outside]] = reach, value[outside]
        low[lanes[~outside]], at_low[lanes[~outside]] = reach, value[~outside]
        lanes, reach = lanes[~outside], 1.5 * reach
    lanes = open_
    side = np.zeros(len(x0))  # where the last step ended: -1 inside, +1 outside
    for _ in range(RIM_STEPS):
        lo, hi, f, g = low[lanes], high[lanes], at_low[lanes], at_high[lanes]
        with np.errstate(invalid="ignore"):
            trial = (lo * g - hi * f) / (g - f)
        trial = np.where(np.isfinite(g), trial, 0.5 * (lo + hi))
        value = excess(lanes, trial)
        inside = value < 0.0
        twice = np.where(inside, side[lanes] < 0, side[lanes] > 0)
        low[lanes], at_low[lanes] = np.where(inside, trial, lo), np.where(inside, value, np.where(twice, 0.5 * f, f))
        high[lanes], at_high[lanes] = np.where(inside, hi, trial), np.where(inside, np.where(twice, 0.5 * g, g), value)
        side[lanes] = np.where(inside, -1.0, 1.0)
        done = np.abs(value) < RIM_TOLERANCE
        low[lanes[done]] = trial[done]
        done |= high[lanes] - low[lanes] < RIM_TOLERANCE * apertures.scale_mm
        lanes = lanes[~done]
        if not len(lanes):
            break
    rim = np.full(len(x0), -1)
    at = low[open_]
    rim[open_] = apertures.trace(x0[open_] + at * c[open_], y0[open_] + at * s[open_], towards[open_], colour[open_])[1]
    return low.reshape(shape), rim.reshape(shape)
