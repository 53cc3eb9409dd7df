"""Diffraction images over windows of the detector: plane waves summed on samples, samples converted to pixels.

|U|^2 has no frequency beyond twice the aperture of the light, so that samples represent it completely, and an integral
over a pixel after charge diffusion is a sum with a band-limited kernel. The rays' frequencies are irregular; each is
spread over a few points of a regular grid of frequencies with a narrow kernel, a matrix product leads to the samples,
and the kernel is divided out (the non-uniform Fourier transform of Dutt & Rokhlin 1993, SIAM J. Sci. Comput. 14, 1368;
kernel of Barnett, Magland & af Klinteberg 2019, SIAM J. Sci. Comput. 41, C479).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.sparse import csc_array
from scipy.special import i0e, roots_legendre

from optics.arrays import FloatArray
from render.tracing.waves.plane_waves import RayArrays

LIGHT_RATE = 2.3
"""Samples of |U|^2 per cycle of its highest frequency and px, over 1."""
KERNEL_ERROR = 1e-6
"""At which the kernel of a pixel ends."""
UNSEEN = 6e-4
"""Part of a wave of light along an axis, left by pixels and diffusion, that is not kept in images of many stars; the
lens leaves little of it before."""
COARSE_REACH_PX = 3.0
"""Distance over which samples of such images depend on samples of |U|^2."""
DIFFUSED = 2e-5
"""Part of a wave of light that diffusion leaves, beyond which none is looked for."""
APART = 1.3
"""Between the frequencies that are looked for and the copies of others that samples mistake for them [cycles/px]."""
IMAGE_S, RAY_S, TERM_S = 0.9e-3, 4.3e-7, 7.2e-11
"""Processor time of an image, of a ray of it, and of a product of two complex numbers."""
SPREAD = 7
"""Points of the grid of frequencies along an axis to which a ray is spread: errors of 5e-7 of the largest amplitude."""
OVERSAMPLING = 2
"""Ratio of the step that the width of the window needs to the step of that grid."""


@lru_cache(maxsize=64)
def _roll_off(nodes: int, low: float, high: float, reach_px: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies of a Gauss rule on (0, high), and its weights times a smooth step from 1 at low to 0 at high.

    The step is the integral of the Kaiser-Bessel window whose transform has fallen off at the reach.
    """
    node, weight = roots_legendre(nodes)
    f = 0.5 * high * (1.0 + node)
    t = np.linspace(-1.0, 1.0, 4001)
    window = _window(t, math.pi * (high - low) * reach_px)
    fall = 1.0 - np.concatenate([[0.0], np.cumsum(0.5 * (window[1:] + window[:-1]))]) / np.sum(
        0.5 * (window[1:] + window[:-1])
    )
    step = np.interp((f - low) / (0.5 * (high - low)) - 1.0, t, fall, left=1.0, right=0.0)
    return f, 0.5 * high * weight * step


def _window(t: FloatArray, beta: float) -> FloatArray:
    """Kaiser-Bessel window at t in [-1, 1], scaled to 1 in the middle."""
    root = np.sqrt(np.maximum(1.0 - t * t, 0.0))
    return np.asarray(i0e(beta * root) / i0e(beta) * np.exp(beta * (root - 1.0)))


@dataclass(frozen=True, slots=True)
class BandLimited:
    """A box convolved with a Gaussian, its spectrum ended smoothly between two frequencies; 0 beyond its reach.

    Integrals of a function without frequencies above ``low``, sampled at no less than ``low + high``, are sums with
    this kernel, but for exp(-pi (high - low) reach). A box of width 0 stands for a point: interpolation.
    """

    # low, high: Frequencies [cycles/px]
    low: float
    high: float
    reach_px: float  # Where it ends
    # box_px, sigma_px: Width of the box, standard deviation of the Gaussian
    box_px: float = 0.0
    sigma_px: float = 0.0

    def __call__(self, distance_px: FloatArray) -> FloatArray:
        """Values at distances from its centre."""
        distance = np.abs(distance_px)
        values = _spline(self)(np.minimum(distance, self.reach_px))
        return np.where(distance < self.reach_px, values, 0.0)

    def slope(self, distance_px: FloatArray) -> FloatArray:
        """Derivatives of the values."""
        distance = np.abs(distance_px)
        slopes = np.sign(distance_px) * _spline(self)(np.minimum(distance, self.reach_px), 1)
        return np.where(distance < self.reach_px, slopes, 0.0)


