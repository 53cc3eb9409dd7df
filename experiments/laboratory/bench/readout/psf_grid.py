"""Effective PSFs of one star colour on a grid over the detector, from the lens, for star fits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray
from render.records import EffectivePsf
from render.sensor_file.instrument import Instrument
from render.sky.star_light import StarLight
from render.tracing.psf import epsf_tracer, render_epsf, trailed

LONG_SIDE = 9
"""PSFs along the longer side. Between neighbours a PSF changes its shape by so little that the nearest one serves."""
OVERSAMPLING = 4
INSET = 0.97
"""Share of the half-width that the grid spans, so that its outermost bundles stay on the detector."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PsfGrid:
    """PSFs, each centred on the mean of its rays."""

    psfs: tuple[EffectivePsf, ...]  # Row by row
    place_px: FloatArray  # (n, 2) Where they stand

    def nearest(self, x_px: FloatArray, y_px: FloatArray) -> NDArray[np.int64]:
        """Number of the PSF nearest to places (n,)."""
        at = np.stack([x_px, y_px], axis=-1)
        return np.asarray(((at[:, None] - self.place_px) ** 2).sum(-1).argmin(1))


def render_psf_grid(
    instrument: Instrument,
    light: StarLight,
    *,
    temperature_k: float,
    window_px: int,
    trail_px: FloatArray | None = None,
    long_side: int = LONG_SIDE,
    by_grid: bool = False,
) -> PsfGrid:
    """Render the PSFs of a camera; ``by_grid`` as of `render.tracing.psf.epsf_tracer`, for many of them by waves."""
    camera = instrument.camera
    size = np.array([camera.width_px, camera.height_px])
    columns, rows = np.maximum(3, np.rint(long_side * size / size.max()).astype(int) // 2 * 2 + 1)
    x, y = (INSET * n / 2 * np.linspace(-1.0, 1.0, count) for n, count in zip(size, (columns, rows), strict=True))
    place = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) + camera.centre_px
    direction = instrument.direction_at(place[:, 0], place[:, 1])
    stars = light.stars(direction, 5.0, temperature_k)
    reach_px = window_px // 2 + 2 + (0 if trail_px is None else math.ceil(0.5 * float(np.abs(trail_px).max())))
    tracer = epsf_tracer(camera, by_grid=by_grid)
    rendered = render_epsf(tracer, stars, oversampling=OVERSAMPLING, half_size_px=reach_px)
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
