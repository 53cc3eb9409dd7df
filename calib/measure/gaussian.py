"""Maximum likelihood of a Gaussian star integrated over square pixels; widths along columns and rows are fitted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from calib.measure.scoring import fit_stamps
from calib.records import NoiseModel, Stamps, StarTable
from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = ["GaussianCentroider", "GaussianModel", "draw_gaussian"]


def _profile(size: int, centre: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integral over each of ``size`` pixels, (n, size), and its derivatives by the centre and by ln sigma."""
    z = (np.arange(size + 1) - 0.5 - centre[:, None]) / sigma[:, None]
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
            sigma = np.exp(np.clip(parameters[:, 3:5], -3.0, 3.0))
        else:
            sigma = np.full((n, 2), self.sigma_px)
        value_x, slope_x, width_x = _profile(self.window[1], parameters[:, 0], sigma[:, 0])
        value_y, slope_y, width_y = _profile(self.window[0], parameters[:, 1], sigma[:, 1])
        flux = parameters[:, 2, None]
        jacobian = np.empty((n, parameters.shape[1], *self.window))
        np.multiply((flux * value_y)[:, :, None], slope_x[:, None, :], out=jacobian[:, 0])
        np.multiply((flux * slope_y)[:, :, None], value_x[:, None, :], out=jacobian[:, 1])
        np.multiply(value_y[:, :, None], value_x[:, None, :], out=jacobian[:, 2])
        if self.sigma_px is None:
            np.multiply((flux * value_y)[:, :, None], width_x[:, None, :], out=jacobian[:, 3])
            np.multiply((flux * width_y)[:, :, None], value_x[:, None, :], out=jacobian[:, 4])
        flat = jacobian.reshape(n, parameters.shape[1], -1)
        return flat[:, 2] * flux, flat


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussianCentroider:
    """Maximum likelihood of x, y, flux and widths of a pixel-integrated Gaussian, see `calib.measure.scoring`.

    Attributes
    ----------
    sigma_px : float or None
        Known width of the Gaussian (before the pixel); None: both widths are fitted.
    sigma_start_px : float
        First guess of the widths.
    fit_background : bool
        Fit a constant per star too, instead of trusting ``Stamps.background_e``.
    max_shift_px : float
        Farthest plausible distance from the start position; beyond it the star is flagged ``NOT_CONVERGED``.
    tolerance : float
        Last step in units of the standard deviation.
    max_iterations : int
        Most steps taken.
    """

    name: ClassVar[str] = "gaussian"
    sigma_px: float | None = None
    sigma_start_px: float = 0.8
    fit_background: bool = False
    max_shift_px: float = 2.0
    tolerance: float = 0.01
    max_iterations: int = 50

    def __post_init__(self) -> None:
        for label, value in (("sigma_px", self.sigma_px), ("sigma_start_px", self.sigma_start_px)):
            if value is not None and not 0.05 <= value <= 20:
                raise DomainError(f"{label} = {value} px; a width of 0.05 to 20 px is needed")

    def measure(self, stamps: Stamps, noise: NoiseModel) -> StarTable:
        """Position, flux and covariance of every stamp."""
        window = (stamps.electrons.shape[1], stamps.electrons.shape[2])
        start = np.full(2, np.log(self.sigma_start_px)) if self.sigma_px is None else np.empty(0)
        return fit_stamps(
            stamps,
            noise,
            lambda part, rows: GaussianModel(window, self.sigma_px),
            start,
            fit_background=self.fit_background,
            max_shift_px=self.max_shift_px,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )


def draw_gaussian(x_px: FloatArray, y_px: FloatArray, sigma_px: float, shape: tuple[int, int]) -> FloatArray:
    """Images (n, h, w) of unit stars at columns ``x_px`` and rows ``y_px`` (n,) of windows of ``shape`` = (h, w)."""
    theta = np.column_stack([x_px, y_px, np.ones(len(x_px))])
    return GaussianModel(shape, sigma_px).evaluate(theta, np.arange(len(theta)))[0].reshape(len(theta), *shape)
