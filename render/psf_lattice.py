"""PSFs on a lattice over a detector, and the landing points of stars without an image."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from optics.arrays import FloatArray
from render.camera import Camera
from render.records import EffectivePsf, PsfGrid, StarField
from render.sensor import StarSensor
from render.sky.star_light import StarLight
from render.tracing.psf import TOLERANCE, epsf_tracer, render_epsf, trailed
from render.tracing.tracer import Tracer

TRACE_AT_ONCE = 2000
GRID_LONG_SIDE = 9
"""PSFs along the longer side. Between neighbours a PSF changes its shape by so little that the nearest one serves."""
GRID_OVERSAMPLING = 4
GRID_INSET = 0.97
"""Part of the half-width that the grid spans, so that its outermost bundles stay on the detector."""


class PsfLattice:
    """Renders effective PSFs of one camera at regular steps from edge to edge; its tracer is prepared once.

    Parameters
    ----------
    sensor : StarSensor
        Camera and detector.
    light : StarLight
        The pass band.
    spacing_px : float
        About the distance of the PSFs; there are at least two along each axis.
    half_size_px, oversampling, sobol_log2_rays : int
        As in `render.tracing.psf.render_epsf` and `Tracer`.
    """

    def __init__(
        self,
        sensor: StarSensor,
        light: StarLight,
        *,
        spacing_px: float,
        half_size_px: int,
        oversampling: int = 4,
        sobol_log2_rays: int = 16,
    ) -> None:
        self._sensor, self._light = sensor, light
        self._half_size_px, self._oversampling = half_size_px, oversampling
        self._tracer = Tracer(sensor.camera, tolerance=TOLERANCE, sobol_log2_rays=sobol_log2_rays)
        self.lay_out(spacing_px)

    @property
    def size_px(self) -> tuple[int, int]:
        """Columns and rows of the detector."""
        return self._sensor.camera.width_px, self._sensor.camera.height_px

    def lay_out(self, spacing_px: float) -> None:
        """Change the distance of the PSFs."""
        self.columns, self.rows = (1 + max(1, round(n / spacing_px)) for n in self.size_px)
        axes = (np.linspace(-0.5, n - 0.5, k) for n, k in zip(self.size_px, (self.columns, self.rows), strict=True))
        x, y = (v.ravel() for v in np.meshgrid(*axes))
        self._direction = self._sensor.direction_at(x, y)

    def render(self, temperature_k: float) -> tuple[EffectivePsf, ...]:
        """PSFs of one colour, row by row, each centred on the mean of the rays of that colour."""
        stars = self._light.stars(self._direction, 5.0, temperature_k)
        images = render_epsf(self._tracer, stars, half_size_px=self._half_size_px, oversampling=self._oversampling)
        return tuple(row[0] for row in images)


def ray_means_px(camera: Camera, stars: StarField, *, sobol_log2_rays: int = 16) -> FloatArray:
    """Mean landing points (n, 2) [px] of rays of stars of one band in cam: no image, no noise; NaN without light."""
    # one pixel of an image is enough where only rays count
    tiny = replace(camera, width_px=1, height_px=1, centre_px=camera.centre_px)
    tracer = Tracer(tiny, sobol_log2_rays=sobol_log2_rays)
    parts = [np.zeros((0, 2))]
    for start in range(0, len(stars), TRACE_AT_ONCE):
        rows = slice(start, start + TRACE_AT_ONCE)
        some = replace(stars, direction=stars.direction[rows], photon_rate=stars.photon_rate[rows])
        if tracer.pupil.exact:  # a mean needs few rays where nothing cuts the bundle
            parts.append(tracer.bundle_means(some, rings=8, arms=20)[:, 0])
        else:
            truth = tracer.render(some, exposure_s=1.0).truth
            parts.append(np.column_stack([truth.bundle_x_px, truth.bundle_y_px]))
    return np.concatenate(parts)


def render_psf_grid(
    sensor: StarSensor,
    light: StarLight,
    *,
    temperature_k: float,
    window_px: int,
    trail_px: FloatArray | None = None,
    long_side: int = GRID_LONG_SIDE,
    by_grid: bool = False,
) -> PsfGrid:
    """Effective PSFs of one star colour on a grid over a detector, for star fits.

    Parameters
    ----------
    sensor, light : StarSensor, StarLight
        Camera and pass band.
    temperature_k : float
        Of the star.
    window_px : int
        Window of the fit.
    trail_px : (2,), optional
        Uniform trail of the stars.
    long_side : int
        PSFs along the longer side.
    by_grid : bool
        As of `render.tracing.psf.epsf_tracer`, for many PSFs by waves.
    """
    camera = sensor.camera
    size = np.array([camera.width_px, camera.height_px])
    columns, rows = np.maximum(3, np.rint(long_side * size / size.max()).astype(int) // 2 * 2 + 1)
    x, y = (GRID_INSET * n / 2 * np.linspace(-1.0, 1.0, count) for n, count in zip(size, (columns, rows), strict=True))
    place = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) + camera.centre_px
    direction = sensor.direction_at(place[:, 0], place[:, 1])
    stars = light.stars(direction, 5.0, temperature_k)
    reach_px = window_px // 2 + 2 + (0 if trail_px is None else math.ceil(0.5 * float(np.abs(trail_px).max())))
    tracer = epsf_tracer(camera, by_grid=by_grid)
    rendered = render_epsf(tracer, stars, oversampling=GRID_OVERSAMPLING, half_size_px=reach_px)
    psfs = tuple(row[0] for row in rendered)
    if trail_px is not None and trail_px.any():
        psfs = tuple(trailed(psf, trail_px) for psf in psfs)
    return PsfGrid(psfs=psfs, place_px=place)


def refined(grid: PsfGrid, factor: int) -> PsfGrid:
    """The same grid with ``factor`` steps for each of its own, PSFs between its nodes blended linearly."""
    x, y = np.unique(grid.place_px[:, 0]), np.unique(grid.place_px[:, 1])
    values = np.stack([psf.values for psf in grid.psfs]).reshape(len(y), len(x), *grid.psfs[0].values.shape)
    for axis, count in ((0, len(y)), (1, len(x))):
        at = np.linspace(0.0, count - 1.0, (count - 1) * factor + 1)
        low = np.minimum(at.astype(int), count - 2)
        part = (at - low).reshape(-1, *[1] * (values.ndim - axis - 1))
        values = (1.0 - part) * values.take(low, axis=axis) + part * values.take(low + 1, axis=axis)
    finer = [np.interp(np.arange((len(one) - 1) * factor + 1) / factor, np.arange(len(one)), one) for one in (x, y)]
    flat = values.reshape(-1, *values.shape[2:])
    oversampling = grid.psfs[0].oversampling
    return PsfGrid(
        psfs=tuple(EffectivePsf(values=one, oversampling=oversampling) for one in flat),
        place_px=np.stack(np.meshgrid(*finer), axis=-1).reshape(-1, 2),
    )
