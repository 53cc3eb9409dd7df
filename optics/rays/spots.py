"""Spots of starlight by real rays: moments, lateral colour, vignetting, best focus; also for perturbed lenses.

Fields are angles of the star in cam (`optics.frames.field_direction`), positions are millimetres in the image plane
(lens frame axes: x along increasing column, y against increasing row).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.frames import field_direction, light_direction
from optics.lens.measured import MeasuredLens
from optics.lens.system import LensSystem
from optics.light.collimation import bent_light
from optics.rays.beam import find_beams
from optics.rays.chief import chief_ray_points
from optics.rays.pupil import (
    PupilSamples,
    entrance_pupil,
    gauss_disk,
    launch_disks,
    sobol_disk,
    star_rays,
    stop_in_front,
)
from optics.rays.trace import VIGNETTED, Rays, trace
from optics.records import freeze

QUADRATURE = (12, 32)
"""Rings and azimuths."""
SOBOL_POINTS, SOBOL_SEED = 4096, 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SpotMoments:
    """Moments of the light in the image plane, per field (f) and wavelength (w)."""

    x_mm: FloatArray  # (f, w) Mean of the ray bundle
    y_mm: FloatArray  # (f, w)
    xx_mm2: FloatArray  # (f, w) Covariance
    xy_mm2: FloatArray  # (f, w)
    yy_mm2: FloatArray  # (f, w)
    # (f, w) Area of the launch disk whose rays arrive; the flux is that times irradiance times cosine of the field
    # angle
    transmitted_mm2: FloatArray

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in ("x_mm", "y_mm", "xx_mm2", "xy_mm2", "yy_mm2", "transmitted_mm2"):
            freeze(self, name, shape=("f", "w"), finite=False, sizes=sizes)

    @property
    def rms_radius_mm(self) -> FloatArray:
        """Root mean square distance from the mean, (f, w) [mm]."""
        return np.sqrt(self.xx_mm2 + self.yy_mm2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spots:
    """Traced rays of every field and wavelength."""

    rays: Rays  # Shape (f, w, n), in the frame of the image plane
    # (f, w, n) Part of the launch plane that a ray stands for, 0 for lost rays; times irradiance and cosine of the
    # field angle it is the ray's flux
    area_mm2: FloatArray

    def __post_init__(self) -> None:
        freeze(self, "area_mm2", shape=("f", "w", "n"), sizes={})


def trace_spots(
    lens: LensSystem,
    field_x_deg: ArrayLike,
    field_y_deg: ArrayLike,
    wavelength_nm: ArrayLike,
    *,
    samples: PupilSamples | None = None,
    order: tuple[int, int] = QUADRATURE,
    collimation: FloatArray | None = None,
) -> Spots:
    """Trace the ray bundles of stars.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    field_x_deg, field_y_deg : (f,)
        Field angles [deg].
    wavelength_nm : (w,)
        Wavelengths [nm].
    samples : PupilSamples, optional
        Points of the launch disk (`optics.rays.pupil.launch_disks`). If left out: quadrature inside the beam, whose
        outline is known (a clear stop in front) or found (`optics.rays.beam`); for a lens whose apertures have holes
        2048 scrambled Sobol points and the 2048 opposite ones, which leave some 5e-4 px of the shift between bands
        where spots have 4 px RMS.
    order : (int, int)
        Rings and azimuths of the quadrature.
    collimation : (w, 3), optional
        Of sources behind a collimator, slopes and vergence at the wavelengths (`optics.light.collimation`).

    Returns
    -------
    Spots
        Rays on the image plane, with the area of the pupil that each stands for.

    Raises
    ------
    DomainError
        Field angles or wavelengths out of range or not one-dimensional.
    ConvergenceError
        If no ray of any field arrives.
    """
    stars = field_direction(np.atleast_1d(field_x_deg), np.atleast_1d(field_y_deg))
    waves = np.atleast_1d(np.asarray(wavelength_nm, float))
    if stars.ndim != 2 or waves.ndim != 1:
        raise DomainError(
            f"fields of shape {stars.shape[:-1]}, wavelengths {waves.shape}; one-dimensional lists are needed"
        )
    if lens.measured is not None:
        if collimation is not None:  # changes the focus, of which nothing was measured
            lens.check_surfaces()
        return _measured_spots(lens, lens.measured, stars, waves, order)
    holes = any(surface.holed for surface in lens.surfaces)
    spots = None
    if samples is not None or stop_in_front(lens):
        spots = _of_disk(lens, stars, waves, samples or gauss_disk(*order), collimation)
    elif holes:
        spots = _of_disk(lens, stars, waves, _opposite_points(), collimation)
    if spots is None or (samples is None and not holes and not np.all(spots.rays.ok)):
        spots = _of_beams(lens, stars, waves, order, collimation)
    if not np.any(spots.rays.ok):
        raise ConvergenceError(f"lens {lens.name!r}: no ray of any field reaches the image plane")
    return spots


def _measured_spots(
    lens: LensSystem, measured: MeasuredLens, stars: FloatArray, waves: FloatArray, order: tuple[int, int]
) -> Spots:
    """Points that stand for the Gaussians of a measured lens, as rays do for a spot; their moments are exact
    (Gauss-Laguerre nodes in half the square of the distance, evenly around)."""
    lens.check_wavelength(waves)
    place = measured.place_mm(stars[:, None, :], waves)
    place_x, place_y = np.moveaxis(place, -1, 0)
    share, offset, covariance = measured.psf.at(place_x, place_y, waves)
    half_square, weight = np.polynomial.laguerre.laggauss(order[0])
    turn = 2.0 * np.pi * (np.arange(order[1]) + 0.5) / order[1]
    unit_x, unit_y = (np.outer(np.sqrt(2.0 * half_square), wave(turn)).ravel() for wave in (np.cos, np.sin))
    xx, yy, xy = np.moveaxis(covariance[..., None, :], -1, 0)
    x = place[..., None, None, 0] + offset[..., None, 0] + np.sqrt(xx) * unit_x
    y = place[..., None, None, 1] + offset[..., None, 1] + xy / np.sqrt(xx) * unit_x
    y = y + np.sqrt(yy - xy * xy / xx) * unit_y
    light = measured.relative(place) / stars[:, None, 2] * (0.25 * np.pi * measured.aperture_mm**2)
    area = (light[..., None] * share)[..., None] * np.repeat(weight / order[1], order[1])
    known = np.isfinite(place_x)
    shape = (*known.shape, -1)
    rays = Rays.create(
        x_mm=np.where(known[..., None], x.reshape(shape), 0.0),
        y_mm=np.where(known[..., None], -y.reshape(shape), 0.0),
        z_mm=0.0,
        direction=light_direction(stars)[:, None, None, :],
        wavelength_nm=waves[:, None],
    )
    lit = np.broadcast_to(known[..., None], rays.x.shape)
    return Spots(
        rays=replace(rays, status=np.where(lit, rays.status, VIGNETTED)),
        area_mm2=np.where(lit, area.reshape(shape), 0.0),
    )


def _opposite_points() -> PupilSamples:
    """Sobol points of the unit disk, each with its opposite: terms odd in the pupil cancel in means, such as defocus;
    the same number of plain Sobol points leaves eight times the error behind holes."""
    half = sobol_disk(SOBOL_POINTS // 2, seed=SOBOL_SEED)
    x, y, weight = (np.concatenate(v) for v in ((half.x, -half.x), (half.y, -half.y), (half.weight, half.weight)))
    return PupilSamples(x=x, y=y, weight=0.5 * weight)


def _of_disk(
    lens: LensSystem, stars: FloatArray, waves: FloatArray, samples: PupilSamples, collimation: FloatArray | None
) -> Spots:
    """Rays of launch disks that cover these fields and wavelengths."""
    exact = entrance_pupil(lens) if stop_in_front(lens) else None
    pupil = launch_disks(lens, stars, waves) if exact is None else exact
    grid = np.broadcast_to(waves, (len(stars), waves.size))
    rays = trace(lens, _bent(lens, star_rays(pupil, samples, stars[:, None, :], grid), collimation))
    return Spots(rays=rays, area_mm2=np.where(rays.ok, samples.weight * pupil.area_mm2, 0.0))


def _bent(lens: LensSystem, rays: Rays, collimation: FloatArray | None) -> Rays:
    """Rays (f, w, n) of the light of a collimator, about the centre of the pupil, as the renderer's launch disk."""
    if collimation is None:
        return rays
    x_mm, y_mm = 0.0, 0.0
    if stop_in_front(lens):
        pupil = entrance_pupil(lens)
        x_mm, y_mm = pupil.x_mm, pupil.y_mm
    slopes = collimation[:, 0, None], collimation[:, 1, None], collimation[:, 2, None]
    dx, dy, dz = bent_light((rays.dx, rays.dy, rays.dz), rays.x - x_mm, rays.y - y_mm, slopes, np.sqrt)
    return replace(rays, dx=dx, dy=dy, dz=dz)


