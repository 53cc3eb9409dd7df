"""Centroid errors against the star's electrons, predicted from PSFs and pixel noise without frames.

To first order a centroid moves by its response to the pixels (`calib.measure.centroid_error.linear_response`). An ePSF
fit has the closed response of weighted least squares, (J W J^T)^-1 J W; other responses are finite differences. If
noise selects the pixels (a threshold), a linear response is not valid; such a centroider is refused.

The noise-equivalent angle of a star is its noise here times the angle of a pixel: one axis, one standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates

from calib.measure.centroid_error.cramer_rao_bound import position_bound_px
from calib.measure.centroid_error.linear_response import centroid_variance, linear_response, tight
from calib.measure.centroiding.registry import centroider_class, get_centroider
from calib.measure.epsf.bspline import EpsfModel, epsf_bank
from calib.measure.stamps import noiseless_stamps
from calib.records import NoiseModel
from optics.arrays import FloatArray
from optics.errors import ConfigError
from optics.records import freeze_all
from render.records import EffectivePsf

NOT_LINEAR = frozenset({"tcog"})
SCALE_FREE = frozenset({"cog", "windowed"})
"""Centroiders whose weights do not depend on the light: their response times the electrons is the same for all."""
KNOTS = 3
BOUND_PHASES, FLUX_KNOTS = 8, 25
"""Sub-pixel phases and numbers of electrons at which `centroid_bound` is computed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CentroidErrors:
    """One standard deviation per axis [px], root mean square over the sub-pixel phases and both axes."""

    electrons: FloatArray  # (k,) Of the star, increasing
    noise_px: FloatArray  # (f, k) By temporal noise, for each of f PSFs
    bound_px: FloatArray  # (f, k) Cramer-Rao bound of it: position and flux unknown, background known
    pattern_px: FloatArray  # (f, k) By the response pattern (PRNU) and the offsets of the pixels
    phase_px: FloatArray  # (f, k) S-curve: bias of the noiseless centroid about its mean over the sub-pixel phases
    peak: FloatArray  # (f,) Largest fraction of the light in a pixel

    def __post_init__(self) -> None:
        terms: dict[str, Any] = dict.fromkeys(("noise_px", "bound_px", "pattern_px", "phase_px"), ("f", "k"))
        freeze_all(self, electrons=("k",), peak=("f",), **terms)

    @property
    def total_px(self) -> FloatArray:
        """Noise, pattern and S-curve in quadrature (f, k)."""
        return np.sqrt(self.noise_px**2 + self.pattern_px**2 + self.phase_px**2)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseWindows:
    """Unit stars at even sub-pixel phases: n = phases^2 windows of each of f PSFs, PSF after PSF."""

    light: FloatArray  # (f n, h, w) Fraction of the light in each pixel
    jacobian: FloatArray  # (f n, 3, pixels) Its derivatives by column, row and flux
    position_px: FloatArray  # (f n, 2) Column and row of the star in the window
    psf_index: NDArray[np.int64]  # (f n,) Which PSF

    def bound_px(self, electrons: float, noise: NoiseModel, background_e: float = 0.0) -> FloatArray:
        """Cramer-Rao bound (f n, 2) of x and y for a star of these electrons: flux unknown, background known."""
        expected = electrons * self.light.reshape(len(self.light), -1) + background_e
        return position_bound_px(self.scaled_jacobian(electrons), expected, noise)

    def scaled_jacobian(self, electrons: float) -> FloatArray:
        """Derivatives (f n, 3, pixels) of a star of these electrons."""
        return self.jacobian * np.array([electrons, electrons, 1.0])[:, None]


