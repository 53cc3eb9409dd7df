"""A PSF over the field and colour: three Gaussians integrated over pixels, fitted at known positions.

Stars are fixed at their calibrated catalogue positions, which determines wings and core. Core and halo are round and of
constant width; the widths of the middle component change over the field (linear and quadratic) and between colour
classes, and so does the fraction of the core. Flux and background of every star are eliminated (they are linear), the
other parameters are common to all frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.records import freeze
from render.records import EffectivePsf

COLOUR_EDGES_K = (4500.0, 5500.0, 7000.0)
COLOUR_NAMES = ("below 4500 K", "4500 to 5500 K", "5500 to 7000 K", "above 7000 K")
REFERENCE_CLASS = 1
FEWEST_STARS, FEWEST_OF_A_CLASS = 25, 6
MODEL_FRACTION = 0.02
"""Model error of a pixel, as a fraction of the light of the star in it: limits the weight of bright stars."""
WIDEST_HALO = 0.25
"""Largest width of the halo over the side of the window: a wider halo is not determined."""
CLIP_SIGMA, ROUNDS = 8.0, 3
COUNT = 18


def colour_class(temperature_k: FloatArray) -> IntArray:
    """Class (n,) of stars by their colour temperature."""
    return np.digitize(temperature_k, COLOUR_EDGES_K).astype(np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class StarWindows:
    """Windows around stars of known position."""

    dn: FloatArray  # (n, s, s) Pixels, less the background of the frame at the star
    offset_px: FloatArray  # (n, 2) Position of the star from the middle pixel, column and row
    position_px: FloatArray  # (n, 2) On the detector
    colour: IntArray  # (n,) `colour_class`
    frame: IntArray  # (n,)
    star: IntArray  # (n,) Row among the stars of its frame
    level_dn: FloatArray  # (n,) Subtracted background
    valid: NDArray[np.bool_]  # (n, s, s)

    def __len__(self) -> int:
        return len(self.dn)

    def select(self, rows: NDArray[np.bool_]) -> StarWindows:
        """Windows of some of the stars."""
        return StarWindows(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})


@dataclass(frozen=True, slots=True, kw_only=True)
class MixturePsf:
    """Three Gaussians over a detector; parameters and their covariance."""

    size_px: tuple[int, int]  # Columns and rows of the detector
    # (18,) Logarithms of the light of core and halo over that of the middle component, of the widths [px] of core,
    # middle (x, y) and halo; changes of the middle's logarithms over the field (x by r^2, y by r^2, x by x, x by y, y
    # by x, y by y) and with the three colour classes that are not the reference; changes of the core's logarithm with
    # them
    value: FloatArray
    covariance: FloatArray  # (18, 18) Scaled by the misfit; infinite for undetermined parameters
    chi2: float  # Per degree of freedom

    def __post_init__(self) -> None:
        freeze(self, "value", shape=(COUNT,))
        freeze(self, "covariance", shape=(COUNT, COUNT), finite=False)

    def components(
        self, position_px: FloatArray, colour: IntArray
    ) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
        """Fractions of the light and widths (n,) along x and y [px] of core, middle and halo."""
        v, ones = self.value, np.ones(len(position_px))
        u = (position_px - (np.asarray(self.size_px) - 1.0) / 2.0) / (0.5 * float(np.hypot(*self.size_px)))
        r2 = (u**2).sum(axis=1)
        by_colour = np.insert(v[12:15], REFERENCE_CLASS, 0.0)[colour]
        along_x = np.exp(v[3] + by_colour + v[6] * r2 + v[8] * u[:, 0] + v[9] * u[:, 1])
        along_y = np.exp(v[4] + by_colour + v[7] * r2 + v[10] * u[:, 0] + v[11] * u[:, 1])
        core, halo = np.exp(v[2]) * ones, np.exp(v[5]) * ones
        inner, outer = np.exp(v[0] + np.insert(v[15:18], REFERENCE_CLASS, 0.0)[colour]), np.exp(v[1])
        total = 1.0 + inner + outer
        return (inner / total, core, core), (1.0 / total, along_x, along_y), (outer / total, halo, halo)

    def draw(self, offset_px: FloatArray, position_px: FloatArray, colour: IntArray, size: int) -> FloatArray:
        """Fraction of the light in each pixel (n, size, size) of windows about stars."""
        edge = np.arange(size + 1) - size / 2.0
        out = np.zeros((len(offset_px), size, size))
        for fraction, along_x, along_y in self.components(position_px, colour):
            x = np.diff(ndtr((edge - offset_px[:, :1]) / along_x[:, None]), axis=1)
            y = np.diff(ndtr((edge - offset_px[:, 1:]) / along_y[:, None]), axis=1)
            out += fraction[:, None, None] * y[:, :, None] * x[:, None, :]
        return out

    def effective(self, position_px: FloatArray, colour: int, *, half_px: int = 6) -> EffectivePsf:
        """The PSF at a position (2,) for a colour class, with four samples per pixel."""
        at = np.arange(-4 * half_px, 4 * half_px + 1) / 4.0
        values = np.zeros((len(at), len(at)))
        for fraction, along_x, along_y in self.components(np.reshape(position_px, (1, 2)), np.array([colour])):
            x, y = (ndtr((at + 0.5) / s[0]) - ndtr((at - 0.5) / s[0]) for s in (along_x, along_y))
            values += fraction[0] * np.outer(y, x)
        return EffectivePsf(values=values, oversampling=4)

    @property
    def flux_error(self) -> float:
        """Relative error, common to all stars, of a flux by the errors of the parameters."""
        middle = (np.asarray(self.size_px, float)[None] - 1.0) / 2.0

        def drawn(value: FloatArray) -> FloatArray:
            return replace(self, value=value).draw(np.zeros((1, 2)), middle, np.array([REFERENCE_CLASS]), 9).ravel()

        free = np.flatnonzero(np.diag(self.covariance) > 0.0)
        step, shape = 1e-3, drawn(self.value)
        slope = [(drawn(self.value + step * np.eye(COUNT)[k]) - shape) @ shape / step for k in free] / (shape @ shape)
        return float(np.sqrt(slope @ self.covariance[np.ix_(free, free)] @ slope))

    @property
    def central_width_px(self) -> tuple[float, float]:
        """Width of the middle component in the middle of the detector, mean of both axes; its standard deviation."""
        middle = (np.array([self.size_px]) - 1.0) / 2.0
        _, (_, along_x, along_y), _ = self.components(middle, np.array([REFERENCE_CLASS]))
        width, sigma = float((along_x + along_y)[0] / 2.0), np.sqrt(np.diag(self.covariance))
        return width, float(width * np.hypot(sigma[3], sigma[4]) / 2.0)


def linear_fit(model: FloatArray, dn: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Flux, background and variance of the flux (n,) of stars of a given shape; all arguments (n, s, s)."""
    shape, values, w = (array.reshape(len(array), -1) for array in (model, dn, weight))
    a, b, c = (w * shape**2).sum(1), (w * shape).sum(1), w.sum(1)
    u, v = (w * shape * values).sum(1), (w * values).sum(1)
    determinant = np.maximum(a * c - b * b, 1e-300)
    return (c * u - b * v) / determinant, (a * v - b * u) / determinant, c / determinant


