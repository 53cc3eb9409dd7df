"""A Gaussian star integrated over square pixels, and its derivatives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from calib.records import FLUX, X, Y
from optics.arrays import FloatArray

LN_SIGMA_X, LN_SIGMA_Y = 3, 4
"""Parameters after x, y and flux."""
LN_SIGMA_LIMIT = 3.0
"""Limits of the logarithm of a width [px]."""
WIDTH_PRIOR_PX, WIDTH_PRIOR_LN = 0.4, 0.5
"""Below the first [px], ln sigma is taken as normal about it with the second as its standard deviation.

Light in one or two pixels determines (edge - x) / sigma alone: the likelihood stays the same while sigma goes to 0 and
x to the edge. A Gaussian of 0.4 px is determined at any phase from a flux of 1000 e- on, and optics
and charge diffusion seldom leave less than half of that: positions follow within their stated covariance down to 0.25
px (Monte Carlo of `tests/calib/measure/centroiding/test_narrow_gaussian.py`), and wider stars are as without prior."""


def _profile(size: int, centre: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integral over each of ``size`` pixels, (n, size), and its derivatives by the centre and by ln sigma."""
    z = (np.arange(size + 1) - 0.5 - centre[:, None]) / sigma[:, None]
    # exp(-700) is the smallest that does not underflow
    density = np.exp(-0.5 * np.minimum(z * z, 1400.0)) / np.sqrt(2.0 * np.pi)
    return np.diff(ndtr(z)), -np.diff(density) / sigma[:, None], -np.diff(density * z)


class GaussianModel:
    """`PixelModel` with parameters x, y, flux, ln(sigma_x), ln(sigma_y)."""

    def __init__(self, window: tuple[int, int], sigma_px: float | None = None) -> None:
        self.window = window
        self.sigma_px = sigma_px
        self.max_step = np.array([0.5, 0.5, np.inf] + [0.3, 0.3] * (sigma_px is None))

    def prior(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Slope and negative curvature of the prior of free widths, see `PixelModel`."""
        if self.sigma_px is not None:
            return None
        narrow = np.maximum(np.log(WIDTH_PRIOR_PX) - parameters[:, LN_SIGMA_X:], 0.0)
        if not narrow.any():
            return None
        slope, curvature = np.zeros_like(parameters), np.zeros_like(parameters)
        slope[:, LN_SIGMA_X:] = narrow / WIDTH_PRIOR_LN**2
        curvature[:, LN_SIGMA_X:] = (narrow > 0) / WIDTH_PRIOR_LN**2
        return slope, curvature

    def evaluate(self, parameters: FloatArray, rows: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Signal and derivatives, see `calib.measure.centroiding.maximum_likelihood.PixelModel`."""
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
