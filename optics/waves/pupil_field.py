"""The field in the exit pupil of a lens as traced rays carry it, and its image by a sum of plane waves.

A ray j of a quadrature of the pupil lands at (x, y) in the image plane after an optical path S and with direction
cosines (L, M); there it stands for a plane wave. Without an exit pupil sphere or an FFT the field at (X, Y) is

    U(X, Y) = sum_j w_j sqrt(J_j) exp{ i k [S_j + n L_j (X - x_j) + n M_j (Y - y_j)] },   k = 2 pi / lambda

with J = |d(L, M) / d(pupil)|, the w_j areas of the pupil, n the index of the image space and lambda the wavelength in
vacuum: a stationary-phase ("geometrical") field in the pupil, exact diffraction from there on (Born & Wolf, *Principles
of Optics*, 7th ed., sec. 8.8; Forbes & Scheimpflug write it as the "ray-based angular spectrum"). By Parseval's theorem
the integral of |U|^2 over the plane is (lambda / n)^2 times the area of the pupil, and the mean of |U|^2 is the mean of
the landing points weighted by area: diffraction does not move the centroid of all light. The exponent is a sum of a
part in X and one in Y, so a grid of points is one complex matrix product.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from optics.arrays import BoolArray, FloatArray
from optics.errors import DomainError
from optics.frames import field_direction, light_direction
from optics.lens.system import LensSystem
from optics.rays.entrance_pupil import stop_in_front
from optics.rays.pupil_sampling import gauss_disk
from optics.rays.trace import Rays, trace
from optics.rays.vignetted_pupil import VignettedPupils, vignetted_pupils
from optics.records import freeze

LARGEST_APERTURE = 0.6
"""Sine of the largest angle of a ray for which the scalar theory is taken to hold (F/0.83); beyond, the vector nature
of light changes the image by more than a few percent of its peak (Richards & Wolf 1959, Proc. R. Soc. A 253, 358)."""
PROBE_ORDER = (12, 32)
MOST_RINGS, MOST_ARMS = 256, 1024
DIFFERENCE = 2e-4
"""Distance of the rays whose directions give J, in radii of the beam: errors of 1e-9."""

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True)
class PupilField:
    """Rays of f fields and w wavelengths on a polar quadrature of their pupils, in the frame of the image plane."""

    wavelength_nm: FloatArray  # (w,) Vacuum wavelengths
    index: FloatArray  # (w,) Refractive index of the image space
    ring: FloatArray  # (rings,) Radii of the rings over the radius of the pupil's rim
    pupil_x: FloatArray  # (f, w, rings, arms) Launch points [mm]
    pupil_y: FloatArray  # (f, w, rings, arms)
    # (f, w, rings, arms) Area of the launch plane represented by each ray; 0 where no light passes
    area_mm2: FloatArray
    x_mm: FloatArray  # (f, w, rings, arms) Landing points
    y_mm: FloatArray  # (f, w, rings, arms)
    l: FloatArray  # noqa: E741
    m: FloatArray  # (f, w, rings, arms) Direction cosines there
    n: FloatArray  # (f, w, rings, arms)
    path_mm: FloatArray  # (f, w, rings, arms) Optical path from a plane wavefront
    jacobian: FloatArray  # (f, w, rings, arms) ``|d(l, m) / d(pupil)|`` [1/mm^2]

    def __post_init__(self) -> None:
        shapes = dict.fromkeys(list(self.__dataclass_fields__)[3:], ("f", "w", "rings", "arms"))
        sizes: dict[str, int] = {}
        for name, shape in ({"wavelength_nm": ("w",), "index": ("w",), "ring": ("rings",)} | shapes).items():
            freeze(self, name, shape=shape, sizes=sizes)
        aperture = float(np.hypot(self.l, self.m).max(initial=0.0))
        if aperture > LARGEST_APERTURE:
            raise DomainError(
                f"rays reach the image at {math.degrees(math.asin(min(aperture, 1.0))):.0f} deg; the scalar theory of "
                f"diffraction is used up to {math.degrees(math.asin(LARGEST_APERTURE)):.0f} deg (F/0.83); stop the "
                "lens down or render it by rays"
            )

    def unit_pupil(self, at: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        """Launch points (rings, arms) of one field and wavelength in radii of the pupil's rim, about its centre."""
        x, y = self.pupil_x[at], self.pupil_y[at]
        u, v = (p - 0.5 * (p[-1].min() + p[-1].max()) for p in (x, y))
        radius = float(np.hypot(u[-1], v[-1]).max() / self.ring[-1])
        return u / radius, v / radius

    @property
    def mean_mm(self) -> tuple[FloatArray, FloatArray]:
        """Mean landing point (f, w), which is the centroid of all light of the diffraction image; NaN without light."""
        light = self.area_mm2.sum((2, 3))
        with np.errstate(invalid="ignore"):
            return (self.area_mm2 * self.x_mm).sum((2, 3)) / light, (self.area_mm2 * self.y_mm).sum((2, 3)) / light

    def centroid_mm(self, at: tuple[int, int]) -> tuple[float, float]:
        """`mean_mm` of one field and wavelength."""
        x, y = self.mean_mm
        return float(x[at]), float(y[at])

    def frequency_per_mm(self, at: tuple[int, int]) -> float:
        """Index of the image space over the wavelength [1/mm]: spatial frequency per direction cosine."""
        return float(self.index[at[1]]) / (float(self.wavelength_nm[at[1]]) * 1e-6)

    def lit(self, at: tuple[int, int]) -> BoolArray:
        """Rays (rings, arms) of one field and wavelength that carry light; `DomainError` if none does."""
        lit = self.area_mm2[at] > 0.0
        if not lit.any():
            raise DomainError(f"field {at[0]}, wavelength {at[1]}: no light reaches the image plane")
        return np.asarray(lit)

    def shifted(self, focus_mm: float) -> PupilField:
        """The same light in an image plane that lies further along the light."""
        length = focus_mm / np.where(self.n > 0.0, self.n, 1.0)
        return replace(
            self,
            x_mm=self.x_mm + self.l * length,
            y_mm=self.y_mm + self.m * length,
            path_mm=self.path_mm + self.index[:, None, None] * length,
        )

    def with_path(self, extra_mm: FloatArray) -> PupilField:
        """With optical path added, (f, w, rings, arms) or broadcastable, e.g. of a measured map."""
        return replace(self, path_mm=self.path_mm + extra_mm)

    def path_to(self, x_mm: ArrayLike, y_mm: ArrayLike) -> FloatArray:
        """Optical path (f, w, rings, arms) [mm] to points (f, w) of the image plane, as plane waves travel."""
        x, y = (np.asarray(v, float)[..., None, None] for v in (x_mm, y_mm))
        n = self.index[:, None, None]
        return np.asarray(self.path_mm + n * (self.l * (x - self.x_mm) + self.m * (y - self.y_mm)))

    def amplitude(
        self, x_mm: FloatArray, y_mm: FloatArray, *, at: tuple[int, int] = (0, 0), dtype: DTypeLike = np.complex128
    ) -> NDArray[np.complexfloating]:
        """Field U (Y, X) on the grid of columns ``x_mm`` (X,) and rows ``y_mm`` (Y,) of the image plane.

        Scaled so that ``|U|^2`` is the fraction of the pupil's light per mm^2: its integral over the plane is 1.
        """
        lit = self.lit(at)
        x, y, l, m, path, area, jacobian = (  # noqa: E741
            v[at][lit] for v in (self.x_mm, self.y_mm, self.l, self.m, self.path_mm, self.area_mm2, self.jacobian)
        )
        self._check_sampling(x_mm, y_mm, at)
        wave_mm = self.wavelength_nm[at[1]] * 1e-6
        n = self.index[at[1]]
        x0, y0 = float(np.mean(x_mm)), float(np.mean(y_mm))
        phase = (path + n * (l * (x0 - x) + m * (y0 - y))) / wave_mm
        weight = area * np.sqrt(jacobian) * (n / wave_mm / math.sqrt(area.sum()))
        left = phasor(np.outer(np.asarray(y_mm) - y0, n * m / wave_mm), dtype)
        right = phasor(np.outer(n * l / wave_mm, np.asarray(x_mm) - x0), dtype)
        right *= (weight * np.exp(2j * np.pi * (phase - phase[0]))).astype(dtype)[:, None]
        return np.asarray(left @ right)

    def _check_sampling(self, x_mm: FloatArray, y_mm: FloatArray, at: tuple[int, int]) -> None:
        """Refuse a pupil that is sampled too coarsely for the phase differences between neighbours."""
        part = slice(at[0], at[0] + 1), slice(at[1], at[1] + 1)
        arrays = {name: getattr(self, name)[part] for name in list(self.__dataclass_fields__)[3:]}
        single = replace(self, wavelength_nm=self.wavelength_nm[part[1]], index=self.index[part[1]], **arrays)
        half_x, half_y = (0.5 * float(np.ptp(v)) for v in (x_mm, y_mm))
        middle_x, middle_y = (np.full((1, 1), 0.5 * float(np.min(v) + np.max(v))) for v in (x_mm, y_mm))
        radial, around = _phase_changes(single, half_x, half_y, (middle_x, middle_y))
        rings, arms = single.area_mm2.shape[2:]
        if rings < radial / 4.0 or arms < around:
            raise DomainError(
                f"a pupil of {rings} rings x {arms} azimuths is too coarse for a wavefront that changes by "
                f"{radial:.0f} rad along a radius and {around:.0f} rad per radian around the rim in this window; at "
                f"least {math.ceil(radial / 4.0)} x {math.ceil(around)} are needed, or a smaller window"
            )

    def intensity(
        self, x_mm: FloatArray, y_mm: FloatArray, *, at: tuple[int, int] = (0, 0), dtype: DTypeLike = np.complex128
    ) -> FloatArray:
        """Fraction of the light per mm^2 (Y, X) on a grid; parameters as `amplitude`."""
        return squared_modulus(self.amplitude(x_mm, y_mm, at=at, dtype=dtype))


