"""Sampling of diffraction intensities, and the kernel that makes pixels of the samples.

An intensity has no frequencies above that of its two outermost waves. What diffusion leaves has fewer: samples may be
so coarse that unresolved frequencies are aliased onto other unresolved ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import i0e, roots_legendre

from optics.arrays import FloatArray

LIGHT_RATE = 2.3
"""Samples of |U|^2 per cycle of its highest frequency and px, over 1."""
KERNEL_ERROR = 1e-6
"""Value at which the kernel of a pixel ends."""
UNSEEN = 6e-4
"""Amplitude of a wave of the intensity, left by pixels and diffusion, that images of many stars leave out."""
COARSE_REACH_PX = 3.0
"""Distance over which samples of such images depend on samples of |U|^2."""
DIFFUSED = 2e-5
"""Amplitude of a wave, left by diffusion, below which it is not resolved."""
GUARD = 1.3
"""Gap between the resolved frequencies and the aliases of others [cycles/px]."""


@lru_cache(maxsize=64)
def _roll_off(nodes: int, low: float, high: float, reach_px: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies of a Gauss rule on (0, high), and its weights times a smooth step from 1 at low to 0 at high.

    The step is the integral of the Kaiser-Bessel window whose transform has fallen off at the reach.
    """
    node, weight = roots_legendre(nodes)
    frequency = 0.5 * high * (1.0 + node)
    t = np.linspace(-1.0, 1.0, 4001)
    beta, root = math.pi * (high - low) * reach_px, np.sqrt(np.maximum(1.0 - t * t, 0.0))
    window = np.asarray(i0e(beta * root) / i0e(beta) * np.exp(beta * (root - 1.0)))
    trapezoids = 0.5 * (window[1:] + window[:-1])
    fall = 1.0 - np.concatenate([[0.0], np.cumsum(trapezoids)]) / np.sum(trapezoids)
    step = np.interp((frequency - low) / (0.5 * (high - low)) - 1.0, t, fall, left=1.0, right=0.0)
    return frequency, 0.5 * high * weight * step


@dataclass(frozen=True, slots=True)
class BandLimited:
    """A box convolved with a Gaussian, its spectrum ended smoothly between two frequencies; 0 beyond its reach.

    Integrals of a function without frequencies above ``low``, sampled at no less than ``low + high``, are sums with
    this kernel, but for exp(-pi (high - low) reach). A box of width 0 interpolates.
    """

    low: float  # Frequencies [cycles/px]
    high: float
    reach_px: float  # Distance from the centre at which it ends
    box_px: float = 0.0  # Width of the box
    sigma_px: float = 0.0  # Standard deviation of the Gaussian

    def __call__(self, distance_px: FloatArray) -> FloatArray:
        """Values at distances from its centre."""
        distance = np.abs(distance_px)
        return np.where(distance < self.reach_px, _spline(self)(np.minimum(distance, self.reach_px)), 0.0)

    def slope(self, distance_px: FloatArray) -> FloatArray:
        """Derivatives of the values."""
        distance = np.abs(distance_px)
        slopes = np.sign(distance_px) * _spline(self)(np.minimum(distance, self.reach_px), 1)
        return np.where(distance < self.reach_px, slopes, 0.0)


@lru_cache(maxsize=64)
def _spline(kernel: BandLimited) -> CubicSpline:
    """The kernel on a table of 60 points per cycle of its highest frequency."""
    high, reach = kernel.high, kernel.reach_px
    frequency, weight = _roll_off(64 + 16 * math.ceil(reach * high), kernel.low, high, reach)
    spectrum = weight * np.exp(-2.0 * (np.pi * kernel.sigma_px * frequency) ** 2)
    if kernel.box_px > 0.0:
        spectrum = spectrum * kernel.box_px * np.sinc(kernel.box_px * frequency)
    table = np.linspace(0.0, reach, 8 + math.ceil(reach * 60.0 * high))
    return CubicSpline(table, 2.0 * (np.cos(2.0 * np.pi * np.outer(table, frequency)) @ spectrum))


