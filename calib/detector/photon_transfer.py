"""Photon transfer of flats: system gain and read noise from the growth of the temporal variance with the mean.

EMVA 1288 Release 4.0, sec. 6.6 (Janesick 2007): var = var of the darks + K (mean - mean of the darks), K in DN/e-. The
flicker of the lamp, whose relative variance follows from the levels of the frames, is subtracted. The standard errors
follow from the scatter of the pixels about the line, as of a ratio of means (Cochran 1977, sec. 2.11); they include the
noise of the darks, read noise that differs from pixel to pixel, and any distribution of the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.detector.mean_frame import MeanFrame
from optics.arrays import FloatArray
from optics.errors import DomainError

QUANTISATION_DN2 = 1.0 / 12.0
"""Variance of rounding to whole DN (EMVA 1288)."""


def deviation(variance: float, error: float) -> tuple[float, float]:
    """Standard deviation and its error from a variance and the error of that; (0, root of the error) below 0."""
    value = float(np.sqrt(max(variance, 0.0)))
    return value, error / (2.0 * value) if value > 0.0 else float(np.sqrt(error))


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotonTransfer:
    """System gain and read noise, with their standard errors."""

    gain_dn_per_e: float  # K
    gain_error_dn_per_e: float
    read_noise_e: float  # RMS over the pixels, rounding excluded; NaN with a gain that is not positive
    read_noise_error_e: float
    pixels: int  # Number of pixels used


def flat_photon_transfer(
    flats: Sequence[MeanFrame],
    dark: MeanFrame,
    *,
    usable: ArrayLike | None = None,
    dark_variance_dn2: float | None = None,
) -> PhotonTransfer:
    """Gain and read noise from flats of one or several levels and darks of the same exposure.

    Parameters
    ----------
    flats : sequence of MeanFrame
        Flats of two or more frames, a record per level; below saturation.
    dark : MeanFrame
        Darks; two frames, unless their variance is given.
    usable : (h, w) bool, optional
        Pixels to use; all if not given.
    dark_variance_dn2 : float, optional
        Temporal variance of the darks from another source, without error.

    Returns
    -------
    PhotonTransfer
        Gain, read noise and their standard errors.

    Raises
    ------
    DomainError
        No flat, a single frame without a stated variance, or fewer than two pixels.
    """
    if not flats or min(flat.frames for flat in flats) < 2 or (dark.frames < 2 and dark_variance_dn2 is None):
        raise DomainError("photon transfer needs two frames of every level of light and two darks at least")
    chosen = np.ones(dark.mean_dn.shape, bool) if usable is None else np.asarray(usable, bool)
    count = int(chosen.sum())
    if count < 2:
        raise DomainError(f"photon transfer of {count} pixels; at least two are needed")
    stated = dark_variance_dn2 is not None
    floor = np.full(count, dark_variance_dn2) if stated else dark.variance_dn2[chosen]
    numerator, denominator = np.zeros(count), np.zeros(count)
    for flat in flats:
        light = (flat.mean_dn - dark.mean_dn)[chosen]
        growth = _without_flicker(flat, flat.mean_dn - dark.mean_dn)[chosen] - floor
        weight = light.mean() * (flat.frames - 1) / flat.variance_dn2[chosen].mean() ** 2
        numerator += weight * growth
        denominator += weight * light
    gain = float(numerator.mean() / denominator.mean())
    influence = (numerator - gain * denominator) / denominator.mean()
    scale = gain if gain > 0.0 else float("nan")
    read_e2 = (float(floor.mean()) - QUANTISATION_DN2) / scale**2
    read_influence = (floor - floor.mean()) / scale**2 - 2.0 * read_e2 * influence / scale
    read_noise, read_noise_error = deviation(read_e2, float(read_influence.std(ddof=1) / np.sqrt(count)))
    return PhotonTransfer(
        gain_dn_per_e=gain,
        gain_error_dn_per_e=float(influence.std(ddof=1) / np.sqrt(count)),
        read_noise_e=read_noise,
        read_noise_error_e=read_noise_error,
        pixels=count,
    )


def _without_flicker(flat: MeanFrame, light_dn: FloatArray) -> FloatArray:
    """Temporal variance (h, w) [DN^2] without that of the lamp, from the levels of the frames."""
    mean_noise = flat.variance_dn2.mean() / flat.variance_dn2.size
    flicker = (flat.level_dn.var(ddof=1) - mean_noise) / light_dn.mean() ** 2
    return np.asarray(flat.variance_dn2 - flicker * light_dn**2)


def block_gain(flat: MeanFrame, dark: MeanFrame, *, block_px: int) -> tuple[FloatArray, FloatArray]:
    """System gain in square blocks of pixels, and its standard error: maps (h, w) [DN/e-], constant within a block.

    The error of a block of a single pixel is NaN.
    """
    shape = flat.mean_dn.shape
    edges = [np.arange(0, size, block_px) for size in shape]

    def total(values: FloatArray) -> FloatArray:
        return np.add.reduceat(np.add.reduceat(values, edges[0], axis=0), edges[1], axis=1)

    def spread(values: FloatArray) -> FloatArray:
        tiled = np.repeat(np.repeat(values, block_px, axis=0), block_px, axis=1)
        return tiled[: shape[0], : shape[1]]

    light = flat.mean_dn - dark.mean_dn
    growth = _without_flicker(flat, light) - dark.variance_dn2
    block_light, pixels = np.maximum(total(light), 1e-9), total(np.ones(shape))
    gain = spread(total(growth) / block_light)
    scatter = total((growth - gain * light) ** 2) * pixels / np.where(pixels > 1, pixels - 1, np.nan)
    return gain, spread(np.sqrt(scatter) / block_light)
