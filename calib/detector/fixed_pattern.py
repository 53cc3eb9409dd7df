"""Fixed pattern of a detector: PRNU and DSNU with standard errors, the response of the pixels, dead pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter

from calib.detector.mean_frame import MeanFrame
from calib.detector.photon_transfer import PhotonTransfer, deviation
from calib.measure.statistics.robust import robust_sigma
from calib.records import NoiseModel
from optics.arrays import FloatArray
from optics.errors import DomainError

LEAST_RESPONSE = 0.2
"""Pixels with less of the mean response are dead."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedPattern:
    """Photo response and dark signal non-uniformity, with standard errors."""

    prnu: float  # Standard deviation of the response over its mean
    prnu_error: float
    dsnu_e: float  # Standard deviation of the dark signal
    dsnu_error_e: float


def fixed_pattern(
    flat: MeanFrame,
    dark: MeanFrame,
    transfer: PhotonTransfer,
    *,
    usable: ArrayLike | None = None,
    smooth_px: int | None = None,
) -> FixedPattern:
    """PRNU and DSNU (EMVA 1288 Release 4.0): spatial variance of mean frames less that of temporal noise.

    The PRNU is that of the flat minus the dark, without the dark pattern and its correlation with the response. The
    errors follow from the scatter of the pixels, for any distribution of the pattern.

    Parameters
    ----------
    flat, dark : MeanFrame
        Flats at about half of the range, and darks of the same exposure; two frames each at least.
    transfer : PhotonTransfer
        Gain, for the DSNU in electrons.
    usable : (h, w) bool, optional
        Pixels to use; all if not given.
    smooth_px : int, optional
        Side (odd) of a running mean that is subtracted first, for uneven light; pixels nearer to the edge than half of
        it are not used. The mean of all pixels if not given.

    Returns
    -------
    FixedPattern
        PRNU, DSNU and their standard errors.

    Raises
    ------
    DomainError
        Fewer than two flats or darks.
    """
    if min(flat.frames, dark.frames) < 2:
        raise DomainError(f"{flat.frames} flats and {dark.frames} darks; two of each are needed for PRNU and DSNU")
    chosen = np.ones(dark.mean_dn.shape, bool) if usable is None else np.asarray(usable, bool)
    dark_noise = dark.variance_dn2 / dark.frames
    light = flat.mean_dn - dark.mean_dn
    level = float(light[chosen].mean())
    prnu, prnu_error = _deviation(light, flat.variance_dn2 / flat.frames + dark_noise, chosen, smooth_px)
    dsnu, dsnu_error = _deviation(dark.mean_dn, dark_noise, chosen, smooth_px)
    gain = transfer.gain_dn_per_e
    return FixedPattern(
        prnu=prnu / level,
        prnu_error=prnu_error / level,
        dsnu_e=dsnu / gain,
        dsnu_error_e=float(np.hypot(dsnu_error, dsnu * transfer.gain_error_dn_per_e / gain)) / gain,
    )


def _deviation(
    image: FloatArray, noise: FloatArray, chosen: NDArray[np.bool_], smooth_px: int | None
) -> tuple[float, float]:
    """Standard deviation of a pattern, and its error, from an image and the variance of its noise."""
    if smooth_px is None:
        residual = image[chosen] - image[chosen].mean()
        variance: FloatArray | float = 1.0 - 1.0 / max(int(chosen.sum()), 2)
    else:
        fraction = uniform_filter(chosen.astype(float), smooth_px)
        mean = uniform_filter(np.where(chosen, image, 0.0), smooth_px) / np.maximum(fraction, 1e-9)
        margin = smooth_px // 2  # at the edges uneven light would not cancel
        inner = np.pad(np.ones([n - 2 * margin for n in chosen.shape], bool), margin)
        chosen = chosen & inner
        residual, variance = (image - mean)[chosen], 1.0 - 1.0 / (smooth_px**2 * fraction[chosen])
    square = residual**2 / variance - noise[chosen]
    return deviation(float(square.mean()), float(square.std(ddof=1) / np.sqrt(square.size)))


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatResponse:
    """Response of the pixels from a mean flat."""

    response: FloatArray  # (h, w) Mean over the usable pixels 1; 1 where a pixel is not usable
    error: FloatArray  # (h, w) Standard deviation by the noise of the frames
    unusable: NDArray[np.bool_]  # (h, w) Excluded, or below `LEAST_RESPONSE`
    level_e: float  # Median of the electrons above the darks

    @property
    def pixel_to_pixel(self) -> float:
        """Standard deviation of the response from pixel to pixel, noise included and uneven light excluded.

        Robust, from differences of neighbouring columns over the square root of two.
        """
        unusable = self.unusable[:, 1:] | self.unusable[:, :-1]
        return robust_sigma(np.diff(self.response, axis=1)[~unusable]) / float(np.sqrt(2.0))

    @property
    def noise(self) -> float:
        """RMS of ``error`` over the usable pixels."""
        return float(np.sqrt(np.mean(self.error[~self.unusable] ** 2)))


def flat_response(
    electrons: FloatArray, usable: NDArray[np.bool_], *, floor_e2: float, flats: int, darks: int
) -> FlatResponse:
    """Response of the pixels of a mean flat less the mean dark or the offset (h, w), with its error by noise.

    ``floor_e2``: variance of a pixel without light in a frame; ``flats``, ``darks``: frames of the means, 0 darks for a
    subtracted offset without noise.
    """
    level = float(np.median(electrons[usable])) if usable.any() else 0.0
    usable = usable & (electrons > LEAST_RESPONSE * level)
    mean = float(electrons[usable].mean()) if usable.any() else 1.0
    variance = (np.maximum(electrons, 0.0) + floor_e2) / flats + (floor_e2 / darks if darks else 0.0)
    return FlatResponse(
        response=np.where(usable, electrons / mean, 1.0),
        error=np.where(usable, np.sqrt(variance) / mean, 0.0),
        unusable=~usable,
        level_e=level,
    )


def reduced_variance(
    mean_e: FloatArray,
    light_e: FloatArray,
    noise: NoiseModel,
    *,
    dark_e: FloatArray | None = None,
    dark_frames: int = 0,
    response: FloatArray | None = None,
    response_error: FloatArray | None = None,
    prnu: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Variance of a pixel of reduced frames [e-^2]: temporal, and fixed in all of them.

    ``mean_e`` is the mean of frames less the mean dark frame or the offset, over the response; ``light_e`` the same
    without background; ``dark_e`` the subtracted mean of ``dark_frames`` less the offset, whose charge adds noise;
    ``prnu`` the residual standard deviation of the response.
    """
    divisor: FloatArray | float = 1.0 if response is None else response
    floor = noise.floor_e2 + (np.zeros(mean_e.shape) if dark_e is None else dark_e)
    temporal = np.maximum(np.maximum(mean_e, 0.0) * divisor + floor, 0.0) / divisor**2
    fixed = (prnu * light_e) ** 2
    if dark_frames:
        fixed = fixed + np.maximum(floor, 0.0) / dark_frames / divisor**2
    if response_error is not None:
        fixed = fixed + (light_e * response_error / divisor) ** 2
    return temporal, fixed