@dataclass(frozen=True, slots=True)
class FieldSampling:
    """Sampling of the intensities of a camera's stars."""

    highest: float  # Highest frequency of the intensity [cycles/px]
    resolved: float = math.inf  # Highest frequency that is resolved; coarse pixels see little of the intensity's

    @classmethod
    def of(cls, highest: float, sigma_px: float) -> FieldSampling:
        """Sampling that resolves the frequencies which diffusion leaves."""
        if sigma_px == 0.0:
            return cls(highest)
        return cls(highest, math.sqrt(-0.5 * math.log(DIFFUSED)) / (math.pi * sigma_px))

    @property
    def _aliased(self) -> bool:
        """Whether unresolved frequencies may be aliased onto each other."""
        return self.highest + self.resolved + GUARD < LIGHT_RATE * self.highest

    @property
    def light_step(self) -> float:
        """Distance of the samples of |U|^2 [px]."""
        return 1.0 / math.ceil(self.highest + self.resolved + GUARD if self._aliased else LIGHT_RATE * self.highest)

    def pixel(self, box_px: float, sigma_px: float) -> BandLimited:
        """Kernel from samples of |U|^2 to light on pixels or cells after diffusion."""
        low, high = self.resolved if self._aliased else self.highest, 1.0 / self.light_step - self.highest
        residual = math.exp(-2.0 * (math.pi * sigma_px * high) ** 2) / (math.pi * high)
        tail = math.log(max(residual, KERNEL_ERROR) / KERNEL_ERROR) / (math.pi * (high - low))
        return BandLimited(low, high, max(0.5 * box_px + 5.5 * sigma_px + 0.5, tail), box_px, sigma_px)

    def visible(self, sigma_px: float) -> FieldSampling:
        """Sampling of the frequencies that pixels let through after diffusion; higher ones count as 0."""
        frequency = np.linspace(0.5, 0.5 + self.highest, 1000)
        transfer = np.exp(-2.0 * (np.pi * sigma_px * frequency) ** 2) / (np.pi * frequency)
        unseen = frequency[transfer < UNSEEN]
        return FieldSampling(min(self.highest, float(unseen[0]))) if len(unseen) else self


@dataclass(frozen=True, slots=True, eq=False)
class PixelTable:
    """Kernel of a pixel as a table, for many windows."""

    values: FloatArray  # (n,) Fraction of a sample's light, against its distance from the middle of a pixel
    step_px: float  # Of the table
    sample_px: float  # Distance of samples
    pad_px: float  # Margin of samples around a window

    def rows(self, first_px: FloatArray, pixels: int, samples: int) -> NDArray[np.float32]:
        """Weights (s, pixels, samples) for windows whose first pixel lies at distances (s,) beyond the first sample.

        A pixel is a whole number of samples wide, so that weights depend on the distance of a pixel from a sample
        alone: one band of weights, of which every row is a shifted view.
        """
        per_px = round(1.0 / self.sample_px)
        start = np.asarray(first_px) / self.sample_px
        reach = (self.pad_px + 0.5) / self.sample_px
        # number of a pixel times per_px, less the number of a sample
        steps = np.ceil(-start - reach).astype(np.int64)[:, None] + np.arange(math.floor(2.0 * reach) + 1)
        distance = np.abs(steps + start[:, None]) * (self.sample_px / self.step_px)
        index = np.minimum(distance.astype(np.int64), len(self.values) - 2)
        part = np.minimum(distance - index, 1.0)
        values = self.values[index] * (1.0 - part) + self.values[index + 1] * part
        last = (pixels - 1) * per_px
        band = np.zeros((len(start), last + samples), np.float32)
        column = last - steps
        inside = (column >= 0) & (column < band.shape[1])
        star = np.broadcast_to(np.arange(len(start))[:, None], column.shape)
        band[star[inside], column[inside]] = values[inside]
        strides = band.strides[0], -per_px * band.itemsize, band.itemsize
        return np.ascontiguousarray(as_strided(band[:, last:], (len(start), pixels, samples), strides))


@cache
def pixel_table(field: FieldSampling, sigma_px: float) -> PixelTable:
    """Weights of samples for pixels anywhere between them."""
    kernel, step = field.pixel(1.0, sigma_px), 1.0 / 2048.0
    distance_px = np.asarray(np.arange(math.ceil(kernel.reach_px / step) + 2) * step, np.float64)
    values = kernel(distance_px) * field.light_step
    values[-1] = 0.0
    return PixelTable(values, step, field.light_step, kernel.reach_px - 0.5)


@cache
def window_samples(field: FieldSampling, window_px: float, pad_px: float) -> FloatArray:
    """Samples along either axis of a window with a margin, from the window's corner [px]."""
    count = math.ceil((window_px + 2.0 * pad_px) / field.light_step)
    return np.asarray((np.arange(count) - 0.5 * (count - 1)) * field.light_step + 0.5 * window_px, np.float64)


def coarser(fine: FieldSampling, coarse: FieldSampling, window_px: float, pad_px: float) -> NDArray[np.float32]:
    """Matrix (c, f) from fine samples of a window, whose margin is `COARSE_REACH_PX` wider, to coarse samples."""
    kernel = BandLimited(coarse.highest, 1.0 / coarse.light_step - coarse.highest, COARSE_REACH_PX)
    source = window_samples(fine, window_px, pad_px + COARSE_REACH_PX)
    return np.asarray(kernel(window_samples(coarse, window_px, pad_px)[:, None] - source) * fine.light_step, np.float32)