def squared_modulus(field: NDArray[np.complexfloating]) -> FloatArray:
    """``|U|^2`` in double precision."""
    return np.asarray(field.real.astype(np.float64) ** 2 + field.imag.astype(np.float64) ** 2)


def phasor(turns: FloatArray, dtype: DTypeLike) -> NDArray[Any]:
    """exp(2 pi i turns), reduced to one turn before the precision is lowered."""
    dtype = np.dtype(dtype)
    angle = ((turns - np.rint(turns)) * (2.0 * np.pi)).astype(np.float32 if dtype == np.complex64 else np.float64)
    result = np.empty(turns.shape, dtype)
    np.cos(angle, out=result.real)
    np.sin(angle, out=result.imag)
    return result


def needed_order(field: PupilField, half_width_mm: float) -> tuple[int, int]:
    """Rings and azimuths that integrate over the pupil for every point of a window about the mean landing point.

    Along a radius the phase changes by at most P, around the rim by at most Q per radian. A trapezoid of more than Q
    azimuths, and a Gauss rule in r^2 of more than P / 4 nodes, converge faster than any power (the Bessel functions
    J_m(Q) vanish for m > Q + some Q^(1/3)).
    """
    radial, around = _phase_changes(field, half_width_mm, half_width_mm)
    rings = math.ceil(radial / 4.0) + 10
    arms = 4 * math.ceil((around + 4.0 * around ** (1.0 / 3.0) + 16.0) / 4.0)
    if rings > MOST_RINGS or arms > MOST_ARMS:
        raise DomainError(
            f"the wavefront changes by {radial:.0f} rad along a radius of the pupil: {rings} rings x {arms} azimuths "
            f"are needed, {MOST_RINGS} x {MOST_ARMS} allowed; a smaller window or less defocus is needed, or "
            "diffraction = 'rays', which suffices for such images"
        )
    return rings, arms