def _of_beams(
    lens: LensSystem, stars: FloatArray, waves: FloatArray, order: tuple[int, int], collimation: FloatArray | None
) -> Spots:
    """Rays inside the beams."""
    beams = find_beams(lens, stars, waves, rings=order[0], arms=order[1])
    start = Rays.create(
        x_mm=beams.x_mm,
        y_mm=beams.y_mm,
        z_mm=beams.z_mm,
        direction=light_direction(stars)[:, None, None],
        wavelength_nm=waves[:, None],
    )
    start.opl_mm[...] = start.x * start.dx + start.y * start.dy + start.z * start.dz
    rays = trace(lens, _bent(lens, start, collimation))
    lit = rays.ok & (beams.area_mm2 > 0.0)
    return Spots(rays=replace(rays, status=np.where(lit, rays.status, VIGNETTED)), area_mm2=beams.area_mm2 * lit)


def spot_moments(
    lens: LensSystem,
    field_x_deg: ArrayLike,
    field_y_deg: ArrayLike,
    wavelength_nm: ArrayLike,
    *,
    samples: PupilSamples | None = None,
    order: tuple[int, int] = QUADRATURE,
    collimation: FloatArray | None = None,
) -> SpotMoments:
    """Mean, covariance and transmitted area of the ray bundles of stars; errors as `trace_spots`.

    A field from which no ray arrives has NaN moments and transmits 0.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    field_x_deg, field_y_deg : (f,)
        Field angles [deg].
    wavelength_nm : (w,)
        Wavelengths [nm].
    samples, order, collimation : optional
        As in `trace_spots`.

    Returns
    -------
    SpotMoments
        Per field and wavelength.
    """
    spots = trace_spots(
        lens, field_x_deg, field_y_deg, wavelength_nm, samples=samples, order=order, collimation=collimation
    )
    area = spots.area_mm2
    total = area.sum(axis=-1)
    weight = np.divide(area, total[..., None], out=np.full_like(area, np.nan), where=total[..., None] > 0)
    x, y = (np.where(spots.rays.ok, v, 0.0) for v in (spots.rays.x, spots.rays.y))
    mean_x, mean_y = (weight * x).sum(-1), (weight * y).sum(-1)
    dx, dy = x - mean_x[..., None], y - mean_y[..., None]
    xx, xy, yy = ((weight * product).sum(-1) for product in (dx * dx, dx * dy, dy * dy))
    return SpotMoments(
        x_mm=mean_x,
        y_mm=mean_y,
        xx_mm2=xx,
        xy_mm2=xy,
        yy_mm2=yy,
        transmitted_mm2=total,
    )


