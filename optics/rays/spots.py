"""Spots of starlight by real rays: ray bundles and their moments; also for perturbed lenses.

Fields are angles of the star in cam (`optics.frames.field_direction`), positions are millimetres in the image plane
(lens frame axes: x along increasing column, y against increasing row).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.frames import field_direction, light_direction
from optics.lens.measured import MeasuredLens
from optics.lens.system import LensSystem
from optics.light.collimation import decollimated
from optics.rays.entrance_pupil import entrance_pupil, launch_disks, star_rays, stop_in_front
from optics.rays.pupil_sampling import PupilSamples, gauss_disk, sobol_disk
from optics.rays.trace import VIGNETTED, Rays, trace
from optics.rays.vignetted_pupil import vignetted_pupils
from optics.records import freeze, freeze_alike

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
    # (f, w) Area of the launch plane whose rays arrive; the flux is the area times irradiance and cosine of the field
    # angle
    transmitted_mm2: FloatArray

    def __post_init__(self) -> None:
        freeze_alike(self, *self.__dataclass_fields__, shape=("f", "w"), finite=False)

    @property
    def rms_radius_mm(self) -> FloatArray:
        """Root mean square distance from the mean, (f, w) [mm]."""
        return np.sqrt(self.xx_mm2 + self.yy_mm2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spots:
    """Traced rays of every field and wavelength."""

    rays: Rays  # Shape (f, w, n), in the frame of the image plane
    # (f, w, n) Area of the launch plane represented by a ray, 0 for lost rays; times irradiance and cosine of the field
    # angle it is the flux of the ray
    area_mm2: FloatArray

    def __post_init__(self) -> None:
        freeze(self, "area_mm2", shape=("f", "w", "n"))


def weighted_mean(value: FloatArray, weight: FloatArray) -> FloatArray:
    """Mean over the last axis, by weights that are not negative; NaN where all of them are 0."""
    total = weight.sum(-1)
    weighted = np.where(weight > 0.0, value, 0.0) * weight
    return np.divide(weighted.sum(-1), total, out=np.full(weighted.shape[:-1], np.nan), where=total > 0.0)


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
        Points of the launch disk (`optics.rays.entrance_pupil.launch_disks`). If left out: quadrature inside the
        vignetted pupil, whose outline is a clear stop in front or is traced (`optics.rays.vignetted_pupil`); for a lens
        whose apertures have holes 2048 scrambled Sobol points and the 2048 opposite ones, which leave some 5e-4 px of
        the shift between bands where spots have 4 px RMS.
    order : (int, int)
        Rings and azimuths of the quadrature.
    collimation : (w, 3), optional
        Of sources behind a collimator, slopes and vergence at the wavelengths (`optics.light.collimation`).

    Returns
    -------
    Spots
        Rays on the image plane, with the area of the pupil represented by each.

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
    holed = any(surface.holed for surface in lens.surfaces)
    points = samples
    if points is None and stop_in_front(lens):
        points = gauss_disk(*order)
    elif points is None and holed:
        points = _opposite_points()
    spots = None if points is None else _launch_disk_spots(lens, stars, waves, points, collimation)
    if spots is None or (samples is None and not holed and not np.all(spots.rays.ok)):
        spots = _vignetted_spots(lens, stars, waves, order, collimation)
    if not np.any(spots.rays.ok):
        raise ConvergenceError(f"lens {lens.name!r}: no ray of any field reaches the image plane")
    return spots


def _measured_spots(
    lens: LensSystem, measured: MeasuredLens, stars: FloatArray, waves: FloatArray, order: tuple[int, int]
) -> Spots:
    """Points that stand for the Gaussians of a measured lens, as rays do for a spot; their moments are exact
    (Gauss-Laguerre nodes in half the square of the distance, equidistant azimuths)."""
    lens.check_wavelength(waves)
    position = measured.position_mm(stars[:, None, :], waves)
    x, y = np.moveaxis(position, -1, 0)
    fraction, offset, covariance = measured.psf.at(x, y, waves)
    half_square, weight = np.polynomial.laguerre.laggauss(order[0])
    azimuth = 2.0 * np.pi * (np.arange(order[1]) + 0.5) / order[1]
    unit_x, unit_y = (np.outer(np.sqrt(2.0 * half_square), f(azimuth)).ravel() for f in (np.cos, np.sin))
    xx, yy, xy = np.moveaxis(covariance[..., None, :], -1, 0)  # x = L u with the Cholesky factor L of the covariance
    x = position[..., None, None, 0] + offset[..., None, 0] + np.sqrt(xx) * unit_x
    y = position[..., None, None, 1] + offset[..., None, 1] + xy / np.sqrt(xx) * unit_x
    y = y + np.sqrt(yy - xy * xy / xx) * unit_y
    light = measured.relative(position) / stars[:, None, 2] * (0.25 * np.pi * measured.aperture_mm**2)
    area = (light[..., None] * fraction)[..., None] * np.repeat(weight / order[1], order[1])
    inside = np.isfinite(position[..., :1])  # the field that was measured
    shape = (*inside.shape[:2], -1)
    rays = Rays.create(
        x_mm=np.where(inside, x.reshape(shape), 0.0),
        y_mm=np.where(inside, -y.reshape(shape), 0.0),
        direction=light_direction(stars)[:, None, None, :],
        wavelength_nm=waves[:, None],
    )
    return _lit_spots(rays, np.where(inside, area.reshape(shape), 0.0), np.broadcast_to(inside, rays.x.shape))


def _lit_spots(rays: Rays, area_mm2: FloatArray, lit: FloatArray) -> Spots:
    """Spots in which the other rays count as vignetted."""
    return Spots(rays=replace(rays, status=np.where(lit, rays.status, VIGNETTED)), area_mm2=area_mm2 * lit)


def _opposite_points() -> PupilSamples:
    """Sobol points of the unit disk, each with its opposite: terms odd in the pupil cancel in means, such as defocus;
    the same number of plain Sobol points leaves eight times the error behind holes."""
    half = sobol_disk(SOBOL_POINTS // 2, seed=SOBOL_SEED)
    x, y, weight = (np.concatenate(v) for v in ((half.x, -half.x), (half.y, -half.y), (half.weight, half.weight)))
    return PupilSamples(x=x, y=y, weight=0.5 * weight)


def _launch_disk_spots(
    lens: LensSystem, stars: FloatArray, waves: FloatArray, samples: PupilSamples, collimation: FloatArray | None
) -> Spots:
    """Rays of launch disks that cover these fields and wavelengths."""
    pupil = entrance_pupil(lens) if stop_in_front(lens) else launch_disks(lens, stars, waves)
    grid = np.broadcast_to(waves, (len(stars), waves.size))
    rays = trace(lens, _collimator_rays(lens, star_rays(pupil, samples, stars[:, None, :], grid), collimation))
    return Spots(rays=rays, area_mm2=np.where(rays.ok, samples.weight * pupil.area_mm2, 0.0))


def _vignetted_spots(
    lens: LensSystem, stars: FloatArray, waves: FloatArray, order: tuple[int, int], collimation: FloatArray | None
) -> Spots:
    """Rays inside the vignetted pupils."""
    pupils = vignetted_pupils(lens, stars, waves, rings=order[0], arms=order[1])
    start = Rays.create(
        x_mm=pupils.x_mm,
        y_mm=pupils.y_mm,
        z_mm=pupils.z_mm,
        direction=light_direction(stars)[:, None, None],
        wavelength_nm=waves[:, None],
    )
    start.opl_mm[...] = start.x * start.dx + start.y * start.dy + start.z * start.dz
    rays = trace(lens, _collimator_rays(lens, start, collimation))
    return _lit_spots(rays, pupils.area_mm2, rays.ok & (pupils.area_mm2 > 0.0))


def _collimator_rays(lens: LensSystem, rays: Rays, collimation: FloatArray | None) -> Rays:
    """Rays (f, w, n) of the light of a collimator, about the centre of the pupil, as the renderer's launch disk."""
    if collimation is None:
        return rays
    pupil = entrance_pupil(lens) if stop_in_front(lens) else None
    x, y = (rays.x, rays.y) if pupil is None else (rays.x - pupil.x_mm, rays.y - pupil.y_mm)
    dx, dy, dz = decollimated((rays.dx, rays.dy, rays.dz), x, y, tuple(collimation.T[..., None]), np.sqrt)
    return replace(rays, dx=dx, dy=dy, dz=dz)


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
    x, y = (np.where(spots.rays.ok, v, 0.0) for v in (spots.rays.x, spots.rays.y))
    mean_x, mean_y = weighted_mean(x, area), weighted_mean(y, area)
    dx, dy = x - mean_x[..., None], y - mean_y[..., None]
    return SpotMoments(
        x_mm=mean_x,
        y_mm=mean_y,
        xx_mm2=weighted_mean(dx * dx, area),
        xy_mm2=weighted_mean(dx * dy, area),
        yy_mm2=weighted_mean(dy * dy, area),
        transmitted_mm2=area.sum(axis=-1),
    )
