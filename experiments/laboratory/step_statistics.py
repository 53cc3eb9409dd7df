"""Statistics of ACC18's step test (eq. 3-12) on mean centroids of m positions and W stars.

The document differences *consecutive* positions, removes the mean over the stars, and takes the RMS. Two things are in
that number which are not the error of a position: averaged temporal noise, and a factor that depends on how alike the
errors of two neighbouring positions are. With independent errors the factor is sqrt(2); at steps of 0.2 px it is not.
"""

from __future__ import annotations

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = ["common_removed", "document_rms_px", "halved_px", "jackknife_px", "single_rms_px", "step_residual_px"]


def common_removed(values_px: FloatArray) -> FloatArray:
    """Values (m, W, 2) minus their mean over the stars: what the platform did to all of them."""
    return np.asarray(values_px - values_px.mean(axis=1, keepdims=True))


def step_residual_px(mean_px: FloatArray) -> FloatArray:
    """Differences of consecutive positions without their mean over the stars (ACC18 eq. 5-8).

    Parameters
    ----------
    mean_px : (m, W, 2)
        Mean centroids.

    Returns
    -------
    (m - 1, W, 2)

    Raises
    ------
    DomainError
        On fewer than two positions or two stars.
    """
    if mean_px.ndim != 3 or mean_px.shape[0] < 2 or mean_px.shape[1] < 2:
        raise DomainError(f"mean centroids of shape {mean_px.shape}; at least 2 positions of 2 stars are needed")
    return common_removed(np.diff(mean_px, axis=0))


def document_rms_px(mean_px: FloatArray) -> FloatArray:
    """RMS (2,) of the residuals over stars and steps (ACC18 eq. 9-10), as printed: divided by W (M - 1)."""
    return np.asarray(np.sqrt((step_residual_px(mean_px) ** 2).mean((0, 1))))


def halved_px(document_px: FloatArray, sigma_px: FloatArray, frames: int) -> FloatArray:
    """The document's number (2,) as the error of one position, if errors of neighbouring positions were independent.

    Temporal noise averaged over the frames is taken away, the star mean's share is given back, and the rest is divided
    by sqrt(2): ``sqrt((document^2 W / (W - 1) - 2 sigma^2 / N) / 2)``; 0 where nothing is left.

    Parameters
    ----------
    document_px : (2,)
        `document_rms_px`.
    sigma_px : (m, W, 2)
        Standard deviation of a single frame's centroid.
    frames : int
        N behind each mean.
    """
    stars = sigma_px.shape[1]
    pure = document_px**2 * stars / (stars - 1) - 2.0 * (sigma_px**2).mean((0, 1)) / frames
    return np.asarray(np.sqrt(np.maximum(pure, 0.0) / 2.0))


def single_rms_px(error_px: FloatArray, sigma_px: FloatArray | None = None, frames: int = 1) -> FloatArray:
    """RMS error (2,) of a position: mean centroid minus truth, without the common part and the temporal noise.

    Parameters
    ----------
    error_px : (m, W, 2)
        Mean centroid minus truth.
    sigma_px : (m, W, 2), optional
        Standard deviation of a single frame's centroid; nothing is taken away without it.
    frames : int
        N behind each mean.
    """
    stars = error_px.shape[1]
    square = (common_removed(error_px) ** 2).mean((0, 1)) * stars / (stars - 1)
    if sigma_px is not None:
        square = square - (sigma_px**2).mean((0, 1)) / frames
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def jackknife_px(mean_px: FloatArray) -> FloatArray:
    """Standard error (2,) of `document_rms_px` over the choice of stars, leaving out one after the other."""
    stars = mean_px.shape[1]
    if stars < 3:
        return np.full(2, np.nan)
    left = np.stack([document_rms_px(np.delete(mean_px, j, axis=1)) for j in range(stars)])
    return np.asarray(np.sqrt((stars - 1) / stars * ((left - left.mean(0)) ** 2).sum(0)))
