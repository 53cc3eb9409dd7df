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
from render.tracing.psf import epsf_tracer, render_epsf, trailed
from render.tracing.tracer import Tracer

TRACE_AT_ONCE = 2000
GRID_LONG_SIDE = 9
"""PSFs along the longer side. Between neighbours a PSF changes its shape by so little that the nearest one serves."""
GRID_OVERSAMPLING = 4
"""Samples per pixel; twice as many move a fit by some 1e-3 px where spots are sharpest."""
GRID_INSET = 0.97
"""Fraction of the half-width that the grid spans, so that its outermost bundles stay on the detector."""

Axes = tuple[FloatArray, FloatArray]
"""Columns and rows [px] of a lattice."""


def inset_axes(camera: Camera, long_side: int = GRID_LONG_SIDE) -> Axes:
    """A lattice about the optical axis, within `GRID_INSET` of the detector; odd numbers, near ``long_side``."""
    size = np.array([camera.width_px, camera.height_px])
    counts = np.maximum(3, np.rint(long_side * size / size.max()).astype(int) // 2 * 2 + 1)
    x, y = (
        GRID_INSET * n / 2 * np.linspace(-1.0, 1.0, count) + centre
        for n, count, centre in zip(size, counts, camera.centre_px, strict=True)
    )
    return x, y


def edge_axes(camera: Camera, spacing_px: float) -> Axes:
    """A lattice from edge to edge of the detector, its points about a spacing apart; at least two along each axis."""
    x, y = (np.linspace(-0.5, n - 0.5, 1 + max(1, round(n / spacing_px))) for n in (camera.width_px, camera.height_px))
    return x, y


def psf_tracer(sensor: StarSensor, *, by_grid: bool = False, sobol_log2_rays: int = 16) -> Tracer:
    """Tracer for several grids of one sensor, or (``by_grid``) for many PSFs by waves."""
    return epsf_tracer(sensor.camera, by_grid=by_grid, sobol_log2_rays=sobol_log2_rays)


def render_psf_grid(
    sensor: StarSensor,
    light: StarLight,
    *,
    temperature_k: float,
    window_px: int,
    axes: Axes | None = None,
    trail_px: FloatArray | None = None,
    margin_px: int = 2,
    tracer: Tracer | None = None,
) -> PsfGrid:
    """Effective PSFs of one star colour on a lattice over a detector, each centred on the mean of its rays.

    Parameters
    ----------
    sensor, light : StarSensor, StarLight
        Camera and pass band.
    temperature_k : float
        Of the star.
    window_px, margin_px : int
        Window of the fit, and how much farther a PSF reaches.
    axes : tuple of (c,), (r,), optional
        Columns and rows of the lattice; `inset_axes` by default.
    trail_px : (2,), optional
        Uniform trail of the stars.
    tracer : Tracer, optional
        `psf_tracer` of the sensor.
    """
    columns, rows = axes or inset_axes(sensor.camera)
    position_px = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    stars = light.stars(sensor.direction_at(position_px[:, 0], position_px[:, 1]), 5.0, temperature_k)
    reach_px = window_px // 2 + margin_px
    if trail_px is not None:
        reach_px += math.ceil(0.5 * float(np.abs(trail_px).max()))
    tracer = tracer or psf_tracer(sensor)
    psfs = [psf for (psf,) in render_epsf(tracer, stars, oversampling=GRID_OVERSAMPLING, half_size_px=reach_px)]
    if trail_px is not None and trail_px.any():
        psfs = [trailed(psf, trail_px) for psf in psfs]
    return PsfGrid(psfs=tuple(psfs), place_px=position_px)


def refined(grid: PsfGrid, factor: int) -> PsfGrid:
    """The grid with ``factor`` steps for each step, PSFs between its nodes interpolated linearly."""
    axes = [np.unique(axis) for axis in grid.place_px.T]
    values = np.stack([psf.values for psf in grid.psfs])
    values = values.reshape(len(axes[1]), len(axes[0]), *values.shape[1:])
    for axis, nodes in enumerate(reversed(axes)):
        at = np.linspace(0.0, len(nodes) - 1.0, (len(nodes) - 1) * factor + 1)
        low = np.minimum(at.astype(int), len(nodes) - 2)
        part = (at - low).reshape(-1, *[1] * (values.ndim - axis - 1))
        values = (1.0 - part) * values.take(low, axis=axis) + part * values.take(low + 1, axis=axis)
    x, y = (np.interp(np.arange((len(v) - 1) * factor + 1) / factor, np.arange(len(v)), v) for v in axes)
    oversampling = grid.psfs[0].oversampling
    return PsfGrid(
        psfs=tuple(EffectivePsf(values=psf, oversampling=oversampling) for row in values for psf in row),
        place_px=np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2),
    )


def ray_means_px(camera: Camera, stars: StarField, *, sobol_log2_rays: int = 16) -> FloatArray:
    """Mean landing points (n, 2) [px] of rays of stars of one band in cam: no image, no noise; NaN without light."""
    pixel = replace(camera, width_px=1, height_px=1, centre_px=camera.centre_px)  # rays need no larger image
    tracer = Tracer(pixel, sobol_log2_rays=sobol_log2_rays)
    means = [np.zeros((0, 2))]
    for start in range(0, len(stars), TRACE_AT_ONCE):
        rows = slice(start, start + TRACE_AT_ONCE)
        part = replace(stars, direction=stars.direction[rows], photon_rate=stars.photon_rate[rows])
        if tracer.pupil.exact:  # a mean needs few rays where nothing cuts the bundle
            means.append(tracer.bundle_means(part, rings=8, arms=20)[:, 0])
        else:
            truth = tracer.render(part, exposure_s=1.0).truth
            means.append(np.column_stack([truth.bundle_x_px, truth.bundle_y_px]))
    return np.concatenate(means)