def lateral_colour(
    lens: LensSystem,
    field_x_deg: ArrayLike,
    field_y_deg: ArrayLike,
    wavelength_nm: ArrayLike,
    *,
    reference_nm: float | None = None,
    of: Literal["bundle", "chief"] = "bundle",
) -> tuple[FloatArray, FloatArray]:
    """Shift of the image with wavelength.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    field_x_deg, field_y_deg : (f,)
        Field angles [deg].
    wavelength_nm : (w,)
        Wavelengths [nm].
    reference_nm : float, optional
        Wavelength of zero shift; the design wavelength if left out.
    of : {"bundle", "chief"}
        Mean of the ray bundle, or chief ray.

    Returns
    -------
    dx_mm, dy_mm : (f, w)
        Shift in the image plane [mm].
    """
    reference = lens.design_wavelength_nm if reference_nm is None else reference_nm
    waves = np.append(np.atleast_1d(np.asarray(wavelength_nm, float)), reference)
    if of == "chief":
        fx, fy = (np.atleast_1d(np.asarray(v, float))[:, None] for v in (field_x_deg, field_y_deg))
        x, y = chief_ray_points(lens, fx, fy, waves)
    elif of == "bundle":
        moments = spot_moments(lens, field_x_deg, field_y_deg, waves)
        x, y = moments.x_mm, moments.y_mm
    else:
        raise DomainError(f"lateral colour of {of!r}; 'bundle' or 'chief' is needed")
    return x[:, :-1] - x[:, -1:], y[:, :-1] - y[:, -1:]


def vignetting(
    lens: LensSystem, field_x_deg: ArrayLike, field_y_deg: ArrayLike, wavelength_nm: float | None = None
) -> FloatArray:
    """Transmitted area of the beam relative to field 0, (f,); the cosine of the field angle is not part of it.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    field_x_deg, field_y_deg : (f,)
        Field angles [deg].
    wavelength_nm : float, optional
        Wavelength; the design wavelength if left out.

    Returns
    -------
    (f,) array
        Fractions.
    """
    fx, fy = np.broadcast_arrays(np.atleast_1d(field_x_deg), np.atleast_1d(field_y_deg))
    wave = lens.design_wavelength_nm if wavelength_nm is None else wavelength_nm
    area = spot_moments(lens, np.append(fx, 0.0), np.append(fy, 0.0), wave).transmitted_mm2[:, 0]
    if not area[-1] > 0:
        raise ConvergenceError(f"lens {lens.name!r}: no ray of field 0 reaches the image plane")
    return np.asarray(area[:-1] / area[-1])


def collecting_area_mm2(lens: LensSystem, wavelength_nm: float | None = None) -> float:
    """Cross-section [mm^2] of the on-axis beam that reaches the image (default: design wavelength).

    Parameters
    ----------
    lens : LensSystem
        The lens.
    wavelength_nm : float, optional
        Wavelength; the design wavelength if left out.

    Returns
    -------
    float
        Area [mm^2].

    Raises
    ------
    ConvergenceError
        If no ray arrives.
    """
    wave = lens.design_wavelength_nm if wavelength_nm is None else wavelength_nm
    return float(spot_moments(lens, 0.0, 0.0, wave).transmitted_mm2[0, 0])