def _phase_changes(
    field: PupilField, half_x_mm: float, half_y_mm: float, points: tuple[FloatArray, FloatArray] | None = None
) -> tuple[float, float]:
    """Largest change of phase along a radius [rad] and per radian of the rim, for the corners of a window about points
    (f, w), the mean landing points if left out."""
    mean_x, mean_y = (np.nan_to_num(v) for v in (field.mean_mm if points is None else points))
    k = 2.0 * np.pi * 1e6 / field.wavelength_nm[:, None, None]
    lit = field.area_mm2 > 0.0
    per_radian = field.area_mm2.shape[3] / (2.0 * np.pi)
    radial = around = 0.0
    for sx, sy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        path = field.path_to(mean_x + sx * half_x_mm, mean_y + sy * half_y_mm)
        phase = np.where(lit, k * path, np.nan)
        radial_change = np.nan_to_num(np.abs(np.diff(phase, axis=2))).sum(2)
        step_change = np.nan_to_num(np.abs(np.roll(phase, -1, axis=3) - phase))
        radial = max(radial, float(radial_change.max(initial=0.0)))
        around = max(around, float(step_change.max(initial=0.0)) * per_radian)
    return radial, around


def trace_pupil(
    lens: LensSystem,
    field_x_deg: ArrayLike,
    field_y_deg: ArrayLike,
    wavelength_nm: ArrayLike,
    *,
    order: tuple[int, int] | None = None,
    half_width_mm: float = 0.03,
) -> PupilField:
    """Trace the pupils of stars for sums of plane waves.

    Parameters
    ----------
    lens : LensSystem
        The lens, perturbed or not.
    field_x_deg, field_y_deg : (f,)
        Field angles.
    wavelength_nm : (w,)
        Vacuum wavelengths.
    order : (int, int), optional
        Rings and azimuths; as many as a window needs if left out (`needed_order`).
    half_width_mm : float
        Half the side of that window.

    Returns
    -------
    PupilField
        Rays, optical paths and weights per field and wavelength.

    Raises
    ------
    DomainError
        Fields or wavelengths out of range; a wavefront that needs too many rays; rays too steep for the scalar theory.
    ConvergenceError
        If nothing limits the beam.
    """
    stars = field_direction(np.atleast_1d(field_x_deg), np.atleast_1d(field_y_deg))
    waves = np.atleast_1d(np.asarray(wavelength_nm, float))
    if order is None:
        order = needed_order(_traced(lens, stars, waves, PROBE_ORDER), half_width_mm)
    return _traced(lens, stars, waves, order)