class PsfFluxes(NamedTuple):
    """Fluxes of stars at known positions by a PSF."""

    flux_dn: FloatArray  # (n,)
    error_dn: FloatArray  # (n,) Standard deviation: background and shot noise of the star


def psf_fluxes(psf: MixturePsf, windows: StarWindows, variance_dn2: FloatArray, gain_e_per_dn: float) -> PsfFluxes:
    """Fluxes with weights of the background alone, insensitive to errors of the core of bright stars.

    ``variance_dn2`` (n,): of a background pixel of each window.
    """
    shape = psf.draw(windows.offset_px, windows.position_px, windows.colour, windows.dn.shape[1])
    weight = np.where(windows.valid, 1.0 / variance_dn2[:, None, None], 0.0)
    flux, _, variance = linear_fit(shape, windows.dn, weight)
    # shot noise of the star itself, through the same weights
    shot = (shape**3 * weight).sum((1, 2)) / np.maximum((shape**2 * weight).sum((1, 2)), 1e-12) ** 2
    shot *= np.max(weight, axis=(1, 2))
    return PsfFluxes(flux, np.sqrt(variance + np.maximum(flux, 0.0) / gain_e_per_dn * shot))


def fit_psf(
    windows: StarWindows,
    size_px: tuple[int, int],
    *,
    noise_dn2: tuple[float, float],
    width_px: float,
    start: FloatArray | None = None,
) -> MixturePsf:
    """Shape from isolated, unsaturated stars at known positions.

    Parameters
    ----------
    windows : StarWindows
        Stars of all frames.
    size_px : (int, int)
        Columns and rows of the detector.
    noise_dn2 : (float, float)
        Variance of a pixel: constant [DN^2], and per DN.
    width_px : float
        Typical width of a Gaussian fit, as a start of the fit.
    start : (18,), optional
        Parameters of a similar PSF, as a better start.

    Raises
    ------
    DomainError
        On fewer than 25 stars.
    """
    if len(windows) < FEWEST_STARS:
        raise DomainError(
            f"{len(windows)} bright, isolated, unsaturated stars in all frames; the PSF needs {FEWEST_STARS}: more "
            "frames, or a longer exposure"
        )
    size = windows.dn.shape[1]
    free = _determined(windows)
    value, low, high, prior = _bounds(width_px, size)
    if start is not None:
        value[free] = start[free]
    low, high, prior = low[free], high[free], prior[free]
    undetermined = np.full((COUNT, COUNT), np.inf)
    model = MixturePsf(size_px=size_px, value=value, covariance=undetermined, chi2=float("nan"))
    sky = noise_dn2[0] + noise_dn2[1] * np.maximum(windows.level_dn, 1.0)[:, None, None]
    weight = np.where(windows.valid, 1.0 / sky, 0.0)

    def drawn(at: FloatArray) -> FloatArray:
        parameters = value.copy()
        parameters[free] = at
        return replace(model, value=parameters).draw(windows.offset_px, windows.position_px, windows.colour, size)

    def misfit(at: FloatArray) -> FloatArray:
        shape = drawn(at)
        flux, level, _ = linear_fit(shape, windows.dn, weight)
        residual = windows.dn - flux[:, None, None] * shape - level[:, None, None]
        return np.concatenate([np.clip(residual * np.sqrt(weight), -CLIP_SIGMA, CLIP_SIGMA).ravel(), at / prior])

    for _ in range(ROUNDS if start is None else 1):
        shape = drawn(value[free])
        flux, _, _ = linear_fit(shape, windows.dn, weight)
        light = np.maximum(flux, 0.0)[:, None, None] * shape
        weight = np.where(windows.valid, 1.0 / (sky + noise_dn2[1] * light + (MODEL_FRACTION * light) ** 2), 0.0)
        inside = np.clip(value[free], low + 1e-6, high - 1e-6)
        fit = least_squares(misfit, inside, bounds=(low, high), x_scale=0.05, xtol=1e-6)
        value[free] = fit.x
    freedom = int(windows.valid.sum()) - 2 * len(windows) - int(free.sum())
    chi2 = 2.0 * float(fit.cost) / freedom
    covariance = np.zeros((COUNT, COUNT))
    covariance[np.ix_(free, free)] = np.linalg.pinv(fit.jac.T @ fit.jac) * max(chi2, 1.0)
    return replace(model, value=value, covariance=covariance, chi2=chi2)