@lru_cache(maxsize=64)
def _spline(kernel: BandLimited) -> CubicSpline:
    """The kernel on a table of 60 points per cycle of its highest frequency."""
    high, reach = kernel.high, kernel.reach_px
    f, weight = _roll_off(64 + 16 * math.ceil(reach * high), kernel.low, high, reach)
    spectrum = weight * np.exp(-2.0 * (np.pi * kernel.sigma_px * f) ** 2)
    if kernel.box_px > 0.0:
        spectrum = spectrum * kernel.box_px * np.sinc(kernel.box_px * f)
    table = np.linspace(0.0, reach, 8 + math.ceil(reach * 60.0 * high))
    return CubicSpline(table, 2.0 * (np.cos(2.0 * np.pi * np.outer(table, f)) @ spectrum))


@dataclass(frozen=True, slots=True)
class FieldSampling:
    """Sampling of the fields of a camera's stars."""

    highest: float  # Highest frequency of the intensity [cycles/px]
    kept: float = math.inf  # Highest that is looked for; coarse pixels see little of the intensity's

    @classmethod
    def of(cls, highest: float, sigma_px: float) -> FieldSampling:
        """Sampling of what diffusion leaves."""
        if sigma_px == 0.0:
            return cls(highest)
        return cls(highest, math.sqrt(-0.5 * math.log(DIFFUSED)) / (math.pi * sigma_px))

    @property
    def _few(self) -> bool:
        """Whether samples may mistake high frequencies for others that are not looked for."""
        return self.highest + self.kept + APART < LIGHT_RATE * self.highest

    @property
    def light_step(self) -> float:
        """Distance of the samples of |U|^2 [px]."""
        return 1.0 / math.ceil(self.highest + self.kept + APART if self._few else LIGHT_RATE * self.highest)

    def pixel(self, box_px: float, sigma_px: float) -> BandLimited:
        """Kernel that makes light on pixels or cells, after diffusion, of samples of |U|^2."""
        low, high = self.kept if self._few else self.highest, 1.0 / self.light_step - self.highest
        left = math.exp(-2.0 * (math.pi * sigma_px * high) ** 2) / (math.pi * high)
        tail = math.log(max(left, KERNEL_ERROR) / KERNEL_ERROR) / (math.pi * (high - low))
        reach = max(0.5 * box_px + 5.5 * sigma_px + 0.5, tail)
        return BandLimited(low, high, reach, box_px, sigma_px)

    def seen(self, sigma_px: float) -> FieldSampling:
        """Sampling of what pixels see after diffusion: what lies beyond its highest frequency they take for 0."""
        frequency = np.linspace(0.5, 0.5 + self.highest, 1000)
        passed = np.exp(-2.0 * (np.pi * sigma_px * frequency) ** 2) / (np.pi * frequency)
        unseen = frequency[passed < UNSEEN]
        return FieldSampling(min(self.highest, float(unseen[0]))) if len(unseen) else self

    def table(self, sigma_px: float) -> PixelTable:
        """Weights of samples for pixels that lie anywhere between them."""
        return _pixel_table(self, sigma_px)


@dataclass(frozen=True, slots=True, eq=False)
class PixelTable:
    """Kernel of a pixel as a table, for many windows."""

    values: FloatArray  # (n,) Share of a sample's light, against its distance from the middle of a pixel
    step_px: float  # Of the table
    sample_px: float  # Distance of samples
    pad_px: float  # Margin of samples around a window

    def rows(self, first_px: FloatArray, pixels: int, samples: int) -> NDArray[np.float32]:
        """Weights (s, pixels, samples) for windows whose first pixel lies s distances beyond the first sample.

        They depend on the distance of a pixel from a sample alone, of which a whole number of samples makes a pixel.
        """
        per_px = round(1.0 / self.sample_px)
        start = np.asarray(first_px) / self.sample_px
        reach = (self.pad_px + 0.5) / self.sample_px
        many = math.floor(2.0 * reach) + 1
        steps = np.ceil(-start - reach).astype(np.int64)[:, None] + np.arange(many)  # pixel times per_px less sample
        distance = np.abs(steps + start[:, None]) * (self.sample_px / self.step_px)
        index = np.minimum(distance.astype(np.int64), len(self.values) - 2)
        part = np.minimum(distance - index, 1.0)
        values = self.values[index] * (1.0 - part) + self.values[index + 1] * part
        last = (pixels - 1) * per_px
        band = np.zeros((len(start), last + samples), np.float32)
        place = last - steps
        known = (place >= 0) & (place < band.shape[1])
        star = np.broadcast_to(np.arange(len(start))[:, None], place.shape)
        band[star[known], place[known]] = values[known]
        strides = band.strides[0], -per_px * band.itemsize, band.itemsize
        return np.ascontiguousarray(as_strided(band[:, last:], (len(start), pixels, samples), strides))