@lru_cache(maxsize=24)
def phase_windows(psfs: tuple[EffectivePsf, ...], window_px: int, phases: int = 4) -> PhaseWindows:
    """Windows of unit stars at ``phases`` x ``phases`` even positions within the middle pixel; the last are cached."""
    step = (np.arange(phases) + 0.5) / phases - 0.5
    y, x = (value.ravel() + window_px // 2 for value in np.meshgrid(step, step, indexing="ij"))
    position = np.tile(np.column_stack([x, y]), (len(psfs), 1))
    index = np.repeat(np.arange(len(psfs)), phases**2)
    model = EpsfModel(epsf_bank(psfs, (window_px, window_px)), index)
    light, jacobian = model.evaluate(np.column_stack([position, np.ones(len(position))]), np.arange(len(position)))
    light = np.maximum(light, 0.0).reshape(-1, window_px, window_px)
    return PhaseWindows(light=light, jacobian=jacobian, position_px=position, psf_index=index)


def predict_centroids(
    centroider: str,
    psfs: tuple[EffectivePsf, ...],
    electrons: ArrayLike,
    *,
    noise: NoiseModel,
    background_e: float = 0.0,
    prnu: float = 0.0,
    offset_e: float = 0.0,
    window_px: int = 11,
    phases: int = 4,
    response: CentroidResponse | None = None,
) -> CentroidErrors:
    """Errors of a centroider on isolated stars.

    Parameters
    ----------
    centroider : str
        Its name; one that needs a PSF gets the PSF of the star.
    psfs : tuple of EffectivePsf
        f PSFs, of equal oversampling.
    electrons : (k,)
        Electrons of the star.
    noise : NoiseModel
        True noise of a pixel, dark charge and subtracted darks included; the centroider uses the same.
    background_e : float
        Further light in every pixel; its mean is known.
    prnu, offset_e : float
        Standard deviations over the pixels of the response and of the offset that calibration leaves.
    window_px : int
        Side of the window, odd.
    phases : int
        Sub-pixel phases along each axis.
    response : CentroidResponse, optional
        Of a centroider without a PSF, if already computed for these PSFs and this window.

    Raises
    ------
    ConfigError
        An unknown centroider, or one whose response to noise is not linear.
    """
    flux = np.asarray(electrons, np.float64)
    if response is None and not centroider_class(centroider).needs_epsf:
        ends = (float(flux[0]), float(flux[-1]))
        response = CentroidResponse(centroider, psfs, ends, noise=noise, window_px=window_px, phases=phases)
    windows = phase_windows(psfs, window_px, phases) if response is None else response.windows
    errors: dict[str, list[FloatArray]] = {"noise_px": [], "bound_px": [], "pattern_px": [], "phase_px": []}
    for value in flux:
        light = value * windows.light
        expected = light + background_e
        variance = noise.variance_e2(expected)
        if response is None:
            gain, bias = _fit_gain(windows, float(value), noise, background_e), np.zeros((len(light), 2))
        else:
            gain, bias = response.at(value)
        phase_bias = bias.reshape(len(psfs), -1, 2)
        squares = {
            "noise_px": centroid_variance(gain, variance),
            "bound_px": windows.bound_px(value, noise, background_e) ** 2,
            "pattern_px": centroid_variance(gain, (prnu * light) ** 2 + offset_e**2),
            "phase_px": (phase_bias - phase_bias.mean(1, keepdims=True)) ** 2,
        }
        for name, square in squares.items():
            errors[name].append(np.sqrt(square.reshape(len(psfs), -1).mean(1)))
    peak = windows.light.reshape(len(psfs), -1).max(1)
    return CentroidErrors(
        electrons=flux, peak=peak, **{name: np.stack(columns, axis=1) for name, columns in errors.items()}
    )


def psf_mismatch(
    psfs: tuple[EffectivePsf, ...],
    true: tuple[EffectivePsf, ...],
    electrons: ArrayLike,
    *,
    noise: NoiseModel,
    background_e: float = 0.0,
    window_px: int = 11,
    phases: int = 4,
) -> FloatArray:
    """Bias of an ePSF fit with PSFs other than the ``true`` ones, root mean square over phases and axes, (f, k).

    Both PSFs are centred on the mean of the light. To first order the bias is the response of the fit to the difference
    of the two images; parameters as of `predict_centroids`.
    """
    fitted, drawn = phase_windows(psfs, window_px, phases), phase_windows(true, window_px, phases)
    rms = []
    for value in np.asarray(electrons, np.float64):
        gain = _fit_gain(fitted, float(value), noise, background_e)
        bias = np.einsum("nahw,nhw->na", gain, value * (drawn.light - fitted.light))
        rms.append(np.sqrt((bias.reshape(len(psfs), -1) ** 2).mean(1)))
    return np.stack(rms, axis=1)


def fit_bias(
    centroid: str,
    psfs: tuple[EffectivePsf, ...],
    true: tuple[EffectivePsf, ...],
    electrons: float,
    *,
    noise: NoiseModel,
    window_px: int = 11,
) -> FloatArray:
    """Bias of a centroider with PSFs ``psfs`` on noiseless stars with the PSFs ``true``, (f, phases^2, 2) [px].

    By the centroider itself (`psf_mismatch`: to first order), for positions at even sub-pixel phases.
    """
    windows = phase_windows(true, window_px)
    stamps = noiseless_stamps(electrons * windows.light, start_px=windows.position_px, psf_index=windows.psf_index)
    measured_px = get_centroider(centroid, epsf=psfs).measure(stamps, noise).pixel_px
    return np.asarray((measured_px - windows.position_px).reshape(len(true), -1, 2))


def _fit_gain(windows: PhaseWindows, flux: float, noise: NoiseModel, background_e: float) -> FloatArray:
    """Response (n, 2, h, w) of weighted least squares for position and flux: (J W J^T)^-1 J W."""
    variance = noise.variance_e2(flux * windows.light + background_e)
    jacobian = windows.scaled_jacobian(flux)
    weighted = jacobian / variance.reshape(len(variance), 1, -1)
    information = weighted @ jacobian.swapaxes(1, 2)
    gain = np.linalg.solve(information, weighted)[:, :2]
    return np.asarray(gain.reshape(len(variance), 2, *variance.shape[1:]))


class CentroidResponse:
    """Response and bias of a centroider without a PSF on noiseless windows, against the star's electrons.

    Response times electrons changes slowly with the electrons: interpolated between three stars in their logarithm.
    """

    def __init__(
        self,
        name: str,
        psfs: tuple[EffectivePsf, ...],
        electrons: tuple[float, float],
        *,
        noise: NoiseModel,
        window_px: int,
        phases: int = 4,
    ) -> None:
        if name in NOT_LINEAR:
            raise ConfigError(
                f"centroid = {name!r}: its threshold is at the noise level, where no prediction without frames is "
                "valid; use another centroider, e.g. epsf or windowed"
            )
        windows = self.windows = phase_windows(psfs, window_px, phases)
        centroider = tight(get_centroider(name))
        knots = 1 if name in SCALE_FREE or electrons[0] == electrons[1] else KNOTS
        self.log_flux = np.log(np.geomspace(*electrons, knots))
        self.gain, self.bias = [], []
        for value in np.exp(self.log_flux):
            light = value * windows.light
            stamps = noiseless_stamps(light, start_px=windows.position_px)
            self.bias.append(centroider.measure(stamps, noise).pixel_px - windows.position_px)
            self.gain.append(value * linear_response(centroider, stamps, noise, light))

    def at(self, flux: float) -> tuple[FloatArray, FloatArray]:
        """Response (n, 2, h, w) and bias (n, 2) of a star of given electrons."""
        knot = np.interp(np.log(flux), self.log_flux, np.arange(len(self.log_flux)))
        low = int(knot)
        high, weight = min(low + 1, len(self.log_flux) - 1), knot - low
        gain = (1.0 - weight) * self.gain[low] + weight * self.gain[high]
        return gain / flux, (1.0 - weight) * self.bias[low] + weight * self.bias[high]


@dataclass(frozen=True, slots=True, kw_only=True)
class CentroidBound:
    """Cramer-Rao bound of a centroid against electrons, at some distances from the middle, at every sub-pixel phase."""

    radius_px: FloatArray  # (r,) Increasing distances of the PSFs
    electrons: FloatArray  # (k,) Increasing
    sigma_px: FloatArray  # (r, k, p, p, 2) Of x and y, for phases (-1/2 + (i + 1/2) / p) of row and column

    def __post_init__(self) -> None:
        freeze_all(self, radius_px=("r",), electrons=("k",), sigma_px=("r", "k", "p", "p", 2))

    def at(self, electrons: FloatArray, position_px: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Bounds (n, 2) of stars at positions (n, 2): nearest PSF, interpolated in phase and in the log of the flux."""
        nearest = np.abs(np.asarray(radius_px)[:, None] - self.radius_px).argmin(axis=1)
        log_e = np.log(self.electrons)
        flux = np.clip(np.interp(np.log(np.asarray(electrons)), log_e, np.arange(len(log_e))), 0, len(log_e) - 1)
        phases = self.sigma_px.shape[2]
        phase = (np.asarray(position_px) + 0.5) % 1.0 * phases - 0.5
        padded = np.pad(np.log(self.sigma_px), ((0, 0), (0, 0), (1, 1), (1, 1), (0, 0)), mode="wrap")
        at = np.stack([nearest, flux, phase[:, 1] + 1.0, phase[:, 0] + 1.0])
        return np.stack([np.exp(map_coordinates(padded[..., axis], at, order=1)) for axis in (0, 1)], axis=-1)


def centroid_bound(
    psfs: Sequence[EffectivePsf],
    radius_px: ArrayLike,
    *,
    noise: NoiseModel,
    background_e: float,
    window_px: int,
    electrons: tuple[float, float],
) -> CentroidBound:
    """Bound for stars of unknown position and flux on a known background, in the window that is used.

    Shapes: ``psfs`` r at distances ``radius_px`` (r,) from the middle, for stars between two numbers of electrons.
    """
    flux, windows = np.geomspace(*electrons, FLUX_KNOTS), phase_windows(tuple(psfs), window_px, BOUND_PHASES)
    sigma = np.stack([windows.bound_px(float(value), noise, background_e) for value in flux], axis=1)
    shape = (len(psfs), BOUND_PHASES, BOUND_PHASES, FLUX_KNOTS, 2)
    return CentroidBound(
        radius_px=np.asarray(radius_px, float),
        electrons=flux,
        sigma_px=np.moveaxis(sigma.reshape(shape), 3, 1),
    )
