"""Photon transfer of windows around images at rest, and noise that two frames have in common; no flats, no darks.

The temporal variance of a pixel grows with its mean by the gain K (Janesick 2007). A moving image and a flickering lamp
add variance: their modes (the mean image, and the same shifted by whole pixels, which combine to sub-pixel shifts) are
projected out of every frame, and the variance is corrected for the projection M: the residual of pixel i has the
variance sum_k M_ik^2 v_k, v_k = floor + K mean_k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import convolve, shift
from scipy.stats import norm

from calib.detector.photon_transfer import QUANTISATION_DN2, PhotonTransfer, deviation
from calib.measure.statistics.robust import robust_sigma
from optics.arrays import FloatArray
from optics.errors import DomainError

FEWEST_PIXELS = 30
"""Fewest pixels for photon transfer of windows."""
FEWEST_FRAMES = 4
"""Fewest frames for a test of common noise of two of them."""
ITERATIONS = 8
SHIFTS = (-2, -1, 1, 2)
NEIGHBOURS = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]])
MANY_PAIRS = 28
MOST_PIXELS = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class _Window:
    """Frames (n, p) of the usable pixels of a window without motion and flicker."""

    residual: FloatArray  # (n, p) [DN]
    mixing: FloatArray  # (p, p) Variance of a residual from the variances of the pixels
    design: FloatArray  # (p, 2) Multiplies (floor, K) in the variance of a residual
    instrument: FloatArray  # (p, 2) The same with the mean of the neighbours of a pixel in place of its mean

    @property
    def squares(self) -> FloatArray:
        """Variance of a residual by each frame (n, p), unbiased."""
        count = len(self.residual)
        return np.asarray(self.residual**2 * count / (count - 1))


def _without_modes(dn: FloatArray, usable: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Frames (n, h, w) of a window without motion and flicker (n, p), and the projection (p, p)."""
    mean = dn.mean(0)
    edge = np.ones(mean.shape, bool)
    edge[1:-1, 1:-1] = False
    light = mean - np.median(mean[edge])
    moved = [shift(light, at, order=0) for step in SHIFTS for at in ((step, 0), (0, step))]
    modes = np.stack([light, *moved], axis=-1)[usable]
    base = np.linalg.qr(modes / np.maximum(np.linalg.norm(modes, axis=0), 1e-300))[0]
    projection = np.eye(len(base)) - base @ base.T
    return (dn[:, usable] - mean[usable]) @ projection, projection


def _window(dn: FloatArray, usable: NDArray[np.bool_]) -> _Window:
    mean = dn.mean(0)
    residual, projection = _without_modes(dn, usable)
    mixing = projection**2
    total = convolve(np.where(usable, mean, 0.0), NEIGHBOURS)
    neighbours = total / np.maximum(convolve(usable.astype(float), NEIGHBOURS), 1.0)
    return _Window(
        residual=residual,
        mixing=mixing,
        design=np.column_stack([mixing.sum(1), mixing @ mean[usable]]),
        instrument=np.column_stack([mixing.sum(1), mixing @ neighbours[usable]]),
    )