def _points(
    lens: LensSystem, stars: FloatArray, waves: FloatArray, order: tuple[int, int]
) -> tuple[FloatArray, FloatArray, float, FloatArray, FloatArray]:
    """Launch points (f, w, rings, arms), their plane, areas, and the radii of the rings."""
    if stop_in_front(lens):
        stop = lens.surfaces[lens.stop_index]
        disk, radius = gauss_disk(*order), float(stop.semi_diameter_mm)
        shape = (len(stars), len(waves), *order)
        x, y, area = (
            np.broadcast_to(v.reshape(order), shape)
            for v in (
                stop.position_mm[0] + radius * disk.x,
                stop.position_mm[1] + radius * disk.y,
                disk.weight * math.pi * radius**2,
            )
        )
        ring = np.sqrt(0.5 * (1.0 + np.polynomial.legendre.leggauss(order[0])[0]))
        return x, y, float(stop.position_mm[2]), area, ring
    return _inside_outlines(vignetted_pupils(lens, stars, waves, rings=2, arms=order[1]), order[0])


def _inside_outlines(
    pupils: VignettedPupils, rings: int
) -> tuple[FloatArray, FloatArray, float, FloatArray, FloatArray]:
    """`_points` inside pupils of any outline, given by two of their rings.

    Gauss nodes in the radius itself, not in its square: about a point that is not a centre of symmetry odd powers of
    the radius come with odd harmonics of the outline.
    """
    inner, outer = np.sqrt(0.5 * (1.0 + np.polynomial.legendre.leggauss(2)[0]))
    x, y, area = (v.reshape(*v.shape[:2], 2, -1) for v in (pupils.x_mm, pupils.y_mm, pupils.area_mm2))
    node, weight = np.polynomial.legendre.leggauss(rings)
    radius = 0.5 * (1.0 + node)[:, None]
    px, py = (v[:, :, :1] + (v[:, :, 1:] - v[:, :, :1]) / (outer - inner) * (radius - inner) for v in (x, y))
    return px, py, pupils.z_mm, area.sum(2, keepdims=True) * weight[:, None] * radius, radius[:, 0]


def _traced(lens: LensSystem, stars: FloatArray, waves: FloatArray, order: tuple[int, int]) -> PupilField:
    """Rays and, from four neighbours of each, the Jacobian of their directions."""
    x, y, z, area, ring = _points(lens, stars, waves, order)
    indices = lens.indices(waves)
    direction = light_direction(stars)[:, None, None, None, :]
    wave = waves[:, None, None]

    def launch(dx: float, dy: float) -> Rays:
        rays = Rays.create(x_mm=x + dx, y_mm=y + dy, z_mm=z, direction=direction, wavelength_nm=wave)
        start = rays.x * rays.dx + rays.y * rays.dy + rays.z * rays.dz
        rays.opl_mm[...] = indices[0][:, None, None] * start
        return trace(lens, rays)

    out = launch(0.0, 0.0)
    h = DIFFERENCE * math.sqrt(float(area.sum((2, 3)).max()) / math.pi)
    if not h > 0.0:
        raise DomainError(f"lens {lens.name!r}: no light of any field reaches the image plane")
    right, left, up, down = launch(h, 0.0), launch(-h, 0.0), launch(0.0, h), launch(0.0, -h)
    jacobian = (right.dx - left.dx) * (up.dy - down.dy) - (right.dy - left.dy) * (up.dx - down.dx)
    lit = out.ok & (area > 0.0) & np.isfinite(jacobian)
    values = {"area_mm2": area, "x_mm": out.x, "y_mm": out.y, "l": out.dx, "m": out.dy, "path_mm": out.opl_mm,
              "jacobian": np.abs(jacobian) / (4.0 * h * h)}  # fmt: skip
    return PupilField(
        wavelength_nm=waves,
        index=indices[-1],
        ring=ring,
        pupil_x=x,
        pupil_y=y,
        n=np.where(lit, out.dz, 1.0),
        **{name: np.where(lit, value, 0.0) for name, value in values.items()},
    )
