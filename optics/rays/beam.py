"""The beam of a star behind all apertures: its outline in the launch plane, and quadrature points inside.

About an inner point (the chief ray's, if the chief ray passes) the outline is one radius per azimuth, at which a ray
touches the rim of the stop or of another aperture. It is solved by false position within a bracket; a ray that misses a
surface counts as outside. Points inside follow Gauss-Legendre in the square of the relative radius and are equidistant
in azimuth (Peirce 1957, J. Soc. Indust. Appl. Math. 5, 66). If the stop alone limits the beam, the outline is smooth
and the quadrature converges as fast as `optics.rays.pupil.gauss_disk`; at a kink between two apertures its error is the
change of slope times the square of the azimuth step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import NUMPY, BoolArray, FloatArray, IntArray
from optics.errors import ConvergenceError
from optics.frames import light_direction
from optics.lens.system import LensSystem
from optics.rays.aim import aim_at_stop, aim_frame
from optics.rays.program import compile_lens
from optics.rays.trace import OK, VIGNETTED, Rays, trace_program
from optics.records import freeze

RIM_STEPS, RIM_TOLERANCE = 60, 1e-8
"""Steps of false position; residual in radii of the aperture."""
WIDEST = 64.0
"""In paraxial pupil radii: a beam wider than this has no edge."""
OUTWARDS = (0.25, 0.5, 0.7, 0.85, 0.95, 1.05)
"""Where the rim is looked for first, in these units; beyond in steps of a tenth: strongly aberrated rays from far out
may come back into the stop, and do not belong to the beam."""
SCAN = 41
"""Rays along each side of the grid that looks for a beam whose chief ray does not get through."""
NODES = 4
"""Most wavelengths at which outlines are found; a polynomial in 1/wavelength^2 leads to the others."""
SMOOTH = 1e-4
"""Relative amplitude of the highest harmonic of an outline's radius below which it counts as smooth."""
LEAST_ARMS, FINER = 16, 8
"""Fewest azimuths, and the factor by which they increase where outlines have kinks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """Points inside the beams of f stars at w wavelengths."""

    z_mm: float  # Launch plane, in the lens frame
    x_mm: FloatArray  # (f, w, n) Where rays are launched
    y_mm: FloatArray  # (f, w, n)
    # (f, w, n) Part of the plane that each ray stands for; their sum is the beam's cross-section there, 0 where none
    # passes
    area_mm2: FloatArray

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("x_mm", "y_mm", "area_mm2"):
            freeze(self, name, shape=("f", "w", "n"), sizes=sizes)


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamOutlines:
    """Outlines of the beams of f stars at p wavelengths in the plane of launch."""

    z_mm: float  # The plane, in the lens frame
    centre_mm: FloatArray  # (f, p, 2) A point inside each
    radius_mm: FloatArray  # (f, p, m) Distance of the outline from it at m equidistant azimuths (`_azimuth`)
    rim: IntArray  # (f, p, m) Number of the surface whose aperture ends it there
    lit: BoolArray  # (f, p) Whether any light gets through

    @property
    def x_mm(self) -> FloatArray:
        """Columns (f, p, m) of the outlines."""
        return np.asarray(self.centre_mm[..., :1] + self.radius_mm * np.cos(_azimuth(self.radius_mm.shape[-1])))

    @property
    def y_mm(self) -> FloatArray:
        """Rows (f, p, m) of the outlines."""
        return np.asarray(self.centre_mm[..., 1:] + self.radius_mm * np.sin(_azimuth(self.radius_mm.shape[-1])))


class _Apertures:
    """Distance of rays from the rims of a lens."""

    def __init__(self, lens: LensSystem) -> None:
        self.lens = lens
        self.program, theta = compile_lens(lens)
        self.theta = NUMPY.parameters(theta)
        self.radius = {i: s.semi_diameter_mm for i, s in enumerate(lens.surfaces) if np.isfinite(s.semi_diameter_mm)}
        self.frame = aim_frame(lens)
        self.z_mm, self.scale_mm = self.frame.z_mm, self.frame.scale_mm

    def trace(
        self, x: FloatArray, y: FloatArray, direction: FloatArray, wave: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Largest height (...) of rays on any aperture in radii of it, infinite where they miss, and on which."""
        highest, which = np.zeros(x.shape), np.full(x.shape, -1)

        def visit(number: int, rays: Rays) -> None:
            if number in self.radius:
                height = np.hypot(rays.x, rays.y) / self.radius[number]
                which[height > highest] = number
                np.maximum(highest, height, out=highest)  # NaN stays NaN

        rays = Rays.create(x_mm=x, y_mm=y, z_mm=self.z_mm, direction=direction, wavelength_nm=wave)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            status = trace_program(self.program, self.theta, rays, NUMPY, visit).status
        through = np.isfinite(highest) & ((status == OK) | (status == VIGNETTED))
        return np.where(through, highest, np.inf), which