@cache
def _pixel_table(field: FieldSampling, sigma_px: float) -> PixelTable:
    kernel = field.pixel(1.0, sigma_px)
    step = 1.0 / 2048.0
    distance = np.asarray(np.arange(math.ceil(kernel.reach_px / step) + 2) * step, np.float64)
    values = kernel(distance) * field.light_step
    values[-1] = 0.0
    return PixelTable(values, step, field.light_step, kernel.reach_px - 0.5)


@cache
def _samples(field: FieldSampling, window_px: float, pad_px: float) -> FloatArray:
    count = math.ceil((window_px + 2.0 * pad_px) / field.light_step)
    return np.asarray((np.arange(count) - 0.5 * (count - 1)) * field.light_step + 0.5 * window_px, np.float64)


def window_samples(field: FieldSampling, window_px: float, pad_px: float) -> FloatArray:
    """Where `window_light` gives the light, along either axis, from the window's corner [px]."""
    return _samples(field, window_px, pad_px)


@cache
def _grid(field: FieldSampling, count: int) -> tuple[float, NDArray[np.complex64]]:
    """Step of the grid of frequencies [cycles/px], and what leads from it (n,) to samples (count,) about 0."""
    step = 1.0 / (OVERSAMPLING * count * field.light_step)
    reach = math.ceil(0.5 * field.highest / step + 0.5 * SPREAD + 1.0)
    place = (np.arange(count) - 0.5 * (count - 1)) * field.light_step
    node, weight = np.polynomial.legendre.leggauss(80)
    kernel = weight * _bell(node)
    spread = 0.5 * SPREAD * (np.cos(np.pi * SPREAD * step * np.outer(place, node)) @ kernel)
    waves = np.exp(2j * np.pi * step * np.outer(place, np.arange(-reach, reach + 1)))
    return step, np.asarray(waves / spread[:, None], np.complex64)


def _bell(t: NDArray[np.floating]) -> NDArray[np.floating]:
    """Kernel on [-1, 1]: exponential of a semicircle."""
    beta = math.pi * math.sqrt((SPREAD * (1.0 - 0.5 / OVERSAMPLING)) ** 2 - 0.8)
    return np.asarray(np.exp(beta * (np.sqrt(np.maximum(1.0 - t * t, 0.0)) - 1.0)))