def _determined(windows: StarWindows) -> NDArray[np.bool_]:
    """Parameters (18,) determined by a sample: changes need stars of the class, or many over the field."""
    count = np.bincount(windows.colour, minlength=4)
    free = np.ones(COUNT, bool)
    free[12:15] = [n >= FEWEST_OF_A_CLASS for k, n in enumerate(count) if k != REFERENCE_CLASS]
    free[15:18] = free[12:15]
    free[6:12] = len(windows) >= 4 * FEWEST_STARS
    return free


def _bounds(width_px: float, size: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Start, lower and upper bounds, and standard deviations (18,) expected of the changes over field and colour."""
    width, widest = np.log(width_px), max(WIDEST_HALO * size, 1.6 * width_px)
    start = np.zeros(COUNT)
    start[:6] = [-2.0, -2.0, np.log(0.4 * width_px), width, width, np.log(3.2 * width_px)]
    narrowest = [np.log(0.05), np.log(0.1), np.log(0.1), np.log(1.5 * width_px)]
    low = np.array([-5.0, -5.0, *narrowest, *[-1.5] * 6, *[-0.7] * 3, *[-1.5] * 3])
    broadest = [np.log(0.8 * width_px), np.log(6.0), np.log(6.0), np.log(widest)]
    high = np.array([4.0, 4.0, *broadest, *[1.5] * 6, *[0.7] * 3, *[0.9] * 3])
    prior = np.array([*[np.inf] * 6, *[0.5] * 6, *[0.2] * 3, *[0.5] * 3])
    return start, low, high, prior
