"""Centroid under an iterated Gaussian window: SExtractor's XWIN and YWIN."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from calib.flags import StarFlag
from calib.measure.centroid_error.s_curve import MomentCentroider, PhaseTable
from calib.measure.centroiding.moments import (
    FWHM_PER_SIGMA,
    Moments,
    half_light_radius,
    light_above_background,
    measured_table,
    pixel_variance,
    powers,
)
from calib.measure.centroiding.options import option
from calib.records import FLUX, NoiseModel, Stamps, StarTable
from optics.arrays import FloatArray

MAX_STEP_PX = 1.0
MIN_SIGMA_PX = 0.5
"""Narrowest window that follows from the light: SExtractor's too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowedCentroid(MomentCentroider):
    """Centroid under a Gaussian window that follows the star, SExtractor's XWIN_IMAGE and YWIN_IMAGE.

    ``x <- x + 2 sum(w s (x_i - x)) / sum(w s)`` until the step is small (Bertin, SExtractor manual, "Windowed
    positional parameters"). SExtractor also cuts the window at 4 sigma, where it has fallen to 3e-4; here the stamp
    is the only cut. The covariance is that of the fixed point, with the true slope of the sums at the solution.
    """

    name: ClassVar[str] = "windowed"
    label: ClassVar[str] = "windowed"
    needs_epsf: ClassVar[bool] = False

    # Standard deviation of the window. None: SExtractor's choice, half-light *diameter* / 2.3548, star by star
    sigma_px: float | None = option(None, above=0, unit="px")
    tolerance_px: float = option(1e-6, above=0, unit="px")  # Last step; SExtractor stops at 2e-4
    max_iterations: int = option(40, at_least=1)  # Most steps taken

    def measure_by(self, stamps: Stamps, noise: NoiseModel, table: PhaseTable | None) -> StarTable:
        """See `MomentCentroider`.

        A Gaussian of variance s^2 under a window of variance w^2 has the moment m with 1/m = 1/s^2 + 1/w^2.
        """
        light, used = light_above_background(stamps, None)
        start = stamps.start_px - stamps.corner_px
        sigma = self._window_sigma(light, start)
        x, y, iterations, converged, lost = self._fixed_point(light, np.asarray(used.any(axis=(1, 2))), start, sigma)
        flags = np.array(stamps.flags)
        flags[~converged & ~lost] |= int(StarFlag.NOT_CONVERGED)
        sums = _window_sums(light, x, y, sigma)
        variance = pixel_variance(stamps, noise, used)
        with np.errstate(divide="ignore", invalid="ignore"):
            narrower = 2.0 * sums.total / (sums.xx + sums.yy) - sigma**-2
        return measured_table(
            stamps,
            x=x,
            y=y,
            light=light,
            covariance=_covariance(sums, variance, x, y, sigma),
            iterations=iterations,
            flags=flags,
            lost=lost,
            moment_px2=np.where(lost, np.nan, 1.0 / np.maximum(narrower, 1e-2)),
            table=table,
        )

    def _window_sigma(self, light: FloatArray, start: FloatArray) -> FloatArray:
        """Standard deviation (n,) of each star's window [px]."""
        n, height, width = light.shape
        if self.sigma_px is not None:
            return np.full(n, float(self.sigma_px))
        radius = half_light_radius(light, start[:, 0], start[:, 1])
        return np.clip(2.0 * radius / FWHM_PER_SIGMA, MIN_SIGMA_PX, 0.25 * max(height, width))

    def _fixed_point(
        self, light: FloatArray, usable: NDArray[np.bool_], start: FloatArray, sigma: FloatArray
    ) -> tuple[FloatArray, FloatArray, NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
        """Positions x, y [px from the window's first pixel], iterations, and whether converged or without light, (n,).

        Every star is iterated until its step is small, its light vanishes, or it leaves the window.
        """
        n, height, width = light.shape
        x, y = start[:, 0].copy(), start[:, 1].copy()
        iterations, converged, lost = np.zeros(n, np.int64), np.zeros(n, dtype=bool), np.array(~usable, dtype=bool)
        active = np.flatnonzero(usable)
        for _ in range(self.max_iterations):
            if not active.size:
                break
            sums = _window_sums(light[active], x[active], y[active], sigma[active])
            dark = sums.total <= 0
            total = np.where(dark, 1.0, sums.total)
            step_x, step_y = 2.0 * sums.x / total, 2.0 * sums.y / total
            size = np.hypot(step_x, step_y)
            shrink = np.where(dark, 0.0, np.minimum(1.0, MAX_STEP_PX / np.maximum(size, 1e-300)))  # no division by 0
            x[active] += shrink * step_x
            y[active] += shrink * step_y
            iterations[active] += 1
            lost[active] |= dark
            converged[active] = ~dark & (size < self.tolerance_px)
            inside = (np.abs(x[active] - (width - 1) / 2) < width) & (np.abs(y[active] - (height - 1) / 2) < height)
            active = active[~dark & ~converged[active] & inside]
        return x, y, iterations, converged, lost


def _window(size: int, centre: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Offsets (n, size) from the centre and the window there; exp(-700) is the smallest that does not underflow."""
    offset = np.arange(size) - centre[:, None]
    return offset, np.exp(-0.5 * np.minimum((offset / sigma[:, None]) ** 2, 1400.0))


def _window_sums(light: FloatArray, x: FloatArray, y: FloatArray, sigma: FloatArray) -> Moments:
    """Moments of the light (n, h, w) about (x, y) under the window."""
    along_x, weight_x = _window(light.shape[2], x, sigma)
    along_y, weight_y = _window(light.shape[1], y, sigma)
    return Moments.of(light, powers(along_y) * weight_y[:, None, :], powers(along_x) * weight_x[:, None, :])


def _covariance(sums: Moments, variance: FloatArray, x: FloatArray, y: FloatArray, sigma: FloatArray) -> FloatArray:
    """Covariance of the root of ``f = sum w s (x_i - x)``: M^-1 C M^-T with the slope M and the noise C of f."""
    squared = _window_sums(variance, x, y, sigma / np.sqrt(2.0))  # the window squared is a narrower window
    single = _window_sums(variance, x, y, sigma)
    inverse2 = 1.0 / sigma**2
    slope_xx, slope_yy, slope_xy = sums.xx * inverse2 - sums.total, sums.yy * inverse2 - sums.total, sums.xy * inverse2
    determinant = slope_xx * slope_yy - slope_xy**2
    singular = ~(np.abs(determinant) > 1e-30)
    determinant = np.where(singular, 1.0, determinant)
    inverse = _symmetric(slope_yy / determinant, slope_xx / determinant, -slope_xy / determinant)
    noise = _symmetric(squared.xx, squared.yy, squared.xy)
    covariance = np.empty((len(x), 3, 3))
    covariance[:, :FLUX, :FLUX] = inverse @ noise @ inverse.swapaxes(1, 2)
    mixed = -(inverse @ np.stack([single.x, single.y], axis=1)[:, :, None])[:, :, 0]
    covariance[:, :FLUX, FLUX] = covariance[:, FLUX, :FLUX] = mixed
    covariance[:, FLUX, FLUX] = variance.sum(axis=(1, 2))
    covariance[singular] = np.nan
    return covariance


def _symmetric(xx: FloatArray, yy: FloatArray, xy: FloatArray) -> FloatArray:
    """Matrices (n, 2, 2)."""
    return np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)