def window_photon_transfer(
    dn: Sequence[ArrayLike], usable: Sequence[ArrayLike], *, offset_dn: float = 0.0
) -> PhotonTransfer:
    """Gain and read noise from windows around images at rest.

    Offsets differ from pixel to pixel: the mean of a pixel is its light with an error, which would lower the slope of
    least squares; the mean of its neighbours has the light without that error and is the instrument (Durbin 1954).
    Offsets that scatter by 3 % of the brightest pixel still lower K by some 6 %. The error is that of the sample of
    frames (whose residuals the projection correlates within a window) and that of the sample of pixels, whose read
    noise differs.

    Parameters
    ----------
    dn : sequence of (n, j, h, w)
        Series of n frames of j windows [DN]; n and j may differ from series to series.
    usable : sequence of (j, h, w) bool
        Pixels to use.
    offset_dn : float
        Reading without light, for the read noise.

    Raises
    ------
    DomainError
        Fewer than 30 pixels.
    """
    windows = [
        _window(np.asarray(frames, float), ok)
        for series, masks in zip(dn, usable, strict=True)
        for frames, ok in zip(np.moveaxis(np.asarray(series), 1, 0), np.asarray(masks, bool), strict=True)
        if ok.any()
    ]
    count = sum(len(window.design) for window in windows)
    if count < FEWEST_PIXELS:
        raise DomainError(f"photon transfer of {count} pixels of windows; at least {FEWEST_PIXELS} are needed")
    variance = np.concatenate([window.squares.mean(0) for window in windows])
    design = np.concatenate([window.design for window in windows])
    instrument = np.concatenate([window.instrument for window in windows])
    degrees = np.concatenate([np.full(len(window.design), len(window.residual) - 1.0) for window in windows])
    expected = np.full(count, max(variance.mean(), 1e-12))
    for _ in range(ITERATIONS):
        weight = degrees / expected**2
        inverse = np.linalg.pinv(instrument.T @ (weight[:, None] * design))
        line = inverse @ (instrument.T @ (weight * variance))
        expected = np.maximum(design @ line, max(1e-3 * float(variance.mean()), 1e-12))
    influence = inverse @ (instrument * weight[:, None]).T
    gain, read_dn2 = float(line[1]), float(line[0] + offset_dn * line[1]) - QUANTISATION_DN2
    ends = np.cumsum([len(window.design) for window in windows])[:-1]
    scale = gain if gain > 0.0 else float("nan")
    read_influence = influence[0] + (offset_dn - 2.0 * read_dn2 / scale) * influence[1]  # of read_dn2 / K^2, times K^2
    gain_error, read_error = (
        _error(windows, np.split(row, ends), np.split(variance - design @ line, ends))
        for row in (influence[1], read_influence)
    )
    read_noise, read_noise_error = deviation(read_dn2 / scale**2, read_error / scale**2)
    return PhotonTransfer(
        gain_dn_per_e=gain,
        gain_error_dn_per_e=gain_error,
        read_noise_e=read_noise,
        read_noise_error_e=read_noise_error,
        pixels=count,
    )


def _error(windows: Sequence[_Window], influence: Sequence[FloatArray], misfit: Sequence[FloatArray]) -> float:
    """Error of a sum of the variances of the residuals with weights ``influence``.

    Frames and windows are independent of each other, and so are the deviations of the variances of the pixels from the
    line: the misfits of the residuals, unmixed, less the noise of the sample of frames.
    """
    sampling = pattern = 0.0
    for window, weight, residual in zip(windows, influence, misfit, strict=True):
        count = len(window.residual)
        change = window.squares - window.squares.mean(0)
        sampling += float(((change @ weight) ** 2).sum()) / (count * (count - 1))
        unmixed = np.linalg.pinv(window.mixing, hermitian=True)
        noise = ((change @ unmixed) ** 2).sum(0) / (count * (count - 1))
        pattern += float((weight @ window.mixing) ** 2 @ ((unmixed @ residual) ** 2 - noise))
    return float(np.sqrt(sampling + max(pattern, 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonNoise:
    """The two frames of a series with the largest correlation of their noise."""

    frames: tuple[int, int]
    correlation: float  # Of their noise over the pixels
    limit: float  # Of independent noise, with the stated false alarm probability


def common_noise(dn: ArrayLike, usable: ArrayLike, *, false_alarm: float) -> CommonNoise | None:
    """Largest correlation of the noise of two of n frames of windows (n, j, h, w) over usable pixels (j, h, w).

    None for fewer than four frames. ``false_alarm``: probability that independent frames exceed the limit.
    """
    frames = np.asarray(dn, float)
    count = len(frames)
    if count < FEWEST_FRAMES:
        return None
    masks = enumerate(np.asarray(usable, bool))
    residual = np.hstack([_without_modes(frames[:, j], ok)[0] for j, ok in masks if ok.any()])
    residual = residual[:, :: -(-residual.shape[1] // MOST_PIXELS)]
    scale = residual.std(0)
    unit = residual[:, scale > 0] / scale[scale > 0]
    unit /= np.maximum(np.linalg.norm(unit, axis=1, keepdims=True), 1e-300)
    pairs = np.triu_indices(count, 1)
    correlation = (unit @ unit.T)[pairs] + 1.0 / (count - 1)
    spread = 1.0 / np.sqrt(unit.shape[1])
    if len(correlation) >= MANY_PAIRS:  # correlated neighbours: fewer independent pixels
        spread = max(spread, robust_sigma(correlation))
    worst = int(np.argmax(correlation))
    return CommonNoise(
        frames=(int(pairs[0][worst]), int(pairs[1][worst])),
        correlation=float(correlation[worst]),
        limit=float(spread * norm.isf(false_alarm / len(correlation))),
    )
