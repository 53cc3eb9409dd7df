"""Centroids predicted without frames: windows drawn from PSFs at given positions, and what noise and patterns do there.

The electrons of a pixel after the reduction are

    light (1 + PRNU) + offset pattern + temporal noise,

temporal noise being photons, dark current, read noise and rounding. To first order a centroid moves by the sum over the
pixels of g x disturbance; g is its response to a pixel of the noiseless window
(`calib.measure.centroid_error.linear_response`). Where a linear response is not valid (a threshold), noise is drawn on
the noiseless windows and centroided. No image is rendered, and the read-out chain takes no part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.measure.centroid_error.cramer_rao_bound import position_bound_px
from calib.measure.centroid_error.linear_response import centroid_covariance, centroid_variance, linear_response, tight
from calib.measure.centroiding.registry import Centroider
from calib.measure.epsf.bspline import EpsfModel, epsf_bank
from calib.measure.stamps import noiseless_stamps
from calib.measure.statistics.frame_positions import measured_positions
from calib.records import NoiseModel, Stamps
from optics.arrays import FloatArray
from optics.records import freeze, freeze_all
from render.records import EffectivePsf


class PixelStatistics(Protocol):
    """Noise and patterns of a pixel in one exposure, such as `render.detector.noise.PixelNoise` [e-]."""

    @property
    def read_e2(self) -> float:
        """Mean variance of the read noise over the pixels."""

    @property
    def dark_e(self) -> float:
        """Mean dark charge."""

    @property
    def prnu(self) -> float:
        """Standard deviation of the response over the pixels, relative."""

    @property
    def column_e(self) -> float:
        """Standard deviation of the offset over the columns."""

    @property
    def offset_e(self) -> float:
        """Standard deviation over the pixels of a frame without light."""

    @property
    def floor_e2(self) -> float:
        """Temporal variance of a pixel without light, mean over the pixels."""

    @property
    def floor_e4(self) -> float:
        """Variance over the pixels of ``floor_e2``."""

    def temporal_e2(
        self, light_e: FloatArray | float, *, frames: int = 1, dark_frames: int | None = None
    ) -> FloatArray:
        """Temporal variance of pixels that expect ``light_e``, of means over frames, minus a mean of dark frames."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedWindows:
    """n noiseless windows drawn from PSFs; `expected_windows` makes them."""

    position_px: FloatArray  # (n, 2) Of the stars, column and row
    corner_px: NDArray[np.int64]  # (n, 2) First pixels
    light_e: FloatArray  # (n, h, w) Expected electrons
    valid: NDArray[np.bool_]  # (n, h, w) Pixels that the reduction uses
    psf: tuple[EffectivePsf, ...]  # PSFs of the windows, by ``psf_index``
    psf_index: NDArray[np.int64]  # (n,) Index into ``psf``

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, position_px=("n", 2), light_e=("n", "h", "w"), sizes=sizes)
        freeze_all(self, corner_px=("n", 2), psf_index=("n",), dtype=np.int64, sizes=sizes)
        freeze(self, "valid", shape=("n", "h", "w"), dtype=np.bool_, sizes=sizes)

    def modelled(self, shift_px: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Images (n, h w) of the PSFs moved by (2,), with derivatives (n, 3, h w) by column, row and electrons.

        The electrons are of the full image, whose wings are cut by a window.
        """
        count, height, width = self.light_e.shape
        model = EpsfModel(epsf_bank(self.psf, (height, width)), self.psf_index)

        def images(shift_px: FloatArray | float, electrons: FloatArray) -> tuple[FloatArray, FloatArray]:
            position = self.position_px + shift_px - self.corner_px
            return model.evaluate(np.column_stack([position, electrons]), np.arange(count))

        inside = images(0.0, np.ones(count))[0].sum(1)
        return images(shift_px, self.light_e.sum((1, 2)) / inside)

    def moved(self, shift_px: FloatArray) -> ExpectedWindows:
        """The same windows with the image moved by (2,) in them."""
        light = np.maximum(self.modelled(shift_px)[0], 0.0).reshape(self.light_e.shape)
        return replace(self, position_px=self.position_px + shift_px, light_e=light)

    def select(self, rows: NDArray[np.int64], valid: NDArray[np.bool_]) -> ExpectedWindows:
        """Some windows, with other usable pixels (n, h, w)."""
        chosen = {name: getattr(self, name)[rows] for name in ("position_px", "corner_px", "light_e", "psf_index")}
        return replace(self, valid=valid[rows], **chosen)

    def stamps(self) -> Stamps:
        """The windows as a centroider takes them, which starts at their centre of gravity."""
        return noiseless_stamps(self.light_e, corner_px=self.corner_px, valid=self.valid, psf_index=self.psf_index)


def expected_windows(
    psfs: Sequence[EffectivePsf],
    position_px: ArrayLike,
    electrons: float,
    *,
    window_px: int,
    corner_px: NDArray[np.int64] | None = None,
    defect: NDArray[np.bool_] | None = None,
    full_well_e: float = np.inf,
    nonlinearity: Sequence[float] = (),
) -> ExpectedWindows:
    """Windows around stars.

    Parameters
    ----------
    psfs : sequence of EffectivePsf
        f PSFs of equal oversampling; star i has the PSF i modulo f.
    position_px : (n, 2)
        Column and row of the stars.
    electrons : float
        Electrons of a star in one frame, wings included.
    window_px : int
        Side of a window.
    corner_px : (n, 2), optional
        First pixels of the windows; around the stars if left out.
    defect : (rows, columns) bool, optional
        Pixels of the detector that the reduction leaves out.
    full_well_e, nonlinearity
        A converter with the coefficients c1, c2 ... reads ``light (1 + c1 light / full well + ...)`` electrons at a
        constant gain.
    """
    position = np.asarray(position_px, np.float64).reshape(-1, 2)
    corner = np.rint(position).astype(np.int64) - window_px // 2 if corner_px is None else corner_px.reshape(-1, 2)
    index = np.arange(len(position)) % len(psfs)
    model = EpsfModel(epsf_bank(tuple(psfs), (window_px, window_px)), index)
    theta = np.column_stack([position - corner, np.full(len(position), float(electrons))])
    light, _ = model.evaluate(theta, np.arange(len(position)))
    light = np.maximum(light, 0.0)  # the spline between the samples of a sharp PSF swings below zero by some 1e-6
    fraction = light / full_well_e
    light = light * (1.0 + sum(c * fraction ** (i + 1) for i, c in enumerate(nonlinearity)))
    return ExpectedWindows(
        position_px=position,
        corner_px=corner,
        light_e=light.reshape(-1, window_px, window_px),
        valid=usable_pixels(defect, corner, window_px),
        psf=tuple(psfs),
        psf_index=index,
    )


def usable_pixels(defect: NDArray[np.bool_] | None, corner_px: NDArray[np.int64], window_px: int) -> NDArray[np.bool_]:
    """Pixels (n, side, side) of windows that are no defect of the detector (rows, columns); all if none is known."""
    if defect is None:
        return np.ones((len(corner_px), window_px, window_px), bool)
    pixel = np.arange(window_px)
    return np.asarray(~defect[corner_px[:, 1, None, None] + pixel[:, None], corner_px[:, 0, None, None] + pixel])


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowResponse:
    """Response of a centroider to the pixels of n windows."""

    position_px: FloatArray  # (n, 2) Its position of the noiseless window
    gain_px_per_e: FloatArray  # (n, 2, h, w) Shift per electron in a pixel

    def sigma_px(self, variance_e2: FloatArray) -> FloatArray:
        """Standard deviation (n, 2) by independent noise of this variance in the pixels (n, h, w)."""
        return np.sqrt(centroid_variance(self.gain_px_per_e, variance_e2))

    def covariance_px2(self, variance_e2: FloatArray) -> FloatArray:
        """Covariance (n, 2, 2) by the same."""
        return centroid_covariance(self.gain_px_per_e, variance_e2)

    def device_sigma_px(self, light_e: FloatArray, noise: PixelStatistics) -> FloatArray:
        """Standard deviation of temporal noise from chip to chip (n, 2): read noise and dark charge differ by pixel."""
        of_variance = np.sqrt((self.gain_px_per_e**4).sum((2, 3)) * noise.floor_e4)
        return np.asarray(0.5 * of_variance / np.maximum(self.sigma_px(noise.temporal_e2(light_e)), 1e-300))


def noiseless_positions(centroider: Centroider, windows: ExpectedWindows, noise: NoiseModel) -> FloatArray:
    """Positions (n, 2) by a centroider on noiseless windows; ``noise`` is the model handed to it."""
    return centroider.measure(windows.stamps(), noise).pixel_px


def window_response(centroider: Centroider, windows: ExpectedWindows, noise: NoiseModel) -> WindowResponse:
    """Position and response of a centroider on noiseless windows."""
    gain = linear_response(tight(centroider), windows.stamps(), noise, windows.light_e)
    return WindowResponse(position_px=noiseless_positions(centroider, windows, noise), gain_px_per_e=gain)


def followed_px(centroider: Centroider, windows: ExpectedWindows, noise: NoiseModel, step_px: float) -> FloatArray:
    """Motion of a centroid (n, 2) for a step of the image along x, along y: half the difference of both sides."""
    if not step_px:
        return np.zeros_like(windows.position_px)
    motion = []
    for axis in range(2):
        sides = (windows.moved(sign * step_px * np.eye(2)[axis]) for sign in (-1.0, 1.0))
        low, high = (noiseless_positions(centroider, moved, noise)[:, axis] for moved in sides)
        motion.append((high - low) / 2.0)
    return np.stack(motion, axis=1)


def bound_px(windows: ExpectedWindows, floor_e2: float) -> FloatArray:
    """Cramer-Rao bound (n, 2) of the standard deviation of x and y: flux unknown, background known.

    ``floor_e2``: variance of a pixel without light [e-^2].
    """
    signal, jacobian = windows.modelled()
    return position_bound_px(jacobian, np.maximum(signal, 0.0), NoiseModel(read_noise_e=float(np.sqrt(floor_e2))))


def drawn_positions(
    centroider: Centroider,
    windows: ExpectedWindows,
    noise: NoiseModel,
    pixel: PixelStatistics,
    *,
    draws: int,
    rng: np.random.Generator,
    mirrored: bool = False,
) -> FloatArray:
    """Positions (draws, n, 2) with noise drawn on the windows: Poisson, normal, rounded to whole DN; NaN where failed.

    Their mean is the centroid of frames also for a method that is not linear (a threshold), of which the centroid of
    the noiseless window may differ. ``noise`` is the model handed to the estimator, ``pixel`` the true one. Of
    ``mirrored`` draws every other has the noise of its predecessor with the opposite sign: noise cancels in the mean of
    both to first order.
    """
    stamps = windows.stamps()
    shape = (draws, *windows.light_e.shape)
    drawn = (draws // 2, *shape[1:]) if mirrored else shape
    electrons = rng.poisson(windows.light_e + pixel.dark_e, drawn) - pixel.dark_e
    electrons = electrons + np.sqrt(pixel.read_e2) * rng.standard_normal(drawn)
    if mirrored:
        electrons = np.stack([electrons, 2.0 * windows.light_e - electrons], axis=1).reshape(shape)
    electrons = windows.valid * np.rint(electrons * noise.gain_dn_per_e) / noise.gain_dn_per_e
    copies = stamps.select(np.tile(np.arange(len(stamps)), draws))
    return measured_positions(centroider, replace(copies, electrons=electrons.reshape(-1, *shape[2:])), noise, draws)


def pattern_shifts_px(
    centroider: Centroider,
    stamps: Stamps,
    noise: NoiseModel,
    light_e: FloatArray,
    *,
    prnu: float,
    offset_e: float,
    draws: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Shifts (draws, n, 2) of centroids by drawn fixed patterns of the pixels, on noiseless light (n, h, w).

    ``stamps`` give position and start of the windows; ``prnu``, ``offset_e``: standard deviations over the pixels of
    the response, and of the offset, such as the noise of a mean dark frame.
    """
    count = len(light_e)
    response = 1.0 + prnu * rng.standard_normal((draws, *light_e.shape))
    offset = offset_e * rng.standard_normal(response.shape)
    disturbed = np.concatenate([light_e[None], light_e * response + offset]).reshape(-1, *light_e.shape[1:])
    copies = stamps.select(np.tile(np.arange(count), draws + 1))
    copies = replace(copies, electrons=disturbed, valid=np.ones(disturbed.shape, bool))
    position = centroider.measure(copies, noise).pixel_px.reshape(draws + 1, count, 2)
    return position[1:] - position[0]
