"""Effective PSFs rendered from the lens: the pixel-integrated image of a star at every sub-pixel phase."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from render.camera import Camera
from render.records import EffectivePsf, StarField
from render.tracer import Tracer

__all__ = ["pixel_share", "render_epsf"]

FloatArray = NDArray[np.float64]

TOLERANCE = 1e-3
"""Of the pupil quadrature: an error of 1e-3 at half a cycle per pixel and beyond moves a fit by some 1e-5 px."""


def pixel_share(centre: FloatArray, position: FloatArray, diffusion_px: float) -> FloatArray:
    """Share of light landing at ``position`` (r,) that a pixel centred at ``centre`` (m,) collects along one axis, (r, m)."""
    offset = centre[None, :] - position[:, None]
    if diffusion_px == 0.0:
        return (np.abs(offset) <= 0.5).astype(float)
    scale = 1.0 / (math.sqrt(2.0) * diffusion_px)
    return 0.5 * (erf((offset + 0.5) * scale) - erf((offset - 0.5) * scale))


def render_epsf(
    mi: Any, camera: Camera, stars: StarField, *, oversampling: int = 4, half_size_px: float = 7.0
) -> list[list[EffectivePsf]]:
    """Effective PSF of every star and band, centred on the bundle mean.

    Each is the exact pixel integral of the traced bundle convolved with the diffusion kernel, sampled ``oversampling``
    times per pixel; it is computed apart from the image (`render.star_kernel`), ray by ray in NumPy.

    Parameters
    ----------
    mi : module
        Mitsuba with an active variant.
    camera : Camera
        The camera.
    stars : StarField
        Where in the field, with which spectra.
    oversampling : int
        Samples per pixel.
    half_size_px : float
        Half-width of the grid.

    Returns
    -------
    list of list of EffectivePsf
        ``[star][band]``.
    """
    tracer = Tracer(mi, camera, tolerance=TOLERANCE)
    bundles = tracer.bundles(stars)
    half = round(half_size_px * oversampling)
    centre = np.arange(-half, half + 1) / oversampling
    result = []
    for star in range(len(stars)):
        row = []
        for band in range(len(stars.band)):
            x, y, weight = bundles(star, band)
            total = weight.sum()
            mean_x, mean_y = (weight @ x) / total, (weight @ y) / total
            along_x = pixel_share(centre, x - mean_x, camera.charge_diffusion_px)
            along_y = pixel_share(centre, y - mean_y, camera.charge_diffusion_px)
            row.append(EffectivePsf(values=(along_y * weight[:, None]).T @ along_x / total, oversampling=oversampling))
        result.append(row)
    return result
