"""Effective PSFs from traced rays by NumPy alone: no renderer takes part (`render.tracing.psf` has the renderer's)."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from optics.arrays import FloatArray
from optics.errors import DomainError
from render.records import EffectivePsf

__all__ = ["pixel_shares", "ray_epsf", "trailed"]


def pixel_shares(cells: FloatArray, cells_per_px: int) -> FloatArray:
    """Light of pixels at every whole number of cells, (..., n + 1 - cells_per_px, the same), from cells (..., n, n)."""
    running = np.pad(cells.cumsum(-2).cumsum(-1), [(0, 0)] * (cells.ndim - 2) + [(1, 0), (1, 0)])
    low, high = running[..., :-cells_per_px], running[..., cells_per_px:]
    return np.asarray(
        (high[..., cells_per_px:, :] - high[..., :-cells_per_px, :])
        - (low[..., cells_per_px:, :] - low[..., :-cells_per_px, :])
    )


def ray_epsf(
    x_px: FloatArray,
    y_px: FloatArray,
    weight: FloatArray,
    *,
    diffusion_px: float,
    oversampling: int = 8,
    half_size_px: int = 7,
) -> EffectivePsf:
    """Effective PSF of one bundle of rays, centred on its mean.

    Rays are counted in cells of 1/``oversampling`` pixel, the cells convolved with the diffusion kernel and added up to
    pixels. Counting is exact for pixels at whole cells from the mean; rays have to lie closer than the kernel is wide.

    Parameters
    ----------
    x_px, y_px : (n,)
        Column and row of each ray.
    weight : (n,)
        Light of each ray, not negative.
    diffusion_px : float
        Standard deviation of the Gaussian charge diffusion.
    oversampling : int
        Samples per pixel, even.
    half_size_px : int
        Half-width of the grid; light beyond it is left out of the values, not of their scale.

    Raises
    ------
    DomainError
        An odd oversampling, or no light.
    """
    if oversampling < 2 or oversampling % 2:
        raise DomainError(f"ray_epsf: oversampling = {oversampling}; an even number of at least 2 is needed")
    total = float(weight.sum())
    if not total > 0.0:
        raise DomainError("ray_epsf: no light; the star is outside the field of the lens")
    half = (2 * half_size_px + 1) * oversampling // 2
    lit = weight > 0.0
    share = weight[lit] / total
    x, y = x_px[lit], y_px[lit]
    column = np.floor((x - share @ x) * oversampling).astype(np.int64) + half
    row = np.floor((y - share @ y) * oversampling).astype(np.int64) + half
    size = 2 * half
    inside = (column >= 0) & (column < size) & (row >= 0) & (row < size)
    counted = np.bincount(row[inside] * size + column[inside], share[inside], size * size)
    cells: FloatArray = np.asarray(counted, np.float64).reshape(size, size)
    if diffusion_px > 0.0:
        cells = gaussian_filter(cells, diffusion_px * oversampling, mode="constant", truncate=5.0)
    return EffectivePsf(values=pixel_shares(cells, oversampling), oversampling=oversampling)


def trailed(psf: EffectivePsf, trail_px: FloatArray) -> EffectivePsf:
    """Effective PSF of a star that moves evenly during the exposure, centred on the middle of its trail.

    The transform of a straight trail is a sinc; the grid has to hold the light of the whole trail.

    Parameters
    ----------
    psf : EffectivePsf
        At rest.
    trail_px : (2,)
        From the first to the last place, columns and rows.
    """
    size = len(psf.values)
    padded = 2 * size
    frequency = np.fft.fftfreq(padded, 1.0 / psf.oversampling)  # cycles per pixel
    along = frequency[None, : size + 1] * trail_px[0] + frequency[:, None] * trail_px[1]
    values = np.fft.irfft2(np.fft.rfft2(psf.values, (padded, padded)) * np.sinc(along), (padded, padded))
    return EffectivePsf(values=values[:size, :size], oversampling=psf.oversampling)
