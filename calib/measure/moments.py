"""Moment centroids: centre of gravity, thresholded, and with an iterated Gaussian window (SExtractor XWIN).

No PSF is needed; the price is noise from the whole window, or a bias that depends on where in its pixel the star sits
(S-curve). The covariance propagates the temporal noise, sum over pixels of (dx/dd)^2 variance(d); it does not know
that bias.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from calib.measure.flags import StarFlag, has_flag
from calib.records import NoiseModel, Stamps, StarTable
from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = ["CentreOfGravity", "ThresholdedCentreOfGravity", "WindowedCentroid", "half_light_radius"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CentreOfGravity:
    """Centre of gravity ``x = sum(s x) / sum(s)`` of the light s above the background.

    Attributes
    ----------
    half_width_px : int or None
        The sums run over ``2 half_width_px + 1`` pixels each way around the pixel nearest the start position; None:
        the whole stamp.
    """

    name: ClassVar[str] = "cog"
    half_width_px: int | None = 3

    def __post_init__(self) -> None:
        _check_half_width(self.half_width_px)

    def measure(self, stamps: Stamps, noise: NoiseModel) -> StarTable:
        """Position, flux of the window and covariance of every stamp."""
        light, used = _windowed_light(stamps, self.half_width_px)
        return _gravity(stamps, noise, light, used, light)


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdedCentreOfGravity:
    """Centre of gravity of what rises above a threshold: ``s = max(light - T, 0)``, as star trackers use it.

    The flux is that of the whole window, without threshold.

    Attributes
    ----------
    threshold_sigma : float
        T in units of the noise of a pixel without star.
    half_width_px : int or None
        As in `CentreOfGravity`.
    """

    name: ClassVar[str] = "tcog"
    threshold_sigma: float = 3.0
    half_width_px: int | None = 3

    def __post_init__(self) -> None:
        _check_half_width(self.half_width_px)
        if not self.threshold_sigma >= 0:
            raise DomainError(f"threshold_sigma = {self.threshold_sigma}; it must not be negative")

    def measure(self, stamps: Stamps, noise: NoiseModel) -> StarTable:
        """Position, flux of the window and covariance (selection of pixels taken as fixed) of every stamp."""
        light, used = _windowed_light(stamps, self.half_width_px)
        sky = np.sqrt(noise.variance_e2(stamps.background_e))
        above = np.maximum(light - self.threshold_sigma * sky[:, None, None], 0.0) * used
        return _gravity(stamps, noise, above, used, light)


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowedCentroid:
    """Centroid under a Gaussian window that follows the star, SExtractor's XWIN_IMAGE and YWIN_IMAGE.

    ``x <- x + 2 sum(w s (x_i - x)) / sum(w s)`` until the step is small (Bertin, SExtractor manual, "Windowed
    positional parameters"). SExtractor also cuts the window at 4 sigma, where it has fallen to 3e-4; here the stamp
    is the only cut. The covariance is that of the fixed point, with the true slope of the sums at the solution.

    Attributes
    ----------
    sigma_px : float or None
        Standard deviation of the window. None: SExtractor's choice, half-light *diameter* / 2.3548, star by star.
    tolerance_px : float
        Last step; SExtractor stops at 2e-4.
    max_iterations : int
        Most steps taken.
    """

    name: ClassVar[str] = "windowed"
    sigma_px: float | None = None
    tolerance_px: float = 1e-6
    max_iterations: int = 40

    def __post_init__(self) -> None:
        if self.sigma_px is not None and not self.sigma_px > 0:
            raise DomainError(f"sigma_px = {self.sigma_px} px; the window must have a positive width")

    def measure(self, stamps: Stamps, noise: NoiseModel) -> StarTable:
        """Position, flux of the stamp and covariance of every stamp."""
        n, height, width = stamps.electrons.shape
        light, used = _windowed_light(stamps, None)
        variance = np.where(used, stamps.electrons + noise.floor_e2, 0.0)
        position = stamps.start_px - stamps.corner_px
        if self.sigma_px is None:
            radius = half_light_radius(light, position[:, 0], position[:, 1])
            sigma = np.clip(2.0 * radius / 2.354820045, 0.5, 0.25 * max(height, width))
        else:
            sigma = np.full(n, float(self.sigma_px))
        iterations = np.zeros(n, np.int64)
        done = np.zeros(n, dtype=bool)
        active = np.flatnonzero(used.any(axis=(1, 2)))
        x, y = position[:, 0].copy(), position[:, 1].copy()
        lost = np.array(~used.any(axis=(1, 2)), dtype=bool)
        for _ in range(self.max_iterations):
            if not active.size:
                break
            sums = _window_sums(light[active], x[active], y[active], sigma[active])
            total = sums[:, 0, 0]
            dark = total <= 0
            safe = np.where(dark, 1.0, total)
            step_x, step_y = 2.0 * sums[:, 0, 1] / safe, 2.0 * sums[:, 1, 0] / safe
            size = np.hypot(step_x, step_y)
            shrink = np.where(dark, 0.0, np.minimum(1.0, 1.0 / np.maximum(size, 1e-300)))  # at most 1 px a step
            x[active] += shrink * step_x
            y[active] += shrink * step_y
            iterations[active] += 1
            lost[active] |= dark
            done[active] = ~dark & (size < self.tolerance_px)
            inside = (np.abs(x[active] - (width - 1) / 2) < width) & (np.abs(y[active] - (height - 1) / 2) < height)
            active = active[~dark & ~done[active] & inside]
        covariance = _window_covariance(light, variance, x, y, sigma)
        flags = np.array(stamps.flags)
        flags[~done & ~lost] |= int(StarFlag.NOT_CONVERGED)
        return _table(
            stamps,
            x=x,
            y=y,
            flux=light.sum(axis=(1, 2)),
            covariance=covariance,
            iterations=iterations,
            flags=flags,
            lost=lost,
        )


def half_light_radius(light: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Radius [px] around (x, y) that holds half the light of each stamp (n, h, w), from the growth curve."""
    n, height, width = light.shape
    radius2 = (np.arange(width) - x[:, None])[:, None, :] ** 2 + (np.arange(height) - y[:, None])[:, :, None] ** 2
    order = np.argsort(radius2.reshape(n, height * width), axis=1)
    growth = np.cumsum(np.take_along_axis(light.reshape(n, height * width), order, axis=1), axis=1)
    half = 0.5 * growth[:, -1:]
    first = np.argmax(growth >= half, axis=1)
    # k pixels cover the area pi r^2 = k; between two pixels the growth is taken as linear in area
    k = np.arange(n)
    before = np.where(first > 0, growth[k, np.maximum(first - 1, 0)], 0.0)
    rise = growth[k, first] - before
    part = np.divide(half[:, 0] - before, rise, out=np.ones(n), where=rise > 0)
    return np.sqrt((first + np.clip(part, 0.0, 1.0)) / np.pi)


def _check_half_width(half_width_px: int | None) -> None:
    if half_width_px is not None and half_width_px < 1:
        raise DomainError(f"half_width_px = {half_width_px} px; it must be at least 1")


def _windowed_light(stamps: Stamps, half_width_px: int | None) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Light above the background and the pixels that count, both zero outside the sub-window."""
    used = stamps.valid
    if half_width_px is not None:
        centre = np.rint(stamps.start_px - stamps.corner_px)
        near_x = np.abs(np.arange(used.shape[2]) - centre[:, 0, None]) <= half_width_px
        near_y = np.abs(np.arange(used.shape[1]) - centre[:, 1, None]) <= half_width_px
        used = used & near_y[:, :, None] & near_x[:, None, :]
    return np.where(used, stamps.electrons - stamps.background_e[:, None, None], 0.0), used


def _gravity(
    stamps: Stamps, noise: NoiseModel, weight: FloatArray, used: NDArray[np.bool_], light: FloatArray
) -> StarTable:
    _, height, width = weight.shape
    columns, rows = np.arange(width, dtype=float), np.arange(height, dtype=float)
    total = weight.sum(axis=(1, 2))
    lost = ~(total > 0)
    safe = np.where(lost, 1.0, total)
    x = weight.sum(axis=1) @ columns / safe
    y = weight.sum(axis=2) @ rows / safe
    # electrons + floor is an unbiased estimate of each pixel's variance; clipping single pixels would raise the sum
    variance = np.where(used, stamps.electrons + noise.floor_e2, 0.0)
    counted = variance * (weight != 0)
    along_x, along_y = columns - x[:, None], rows - y[:, None]
    powers_x, powers_y = _powers(along_x), _powers(along_y)
    second = powers_y @ counted @ powers_x.swapaxes(1, 2)  # [n, power of y, power of x]
    covariance = np.empty((len(x), 3, 3))
    covariance[:, 0, 0] = second[:, 0, 2] / safe**2
    covariance[:, 1, 1] = second[:, 2, 0] / safe**2
    covariance[:, 0, 1] = covariance[:, 1, 0] = second[:, 1, 1] / safe**2
    covariance[:, 0, 2] = covariance[:, 2, 0] = second[:, 0, 1] / safe
    covariance[:, 1, 2] = covariance[:, 2, 1] = second[:, 1, 0] / safe
    covariance[:, 2, 2] = variance.sum(axis=(1, 2))
    flags = np.array(stamps.flags)
    outside = (np.abs(x - (width - 1) / 2) > width / 2) | (np.abs(y - (height - 1) / 2) > height / 2)
    flags[outside & ~lost] |= int(StarFlag.NOT_CONVERGED)
    return _table(
        stamps,
        x=x,
        y=y,
        flux=light.sum(axis=(1, 2)),
        covariance=covariance,
        iterations=np.ones(len(x), np.int64),
        flags=flags,
        lost=lost,
    )


def _powers(offset: FloatArray) -> FloatArray:
    return np.stack([np.ones_like(offset), offset, offset**2], axis=1)


def _window(size: int, centre: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    offset = np.arange(size) - centre[:, None]
    return offset, np.exp(-0.5 * np.minimum((offset / sigma[:, None]) ** 2, 1400.0))


def _window_sums(light: FloatArray, x: FloatArray, y: FloatArray, sigma: FloatArray) -> FloatArray:
    """``sum w s (y_i - y)^a (x_i - x)^b`` as [n, a, b], a and b from 0 to 2."""
    along_x, weight_x = _window(light.shape[2], x, sigma)
    along_y, weight_y = _window(light.shape[1], y, sigma)
    left = _powers(along_y) * weight_y[:, None, :]
    right = _powers(along_x) * weight_x[:, None, :]
    return left @ light @ right.swapaxes(1, 2)


def _window_covariance(
    light: FloatArray, variance: FloatArray, x: FloatArray, y: FloatArray, sigma: FloatArray
) -> FloatArray:
    """Covariance of the root of ``f = sum w s (x_i - x)``: M^-1 C M^-T with the slope M and the noise C of f."""
    n = len(x)
    sums = _window_sums(light, x, y, sigma)
    squared = _window_sums(variance, x, y, sigma / np.sqrt(2.0))  # the window squared is a narrower window
    single = _window_sums(variance, x, y, sigma)
    inverse2 = 1.0 / sigma**2
    slope = np.empty((n, 2, 2))
    slope[:, 0, 0] = sums[:, 0, 2] * inverse2 - sums[:, 0, 0]
    slope[:, 1, 1] = sums[:, 2, 0] * inverse2 - sums[:, 0, 0]
    slope[:, 0, 1] = slope[:, 1, 0] = sums[:, 1, 1] * inverse2
    determinant = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] ** 2
    bad = ~(np.abs(determinant) > 1e-30)
    safe = np.where(bad, 1.0, determinant)
    inverse = np.empty_like(slope)
    inverse[:, 0, 0], inverse[:, 1, 1] = slope[:, 1, 1] / safe, slope[:, 0, 0] / safe
    inverse[:, 0, 1] = inverse[:, 1, 0] = -slope[:, 0, 1] / safe
    noise = np.empty((n, 2, 2))
    noise[:, 0, 0], noise[:, 1, 1] = squared[:, 0, 2], squared[:, 2, 0]
    noise[:, 0, 1] = noise[:, 1, 0] = squared[:, 1, 1]
    covariance = np.empty((n, 3, 3))
    covariance[:, :2, :2] = inverse @ noise @ inverse.swapaxes(1, 2)
    mixed = -(inverse @ np.stack([single[:, 0, 1], single[:, 1, 0]], axis=1)[:, :, None])[:, :, 0]
    covariance[:, :2, 2] = covariance[:, 2, :2] = mixed
    covariance[:, 2, 2] = variance.sum(axis=(1, 2))
    covariance[bad] = np.nan
    return covariance


def _table(
    stamps: Stamps,
    *,
    x: FloatArray,
    y: FloatArray,
    flux: FloatArray,
    covariance: FloatArray,
    iterations: NDArray[np.int64],
    flags: NDArray[np.uint32],
    lost: NDArray[np.bool_],
) -> StarTable:
    flags[lost] |= int(StarFlag.NO_DATA)
    lost = has_flag(flags, StarFlag.NO_DATA)
    diagonal = np.diagonal(covariance, axis1=1, axis2=2)
    covariance = np.where((lost | ~np.all(diagonal > 0, axis=1))[:, None, None], np.nan, covariance)
    return StarTable(
        x_px=np.where(lost, np.nan, x + stamps.corner_px[:, 0]),
        y_px=np.where(lost, np.nan, y + stamps.corner_px[:, 1]),
        flux_e=np.where(lost, np.nan, flux),
        background_e=stamps.background_e,
        covariance=covariance,
        chi2=np.full(len(x), np.nan),
        iterations=iterations,
        flags=flags,
    )