def find_beams(lens: LensSystem, v_cam: FloatArray, wavelength_nm: ArrayLike, *, rings: int, arms: int) -> Beams:
    """Points inside the beams of stars.

    Shapes: ``v_cam`` (f, 3), ``wavelength_nm`` (w,).
    """
    wavelength_nm = np.asarray(wavelength_nm, float)
    picks, factors = _picks(wavelength_nm)
    count = max(arms, LEAST_ARMS)
    found = beam_outlines(lens, v_cam, picks, arms=count)
    harmonic = np.abs(np.fft.rfft(found.radius_mm, axis=-1))[..., -2:].max(-1) * 2.0 / count
    if (harmonic > SMOOTH * np.maximum(found.radius_mm.mean(-1), 1e-300)).any():
        count *= FINER
        found = beam_outlines(lens, v_cam, picks, arms=count)
    parts = found.radius_mm, _shares(found.radius_mm, found.rim), found.centre_mm
    radius, share, centre = (np.einsum("wp,fpm->fwm", factors, v) for v in parts)
    node, weight = np.polynomial.legendre.leggauss(rings)
    part = np.sqrt(0.5 * (1.0 + node))[:, None]
    azimuth = _azimuth(count)
    reach = radius[..., None, :] * part
    x, y = (centre[..., axis, None, None] + reach * v for axis, v in enumerate((np.cos(azimuth), np.sin(azimuth))))
    area = (radius**2 * share)[..., None, :] * (0.5 * weight[:, None] * np.pi / count)
    shape = (*radius.shape[:2], rings * count)
    return Beams(z_mm=found.z_mm, x_mm=x.reshape(shape), y_mm=y.reshape(shape), area_mm2=area.reshape(shape))


def beam_outlines(lens: LensSystem, v_cam: FloatArray, wavelength_nm: FloatArray, *, arms: int) -> BeamOutlines:
    """Outlines of beams at a number of azimuths; parameters and errors as `find_beams`."""
    lens.check_wavelength(wavelength_nm)
    apertures = _Apertures(lens)
    direction = np.repeat(light_direction(v_cam)[:, None], len(wavelength_nm), axis=1)
    wave = np.broadcast_to(wavelength_nm, direction.shape[:2])
    centre, lit = _centres(apertures, direction, wave)
    radius, rim = _outline(apertures, centre, lit, direction, wave, arms)
    return BeamOutlines(
        z_mm=apertures.z_mm, centre_mm=centre, radius_mm=np.where(lit[..., None], radius, 0.0), rim=rim, lit=lit
    )


def inner_points(lens: LensSystem, v_cam: FloatArray, wavelength_nm: FloatArray) -> tuple[FloatArray, BoolArray]:
    """A point (f, p, 2) of the plane of launch [mm] inside every beam, and whether there is one (f, p).

    It is the chief ray's, or where that is blocked the mean of rays that get through. Parameters as `find_beams`.
    """
    direction = np.repeat(light_direction(v_cam)[:, None], len(wavelength_nm), axis=1)
    return _centres(_Apertures(lens), direction, np.broadcast_to(wavelength_nm, direction.shape[:2]))


def _azimuth(count: int) -> FloatArray:
    """Equidistant azimuths [rad]; for multiples of four points lie symmetrically about both axes."""
    return 2.0 * np.pi * (np.arange(count) + 0.5) / count


def _shares(radius: FloatArray, rim: IntArray) -> FloatArray:
    """Weights (f, p, m) of the azimuths, 1 where the outline is smooth.

    At a kink between two azimuths, a steps after the first and b before the second, the sum of a periodic function is
    short of the integral by (a b / 2 - 1 / 12) times the drop of its slope per step: the triangle above the chord, less
    the end terms of the Euler-Maclaurin formula on both sides. The slopes are from the adjacent steps.
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
    aimed = aim_at_stop(apertures.lens, direction, wave)
    x, y = aimed.x_mm.copy(), aimed.y_mm.copy()
    lit = np.asarray(aimed.found & (apertures.trace(x, y, direction, wave)[0] < 1.0))
    if not lit.all():
        where = np.nonzero(~lit)
        x[where], y[where], lit[where] = _scanned(apertures, direction[where], wave[where], (x[where], y[where]))
    return np.stack([x, y], axis=-1), lit


def _scanned(
    apertures: _Apertures, direction: FloatArray, wave: FloatArray, about: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Mean launch point (n,) of those rays of a grid about a point that get through, and whether any does."""
    reach = 1.5 * apertures.scale_mm
    for _ in range(4):
        side = reach * np.linspace(-1.0, 1.0, SCAN)
        x, y = (centre[:, None] + v.ravel() for centre, v in zip(about, np.meshgrid(side, side), strict=True))
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
    """Radius (f, p, arms) [mm] of each outline about its centre, and the surface whose rim it is: false position
    (Illinois), bisection where a ray misses a surface."""
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
    lanes, steps = open_, iter(OUTWARDS)
    reach = 0.0
    while len(lanes):
        if reach > WIDEST * apertures.scale_mm:
            raise ConvergenceError(f"rays pass up to {reach:.1f} mm from the axis; no aperture limits the beam")
        reach = next(steps, 1.1 * reach / apertures.scale_mm) * apertures.scale_mm
        value = excess(lanes, np.full(len(lanes), reach))
        outside = value >= 0.0
        high[lanes[outside]], at_high[lanes[outside]] = reach, value[outside]
        low[lanes[~outside]], at_low[lanes[~outside]] = reach, value[~outside]
        lanes = lanes[~outside]
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
