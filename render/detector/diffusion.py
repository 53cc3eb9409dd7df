"""Charge diffusion on an image rendered without it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.special import ive

from optics.errors import DomainError


def diffusion_kernel(sigma_px: float) -> NDArray[np.float64]:
    """Discrete Gaussian, T(k) = exp(-t) I_k(t) with t = sigma^2 (Lindeberg 1990, IEEE PAMI 12, 234).

    Its variance is exactly sigma^2 for any sigma, it is positive, and two in a row equal one of the summed variance; a
    sampled or pixel-integrated Gaussian has none of that below half a pixel.
    """
    # -> (2 r + 1,)
    if not 0.0 <= sigma_px <= 50.0:
        raise DomainError(f"sigma_px = {sigma_px:g} px; charge diffusion must be 0 to 50 px")
    radius = int(np.ceil(9.0 * sigma_px)) + 8  # what lies beyond is below 1e-13 of the variance
    order = np.abs(np.arange(-radius, radius + 1))
    weights: NDArray[np.float64] = np.asarray(ive(order, sigma_px**2), np.float64)
    return weights / weights.sum()


def diffuse(electrons: NDArray[Any], sigma_px: float) -> NDArray[np.float32]:
    """Convolve an image (h, w) with the diffusion kernel; charge reflected at the border, so that none is lost.

    The star renderer integrates the true kernel over the pixels and is exact; an image that is already made of pixels
    only allows this, exact in flux, centroid and second moments.
    """
    kernel = diffusion_kernel(sigma_px)
    rows = correlate1d(np.asarray(electrons, np.float64), kernel, axis=0, mode="reflect")
    return np.asarray(correlate1d(rows, kernel, axis=1, mode="reflect"), np.float32)
