"""Vignetted pupils: the beam of a star behind all apertures, its outline in the launch plane, quadrature points inside.

About an inner point (the chief ray's, if the chief ray passes) the outline is one radius per azimuth, at which a ray
touches the rim of the stop or of another aperture. It is solved by false position within a bracket; a ray that misses a
surface counts as outside. Points inside follow Gauss-Legendre in the square of the relative radius and are equidistant
in azimuth (Peirce 1957, J. Soc. Indust. Appl. Math. 5, 66). If the stop alone limits the beam, the outline is smooth
and the quadrature converges as fast as `optics.rays.pupil_sampling.gauss_disk`; at a kink between two apertures its
error is the change of slope times the square of the azimuth step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import NUMPY, BoolArray, FloatArray, IntArray
from optics.errors import ConvergenceError
from optics.frames import light_direction
from optics.lens.system import LensSystem
from optics.rays.program import compile_lens
from optics.rays.ray_aiming import aim_at_stop, aim_frame
from optics.rays.trace import OK, VIGNETTED, Rays, trace_program
from optics.records import freeze_alike

RIM_STEPS, RIM_TOLERANCE = 60, 1e-8
"""Steps of false position; residual in radii of the aperture."""
WIDEST = 64.0
"""In paraxial pupil radii: a beam wider than this has no edge."""
OUTWARDS = (0.25, 0.5, 0.7, 0.85, 0.95, 1.05)
"""Radii of the search for a bracket, in these units; beyond in steps of a tenth: strongly aberrated rays from far out
may come back into the stop, and do not belong to the beam."""
SCAN = 41
"""Rays along each side of the grid that looks for a beam whose chief ray does not get through."""
NODES = 4
"""Most wavelengths at which outlines are traced; a polynomial in 1/wavelength^2 leads to the others."""
SMOOTH = 1e-4
"""Relative amplitude of the highest harmonic of an outline's radius below which it counts as smooth."""
LEAST_ARMS, FINER = 16, 8
"""Fewest azimuths, and the factor by which they increase where outlines have kinks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VignettedPupils:
    """Points inside the beams of f stars at w wavelengths."""

    z_mm: float  # Launch plane, in the lens frame
    x_mm: FloatArray  # (f, w, n) Launch points
    y_mm: FloatArray  # (f, w, n)
    # (f, w, n) Area of the plane represented by each ray; their sum is the beam's cross-section there, 0 where none
    # passes
    area_mm2: FloatArray

    def __post_init__(self) -> None:
        freeze_alike(self, "x_mm", "y_mm", "area_mm2", shape=("f", "w", "n"))


@dataclass(frozen=True, slots=True, kw_only=True)
class PupilOutlines:
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

    def trace(
        self, x: FloatArray, y: FloatArray, direction: FloatArray, wave: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Largest height (...) of rays on any aperture in radii of it, infinite where they miss, and which aperture."""
        largest, aperture = np.zeros(x.shape), np.full(x.shape, -1)

        def visit(number: int, rays: Rays) -> None:
            if number in self.radius:
                height = np.hypot(rays.x, rays.y) / self.radius[number]
                aperture[height > largest] = number
                np.maximum(largest, height, out=largest)  # NaN stays NaN

        rays = Rays.create(x_mm=x, y_mm=y, z_mm=self.frame.z_mm, direction=direction, wavelength_nm=wave)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            status = trace_program(self.program, self.theta, rays, NUMPY, visit).status
        traced = np.isfinite(largest) & ((status == OK) | (status == VIGNETTED))
        return np.where(traced, largest, np.inf), aperture

    def centres(self, direction: FloatArray, wave: FloatArray) -> tuple[FloatArray, BoolArray]:
        """A point (f, p, 2) inside each beam, and whether there is one (f, p)."""
        aimed = aim_at_stop(self.lens, direction, wave)
        x, y = aimed.x_mm.copy(), aimed.y_mm.copy()
        lit = np.asarray(aimed.converged & (self.trace(x, y, direction, wave)[0] < 1.0))
        if not lit.all():
            dark = np.nonzero(~lit)
            x[dark], y[dark], lit[dark] = self._scan(direction[dark], wave[dark], (x[dark], y[dark]))
        return np.stack([x, y], axis=-1), lit

    def _scan(
        self, direction: FloatArray, wave: FloatArray, centre: tuple[FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Mean launch point (n,) of the rays of a grid about a point that get through, and whether any does."""
        half_width = 1.5 * self.frame.scale_mm
        for _ in range(4):
            side = half_width * np.linspace(-1.0, 1.0, SCAN)
            x, y = (c[:, None] + v.ravel() for c, v in zip(centre, np.meshgrid(side, side), strict=True))
            passed = self.trace(x, y, direction[:, None], wave[:, None])[0] < 1.0
            count = passed.sum(1)
            if (count > 0).all():
                break
            half_width *= 2.0
        weight = passed / np.maximum(count, 1)[:, None]
        return (weight * x).sum(1), (weight * y).sum(1), count > 0

    def outline(
        self, centre: FloatArray, lit: BoolArray, direction: FloatArray, wave: FloatArray, arms: int
    ) -> tuple[FloatArray, IntArray]:
        """Radius (f, p, arms) [mm] of each outline about its centre, and the surface whose rim it is: false position
        (Illinois), bisection where a ray misses a surface."""
        shape = (*wave.shape, arms)
        azimuth, scale = _azimuth(arms), self.frame.scale_mm
        flat = (centre[..., :1], centre[..., 1:], np.cos(azimuth), np.sin(azimuth), wave[..., None], lit[..., None])
        x0, y0, cosine, sine, colour, open_ = (np.broadcast_to(v, shape).ravel() for v in flat)
        towards = np.broadcast_to(direction[:, :, None], (*shape, 3)).reshape(-1, 3)

        def rim(arm: IntArray, radius: FloatArray) -> tuple[FloatArray, IntArray]:
            x, y = x0[arm] + radius * cosine[arm], y0[arm] + radius * sine[arm]
            return self.trace(x, y, towards[arm], colour[arm])

        def excess(arm: IntArray, radius: FloatArray) -> FloatArray:
            return rim(arm, radius)[0] - 1.0

        lit_arms = np.flatnonzero(open_)
        low, high = np.zeros(len(x0)), np.full(len(x0), np.nan)
        at_low, at_high = np.full(len(x0), -1.0), np.full(len(x0), np.inf)
        at_low[lit_arms] = excess(lit_arms, low[lit_arms])
        arm, radii, radius = lit_arms, iter(OUTWARDS), 0.0
        while len(arm):
            if radius > WIDEST * scale:
                raise ConvergenceError(f"rays pass up to {radius:.1f} mm from the axis; no aperture limits the beam")
            radius = next(radii, 1.1 * radius / scale) * scale
            value = excess(arm, np.full(len(arm), radius))
            outside = value >= 0.0
            high[arm[outside]], at_high[arm[outside]] = radius, value[outside]
            low[arm[~outside]], at_low[arm[~outside]] = radius, value[~outside]
            arm = arm[~outside]
        arm = lit_arms
        side = np.zeros(len(x0))  # of the last trial: -1 inside, +1 outside
        for _ in range(RIM_STEPS):
            a, b, f, g = low[arm], high[arm], at_low[arm], at_high[arm]
            with np.errstate(invalid="ignore"):
                trial = (a * g - b * f) / (g - f)
            trial = np.where(np.isfinite(g), trial, 0.5 * (a + b))
            value = excess(arm, trial)
            inside = value < 0.0
            repeated = np.where(inside, side[arm] < 0, side[arm] > 0)
            low[arm], at_low[arm] = np.where(inside, trial, a), np.where(inside, value, np.where(repeated, 0.5 * f, f))
            high[arm] = np.where(inside, b, trial)
            at_high[arm] = np.where(inside, np.where(repeated, 0.5 * g, g), value)
            side[arm] = np.where(inside, -1.0, 1.0)
            done = np.abs(value) < RIM_TOLERANCE
            low[arm[done]] = trial[done]
            done |= high[arm] - low[arm] < RIM_TOLERANCE * scale
            arm = arm[~done]
            if not len(arm):
                break
        number = np.full(len(x0), -1)
        number[lit_arms] = rim(lit_arms, low[lit_arms])[1]
        return low.reshape(shape), number.reshape(shape)


def vignetted_pupils(
    lens: LensSystem, v_cam: FloatArray, wavelength_nm: ArrayLike, *, rings: int, arms: int
) -> VignettedPupils:
    """Points inside the beams of stars at unit vectors (f, 3) in cam and wavelengths (w,).

    `DomainError` for wavelengths beyond a glass, `ConvergenceError` if no aperture limits the beam.
    """
    wavelength_nm = np.asarray(wavelength_nm, float)
    nodes, factors = _wavelength_nodes(wavelength_nm)
    count = max(arms, LEAST_ARMS)
    outlines = pupil_outlines(lens, v_cam, nodes, arms=count)
    harmonic = np.abs(np.fft.rfft(outlines.radius_mm, axis=-1))[..., -2:].max(-1) * 2.0 / count
    if (harmonic > SMOOTH * np.maximum(outlines.radius_mm.mean(-1), 1e-300)).any():
        count *= FINER
        outlines = pupil_outlines(lens, v_cam, nodes, arms=count)
    values = outlines.radius_mm, _azimuth_weights(outlines.radius_mm, outlines.rim), outlines.centre_mm
    radius, azimuth_weight, centre = (np.einsum("wp,fpm->fwm", factors, v) for v in values)
    node, weight = np.polynomial.legendre.leggauss(rings)
    ring = np.sqrt(0.5 * (1.0 + node))[:, None]
    distance = radius[..., None, :] * ring
    azimuth = _azimuth(count)
    x, y = (centre[..., k, None, None] + distance * v for k, v in enumerate((np.cos(azimuth), np.sin(azimuth))))
    area = (radius**2 * azimuth_weight)[..., None, :] * (0.5 * weight[:, None] * np.pi / count)
    shape = (*radius.shape[:2], rings * count)
    return VignettedPupils(
        z_mm=outlines.z_mm, x_mm=x.reshape(shape), y_mm=y.reshape(shape), area_mm2=area.reshape(shape)
    )


def pupil_outlines(lens: LensSystem, v_cam: FloatArray, wavelength_nm: FloatArray, *, arms: int) -> PupilOutlines:
    """Outlines of beams at a number of azimuths; parameters and errors as `vignetted_pupils`."""
    lens.check_wavelength(wavelength_nm)
    apertures = _Apertures(lens)
    direction, wave = _beams(v_cam, wavelength_nm)
    centre, lit = apertures.centres(direction, wave)
    radius, rim = apertures.outline(centre, lit, direction, wave, arms)
    return PupilOutlines(
        z_mm=apertures.frame.z_mm, centre_mm=centre, radius_mm=np.where(lit[..., None], radius, 0.0), rim=rim, lit=lit
    )


def inner_points(lens: LensSystem, v_cam: FloatArray, wavelength_nm: FloatArray) -> tuple[FloatArray, BoolArray]:
    """A point (f, p, 2) of the plane of launch [mm] inside every beam, and whether there is one (f, p).

    It is the chief ray's, or where that is blocked the mean of rays that get through. Parameters as `vignetted_pupils`.
    """
    return _Apertures(lens).centres(*_beams(v_cam, wavelength_nm))


def _beams(v_cam: FloatArray, wavelength_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Directions of light (f, p, 3) in the lens frame and wavelengths (f, p)."""
    direction = np.repeat(light_direction(v_cam)[:, None], len(wavelength_nm), axis=1)
    return direction, np.broadcast_to(wavelength_nm, direction.shape[:2])


def _azimuth(count: int) -> FloatArray:
    """Equidistant azimuths [rad]; for multiples of four points lie symmetrically about both axes."""
    return 2.0 * np.pi * (np.arange(count) + 0.5) / count


def _azimuth_weights(radius: FloatArray, rim: IntArray) -> FloatArray:
    """Weights (f, p, m) of the azimuths, 1 where the outline is smooth.

    At a kink between two azimuths, a steps after the first and b before the second, the sum of a periodic function is
    short of the integral by (a b / 2 - 1 / 12) times the drop of its slope per step: the triangle above the chord, less
    the end terms of the Euler-Maclaurin formula on both sides. The slopes are from the adjacent steps.
    """
    before, after, beyond = (np.roll(radius, -k, axis=-1) - np.roll(radius, -k + 1, axis=-1) for k in (0, 1, 2))
    slope_change = before - beyond
    aperture = [np.roll(rim, -k, axis=-1) for k in (-1, 0, 1, 2)]
    kink = (aperture[0] == aperture[1]) & (aperture[1] != aperture[2]) & (aperture[2] == aperture[3])
    with np.errstate(invalid="ignore", divide="ignore"):
        a = (after - beyond) / slope_change  # intersection of the tangents, in steps
    kink &= (a > 0.0) & (a < 1.0)
    correction = np.where(kink, 0.5 * a * (1.0 - a) - 1.0 / 12.0, 0.0)
    weight = np.ones(radius.shape)
    for offset, sign in ((-1, -1.0), (0, 1.0), (1, 1.0), (2, -1.0)):
        weight += sign * np.roll(correction, offset, axis=-1)
    return weight


def _wavelength_nodes(wavelength_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Wavelengths (p,) at which outlines are traced, and Lagrange factors (w, p) that lead from these to all."""
    distinct = np.unique(wavelength_nm)
    if len(distinct) <= NODES:
        return distinct, (wavelength_nm[:, None] == distinct).astype(float)
    t = np.cos(np.pi * np.arange(NODES) / (NODES - 1))  # Chebyshev points in 1/wavelength^2
    low, high = distinct[-1] ** -2.0, distinct[0] ** -2.0
    nodes = 0.5 * (low + high) + 0.5 * (high - low) * t
    factors = np.ones((len(wavelength_nm), NODES))
    for p in range(NODES):
        for other in np.delete(nodes, p):
            factors[:, p] *= (wavelength_nm**-2.0 - other) / (nodes[p] - other)
    return np.clip(nodes**-0.5, distinct[0], distinct[-1]), factors