class _Spreader:
    """Spreads rays over a grid of frequencies; keeps the room that this takes from wavelength to wavelength.

    A non-uniform Fourier transform in single precision, for windows of stars: 0.7 times the processor time of FINUFFT
    at 57 samples along an axis, 1.1 at 95, 2.7 at 325 (``python benchmarks/waves.py --transform``).
    """

    def __init__(self, step: float) -> None:
        self.step = step
        self.value = np.empty((0, SPREAD, SPREAD), np.float32)
        self.index = np.empty((0, SPREAD, SPREAD), np.int32)
        self.columns = np.empty(0, np.int32)

    def __call__(self, fx: FloatArray, fy: FloatArray, coefficient: NDArray[np.complex128]) -> NDArray[np.complex64]:
        """Coefficients (p,) of p frequencies about 0, on as many points (c, c) of the grid as they need."""
        reach = math.ceil(max(np.abs(fx).max(), np.abs(fy).max()) / self.step + 0.5 * SPREAD + 1.0)
        count = 2 * reach + 1
        if len(self.value) != len(fx):
            self.value = np.empty((len(fx), SPREAD, SPREAD), np.float32)
            self.index = np.empty((len(fx), SPREAD, SPREAD), np.int32)
            self.columns = np.arange(0, self.index.size + 1, SPREAD**2, dtype=np.int32)
        first, weight = [], []
        for frequency in (fx, fy):
            place = frequency / self.step + reach
            one = np.ceil(place - 0.5 * SPREAD).astype(np.int32)
            distance = (one - place).astype(np.float32)[:, None] + np.arange(SPREAD, dtype=np.float32)
            first.append(one)
            weight.append(_bell(distance * np.float32(2.0 / SPREAD)))
        steps = np.arange(SPREAD, dtype=np.int32)
        np.add((first[1] * count + first[0])[:, None, None], steps[:, None] * count + steps, out=self.index)
        np.multiply(weight[1][:, :, None], weight[0][:, None, :], out=self.value)
        spread = csc_array((self.value.ravel(), self.index.ravel(), self.columns), shape=(count**2, len(fx)))
        parts = spread @ np.stack([coefficient.real, coefficient.imag], axis=-1).astype(np.float32)
        return np.asarray(np.ascontiguousarray(parts).view(np.complex64).reshape(count, count))


def coarser(fine: FieldSampling, coarse: FieldSampling, window_px: float, pad_px: float) -> NDArray[np.float32]:
    """Matrix (c, f) from fine samples of a window, whose margin is `COARSE_REACH_PX` wider, to coarse samples."""
    rate = 1.0 / coarse.light_step
    kernel = BandLimited(coarse.highest, rate - coarse.highest, COARSE_REACH_PX)
    at = window_samples(fine, window_px, pad_px + COARSE_REACH_PX)
    to = window_samples(coarse, window_px, pad_px)
    return np.asarray(kernel(to[:, None] - at) * fine.light_step, np.float32)


def window_light(
    rays: Callable[[int], RayArrays],
    shares: FloatArray,
    corner_px: FloatArray,
    window_px: float,
    field: FieldSampling,
    *,
    pad_px: float,
) -> NDArray[np.float32]:
    """Light per px^2 (i, i) of one star and band on the samples of a window, rows first."""
    # shares (k,), corner_px (2,)
    samples = _samples(field, window_px, pad_px)
    count = len(samples)
    step, waves = _grid(field, count)
    spreader, middle = _Spreader(step), corner_px + 0.5 * window_px
    light = np.zeros((count, count), np.float32)
    for k in np.flatnonzero(shares):
        x, y, fx, fy, turns, amplitude = rays(int(k))
        if not len(x):
            continue
        fx, fy, phase = _untilted(fx, fy, x, y, turns, middle)
        grid = spreader(fx, fy, (amplitude * math.sqrt(math.pi)) * np.exp(2j * np.pi * phase))
        unused = (waves.shape[1] - len(grid)) // 2
        to_samples = waves[:, unused : waves.shape[1] - unused]
        u = to_samples @ grid @ to_samples.T
        light += np.float32(shares[k]) * (u.real**2 + u.imag**2)
    return light


def window_terms(field: FieldSampling, window_px: float, pad_px: float) -> float:
    """Products of numbers that make an image over a window of frequencies."""
    count = len(_samples(field, window_px, pad_px))
    frequencies = _grid(field, count)[1].shape[1]
    return float(count * frequencies * (count + frequencies))


def image_s(rays: float, terms: float) -> float:
    """Processor time of an image of one wavelength by its numbers of rays and products (`window_terms`).

    Of a usual machine of 2024; ``python benchmarks/waves.py --cost`` compares it with the one at hand.
    """
    return IMAGE_S + RAY_S * rays + TERM_S * terms


def _untilted(
    fx: FloatArray, fy: FloatArray, x: FloatArray, y: FloatArray, turns: FloatArray, origin: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies about the middle of their range, which leaves |U| as it is, and phases at the origin [turns]."""
    phase = turns + fx * (origin[0] - x) + fy * (origin[1] - y)
    middle = [0.5 * (f.min() + f.max()) for f in (fx, fy)]
    phase = phase - phase[0]
    return fx - middle[0], fy - middle[1], phase - np.rint(phase)
