"""A Gaussian star integrated over square pixels, and its derivatives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from calib.records import FLUX, X, Y
from optics.arrays import FloatArray

__all__ = ["GaussianModel", "draw_gaussian"]

LN_SIGMA_X, LN_SIGMA_Y = 3, 4
"""Parameters after x, y and flux."""
LN_SIGMA_LIMIT = 3.0
"""Widths stay within e^-3 to e^3 px, whatever step a hopeless star asks for."""


def _profile(size: int, centre: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integral over each of ``size`` pixels, (n, size), and its derivatives by the centre and by ln sigma."""
    z = (np.arange(size + 1) - 0.5 - centre[:, None]) / sigma[:, None]
    # exp(-700) is the smallest that does not underflow
    density = np.exp(-0.5 * np.minimum(z * z, 1400.0)) / np.sqrt(2.0 * np.pi)
    return np.diff(ndtr(z)), -np.diff(density) / sigma[:, None], -np.diff(density * z)


class GaussianModel:
    """`scoring.PixelModel` with parameters x, y, flux, ln(sigma_x), ln(sigma_y).

    Parameters
    ----------
    window : tuple of int
        Rows and columns of the stamps.
    sigma_px : float, optional
        Fixed width along both axes; the parameters are then x, y, flux only.
    """

    def __init__(self, window: tuple[int, int], sigma_px: float | None = None) -> None:
        self.window = window
        self.sigma_px = sigma_px
        self.max_step = np.array([0.5, 0.5, np.inf] + [0.3, 0.3] * (sigma_px is None))

    def evaluate(self, parameters: FloatArray, rows: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Signal and derivatives, see `scoring.PixelModel`."""
        n = len(rows)
        if self.sigma_px is None:
            sigma = np.exp(np.clip(parameters[:, LN_SIGMA_X : LN_SIGMA_Y + 1], -LN_SIGMA_LIMIT, LN_SIGMA_LIMIT))
        else:
            sigma = np.full((n, 2), self.sigma_px)
        value_x, slope_x, width_x = _profile(self.window[1], parameters[:, X], sigma[:, X])
        value_y, slope_y, width_y = _profile(self.window[0], parameters[:, Y], sigma[:, Y])
        flux = parameters[:, FLUX, None]
        jacobian = np.empty((n, parameters.shape[1], *self.window))
        np.multiply((flux * value_y)[:, :, None], slope_x[:, None, :], out=jacobian[:, X])
        np.multiply((flux * slope_y)[:, :, None], value_x[:, None, :], out=jacobian[:, Y])
        np.multiply(value_y[:, :, None], value_x[:, None, :], out=jacobian[:, FLUX])
        if self.sigma_px is None:
            np.multiply((flux * value_y)[:, :, None], width_x[:, None, :], out=jacobian[:, LN_SIGMA_X])
            np.multiply((flux * width_y)[:, :, None], value_x[:, None, :], out=jacobian[:, LN_SIGMA_Y])
        flat = jacobian.reshape(n, parameters.shape[1], -1)
        return flat[:, FLUX] * flux, flat


def draw_gaussian(x_px: FloatArray, y_px: FloatArray, sigma_px: float, shape: tuple[int, int]) -> FloatArray:
    """Images (n, h, w) of unit stars at columns ``x_px`` and rows ``y_px`` (n,) of windows of ``shape`` = (h, w)."""
    theta = np.column_stack([x_px, y_px, np.ones(len(x_px))])
    return GaussianModel(shape, sigma_px).evaluate(theta, np.arange(len(theta)))[0].reshape(len(theta), *shape)
