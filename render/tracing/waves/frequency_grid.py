"""Sums of plane waves over a window, by a non-uniform Fourier transform on a grid of frequencies.

Rays are spread over a regular grid of frequencies; two matrix products lead from the grid to the samples of the window.
A single-precision transform for the windows of stars: 0.7 times the processor time of FINUFFT at 57 samples along an
axis, 1.1 at 95, 2.7 at 325 (``python benchmarks/waves.py --transform``).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from optics.arrays import FloatArray
from render.tracing.waves.pixel_kernel import FieldSampling, window_samples
from render.tracing.waves.plane_waves import RayArrays

SPREAD = 7
"""Points of the grid of frequencies along an axis to which a ray is spread: errors of 5e-7 of the largest amplitude."""
OVERSAMPLING = 2
"""Ratio of the step that the width of the window needs to the step of that grid."""

PRODUCT_S = 7.2e-11
"""Time of one product of two complex numbers in a matrix product of single precision, on one AVX2 core of 2024.

The unit in which the operations of an image are counted: ``python benchmarks/waves.py --operations`` measures it and
the two numbers below. Only their ratios decide between the methods.
"""
IMAGE_PRODUCTS = 1.25e7
"""Products that take as long as what every image of a wavelength needs whatever its size: a sixth of it in the sum, the
rest in the rays that determine its order and in its pixels (``--cost``)."""
RAY_PRODUCTS = 5970.0
"""Products that take as long as one ray: its interpolation, phase, and spread over `SPREAD` x `SPREAD` points."""


@cache
def _grid(field: FieldSampling, count: int) -> tuple[float, NDArray[np.complex64]]:
    """Step of the grid of frequencies [cycles/px], and the matrix from it (n,) to samples (count,) about 0."""
    step = 1.0 / (OVERSAMPLING * count * field.light_step)
    reach = math.ceil(0.5 * field.highest / step + 0.5 * SPREAD + 1.0)
    samples_px = (np.arange(count) - 0.5 * (count - 1)) * field.light_step
    node, weight = np.polynomial.legendre.leggauss(80)
    kernel = weight * _bell(node)
    spread = 0.5 * SPREAD * (np.cos(np.pi * SPREAD * step * np.outer(samples_px, node)) @ kernel)
    waves = np.exp(2j * np.pi * step * np.outer(samples_px, np.arange(-reach, reach + 1)))
    return step, np.asarray(waves / spread[:, None], np.complex64)


def _bell(t: NDArray[np.floating]) -> NDArray[np.floating]:
    """Exponential of a semicircle on [-1, 1] (Barnett, Magland & af Klinteberg 2019, SIAM J. Sci. Comput. 41, C479)."""
    beta = math.pi * math.sqrt((SPREAD * (1.0 - 0.5 / OVERSAMPLING)) ** 2 - 0.8)
    return np.asarray(np.exp(beta * (np.sqrt(np.maximum(1.0 - t * t, 0.0)) - 1.0)))


class _Spreader:
    """Spreads rays over a grid of frequencies; its work arrays serve all wavelengths with as many rays."""

    def __init__(self, step: float) -> None:
        self.step, self.rays = step, 0

    def __call__(self, fx: FloatArray, fy: FloatArray, coefficient: NDArray[np.complex128]) -> NDArray[np.complex64]:
        """Coefficients (p,) of p frequencies about 0, on as many points (c, c) of the grid as they need."""
        reach = math.ceil(max(np.abs(fx).max(), np.abs(fy).max()) / self.step + 0.5 * SPREAD + 1.0)
        count = 2 * reach + 1
        if self.rays != len(fx):
            self.rays = len(fx)
            self.value = np.empty((self.rays, SPREAD, SPREAD), np.float32)
            self.index = np.empty((self.rays, SPREAD, SPREAD), np.int32)
            self.columns = np.arange(0, self.index.size + 1, SPREAD**2, dtype=np.int32)
        first, weight = [], []
        for frequency in (fx, fy):
            position = frequency / self.step + reach
            start = np.ceil(position - 0.5 * SPREAD).astype(np.int32)
            distance = (start - position).astype(np.float32)[:, None] + np.arange(SPREAD, dtype=np.float32)
            first.append(start)
            weight.append(_bell(distance * np.float32(2.0 / SPREAD)))
        steps = np.arange(SPREAD, dtype=np.int32)
        np.add((first[1] * count + first[0])[:, None, None], steps[:, None] * count + steps, out=self.index)
        np.multiply(weight[1][:, :, None], weight[0][:, None, :], out=self.value)
        spread = csc_array((self.value.ravel(), self.index.ravel(), self.columns), shape=(count**2, len(fx)))
        parts = spread @ np.stack([coefficient.real, coefficient.imag], axis=-1).astype(np.float32)
        return np.asarray(np.ascontiguousarray(parts).view(np.complex64).reshape(count, count))


def window_light(
    rays: Callable[[int], RayArrays],
    weights: FloatArray,
    corner_px: FloatArray,
    window_px: float,
    field: FieldSampling,
    *,
    pad_px: float,
) -> NDArray[np.float32]:
    """Light per px^2 (i, i) of one star and band on the samples of a window, rows first."""
    # rays(k), weights (k,) of the wavelengths, corner_px (2,)
    count = len(window_samples(field, window_px, pad_px))
    step, waves = _grid(field, count)
    spreader, middle = _Spreader(step), corner_px + 0.5 * window_px
    light = np.zeros((count, count), np.float32)
    for k in np.flatnonzero(weights):
        x, y, fx, fy, turns, amplitude = rays(int(k))
        if not len(x):
            continue
        phase = turns + fx * (middle[0] - x) + fy * (middle[1] - y)
        phase = phase - phase[0]
        phase = phase - np.rint(phase)
        fx, fy = (f - 0.5 * (f.min() + f.max()) for f in (fx, fy))  # a tilt of all waves leaves |U| as it is
        grid = spreader(fx, fy, (amplitude * math.sqrt(math.pi)) * np.exp(2j * np.pi * phase))
        unused = (waves.shape[1] - len(grid)) // 2
        to_samples = waves[:, unused : waves.shape[1] - unused]
        u = to_samples @ grid @ to_samples.T
        light += np.float32(weights[k]) * (u.real**2 + u.imag**2)
    return light


def image_products(rays: float, field: FieldSampling, window_px: float, pad_px: float) -> float:
    """Operations of an image of one wavelength, in products of complex numbers (`PRODUCT_S`)."""
    count = len(window_samples(field, window_px, pad_px))
    frequencies = _grid(field, count)[1].shape[1]
    return IMAGE_PRODUCTS + RAY_PRODUCTS * rays + count * frequencies * (count + frequencies)
