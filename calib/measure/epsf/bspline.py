"""Star images from effective PSFs: a pixel-integrated PSF, shifted and scaled, with derivatives.

Between its samples the PSF is a cubic B-spline. All pixels of a window have the same fraction of a sample, because the
pixel pitch is a whole number of samples; the 16 spline weights are therefore common to the window, and signal and
derivatives are one small matrix product, (3 x 16) times (16 x pixels), per star and step.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import spline_filter

from calib.records import FLUX, X, Y
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.records import EffectivePsf

MARGIN = 12
"""Samples about a PSF: the spline's prefilter decays as 0.27^k, 1e-7 at the border."""
SMEARED_OVERSAMPLING = 8
CACHED_PIXELS = 10_000
"""Pixels of a window, times PSFs, up to which banks are cached: some 16 MB each."""


class EpsfBank:
    """Spline coefficients of one or several effective PSFs of equal oversampling, laid out for fast lookup."""

    def __init__(self, psfs: Sequence[EffectivePsf], window: tuple[int, int]) -> None:
        if not psfs:
            raise DomainError("no EffectivePsf given; at least one is needed")
        factors = {psf.oversampling for psf in psfs}
        if len(factors) != 1:
            raise DomainError(f"EffectivePsf oversamplings {sorted(factors)} differ; one value for all is needed")
        self.oversampling = factors.pop()
        self.window = window
        step = self.oversampling
        # whole pixels, for the phases: a star may lie three pixels beyond any edge of the window
        self.origin = (max(window) + 4) * step
        length = 2 * self.origin + step
        coefficients = np.zeros((len(psfs), length, length))
        for row, psf in enumerate(psfs):
            inner = spline_filter(np.pad(psf.values, MARGIN), order=3, mode="mirror")
            first = self.origin - len(inner) // 2
            low = max(0, -first)
            inner = inner[low : len(inner) - low, low : len(inner) - low]
            coefficients[row, first + low :, first + low :][: len(inner), : len(inner)] = inner
        pixels = length // step
        phases = coefficients.reshape(len(psfs), pixels, step, pixels, step).transpose(0, 2, 4, 1, 3)
        # [psf, phase of the row, of the column, first row, first column, row and column in the window]
        self._patches = sliding_window_view(np.ascontiguousarray(phases), window, axis=(3, 4))
        first_rows, first_columns = self._patches.shape[3:5]
        self._last = np.array([first_rows, first_columns]) * step - 4  # its four taps stay inside the table

    def __len__(self) -> int:
        return len(self._patches)

    def locate(self, x: FloatArray, y: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """First spline coefficient (n, 2) as (row, column) and fraction of a sample (n, 2) for stars in the window."""
        sample = self.origin - np.column_stack([y, x]) * self.oversampling
        cell = np.clip(np.floor(np.nan_to_num(sample)).astype(np.int64), 1, self._last)
        return cell, sample - cell  # beyond the table the fraction leaves 0 ... 1

    def tables(self, psf_index: NDArray[np.int64], cell: NDArray[np.int64]) -> FloatArray:
        """The 16 coefficients of every pixel of the window, (n, 16, pixels)."""
        taps = cell[:, :, None] + np.arange(-1, 3)
        pixel, phase = np.divmod(taps, self.oversampling)
        rows, columns = (phase[:, 0, :, None], pixel[:, 0, :, None]), (phase[:, 1, None, :], pixel[:, 1, None, :])
        patch = self._patches[psf_index[:, None, None], rows[0], columns[0], rows[1], columns[1]]
        return patch.reshape(len(cell), 16, self.window[0] * self.window[1])

    def weights(self, fraction: FloatArray) -> FloatArray:
        """Weights (n, 3, 16) that turn a table into d/dx, d/dy and value of the PSF; zero for stars beyond it."""
        inside = np.all((fraction >= 0.0) & (fraction <= 1.0), axis=1)
        value, slope = cubic_weights(np.where(inside[:, None], fraction, 0.0))
        value *= inside[:, None, None]
        slope *= -self.oversampling  # the star moves right, the sample under a pixel moves left
        out = np.empty((len(fraction), 3, 4, 4))
        np.multiply(value[:, 0, :, None], slope[:, 1, None, :], out=out[:, 0])
        np.multiply(slope[:, 0, :, None], value[:, 1, None, :], out=out[:, 1])
        np.multiply(value[:, 0, :, None], value[:, 1, None, :], out=out[:, 2])
        return out.reshape(len(fraction), 3, 16)


_cached_bank = lru_cache(maxsize=16)(EpsfBank)


def epsf_bank(psfs: Sequence[EffectivePsf], window: tuple[int, int]) -> EpsfBank:
    """The bank of PSFs; of few PSFs in small windows it is cached, since many centroiders use the same PSFs."""
    small = len(psfs) * window[0] * window[1] <= CACHED_PIXELS
    return (_cached_bank if small else EpsfBank)(tuple(psfs), window)


def cubic_weights(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cubic B-spline weights of the four neighbours at fraction ``t`` (...), and their derivatives, (..., 4)."""
    s = 1.0 - t
    value = np.stack([s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3], axis=-1)
    slope = np.stack([-(s**2), 3 * t**2 - 4 * t, 4 * s - 3 * s**2, t**2], axis=-1)
    return value / 6.0, slope / 2.0


class EpsfModel:
    """`PixelModel` of effective PSFs; caches the coefficients of each star while it stays in its cell."""

    def __init__(self, bank: EpsfBank, psf_index: NDArray[np.int64]) -> None:
        self.bank = bank
        self.max_step = np.array([0.5, 0.5, np.inf])
        self._psf = psf_index
        self._cell = np.full((len(psf_index), 2), -1)
        self._table = np.empty((len(psf_index), 16, bank.window[0] * bank.window[1]))

    def prior(self, parameters: FloatArray) -> None:
        """No prior of position and flux."""

    def evaluate(self, parameters: FloatArray, rows: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Signal and derivatives, see `calib.measure.centroiding.maximum_likelihood.PixelModel`."""
        cell, fraction = self.bank.locate(parameters[:, X], parameters[:, Y])
        new = np.flatnonzero(np.any(cell != self._cell[rows], axis=1))
        if new.size:
            self._table[rows[new]] = self.bank.tables(self._psf[rows[new]], cell[new])
            self._cell[rows[new]] = cell[new]
        table = self._table if len(rows) == len(self._table) else self._table[rows]
        jacobian = self.bank.weights(fraction) @ table
        flux = parameters[:, FLUX, None]
        jacobian[:, :FLUX] *= flux[:, :, None]
        return jacobian[:, FLUX] * flux, jacobian


def draw_epsf(epsf: EffectivePsf, x_px: FloatArray, y_px: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Images (n, h, w) of unit stars at columns ``x_px`` and rows ``y_px`` (n,) of windows of ``shape`` = (h, w)."""
    model = EpsfModel(epsf_bank((epsf,), shape), np.zeros(len(x_px), np.int64))
    theta = np.column_stack([x_px, y_px, np.ones(len(x_px))])
    return model.evaluate(theta, np.arange(len(x_px)))[0].reshape(len(x_px), *shape)


def smeared_epsfs(values: FloatArray, path_px: FloatArray) -> list[EffectivePsf]:
    """PSFs (n, m, m), 8 samples per pixel, averaged over the paths (n, t, 2) of their images at equal exposure steps.

    By the shift theorem of the discrete Fourier transform: exact for a band-limited PSF.
    """
    if np.any(path_px):
        side, smeared = values.shape[-1], []
        row, column = np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)
        for psf, path in zip(values, path_px * SMEARED_OVERSAMPLING, strict=True):
            phase = row * path[:, 1, None, None] + column * path[:, 0, None, None]
            transfer = np.exp(-2j * np.pi * phase).mean(0)
            smeared.append(np.fft.irfft2(np.fft.rfft2(psf) * transfer, s=psf.shape))
        values = np.array(smeared)
    return [EffectivePsf(values=psf, oversampling=SMEARED_OVERSAMPLING) for psf in values]
