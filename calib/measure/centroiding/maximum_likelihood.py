"""Maximum likelihood of a pixel model by Fisher scoring, many stars at once.

The data of a pixel are Poisson electrons plus normal read noise. Their likelihood is approximated by the shifted
Poisson law (d + r^2 ~ Poisson(m + r^2), Snyder et al. 1995, J. Opt. Soc. Am. A 12, 272), whose score is

    sum over pixels of (d - m) / (m + r^2) dm/dtheta = 0.

The weights hold the *model's* variance and not that of the data: a weight taken from the noisy pixel itself favours
pixels that fluctuated down and biases flux and position at low signal. With the model's variance the score has zero
mean at any read noise, so that the estimate is free of bias to first order, and its variance is the inverse of sum
(dm/dtheta)^2 / (m + r^2). The exact Poisson-normal law knows slightly more in pixels that expect fewer electrons than
r^2; for a star of SNR 20 that lowers the bound on a position by less than 0.2 % (``crlb.poisson_normal_gain``), which
is why the simpler law is used.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.flags import StarFlag
from calib.measure.centroiding.options import check_options, option
from calib.records import FLUX, NoiseModel, Stamps, StarTable, X, Y
from optics.arrays import FloatArray
from optics.records import concatenated

T = TypeVar("T")
MOST_LIGHT = 10.0
"""Largest flux of a star over the light of its window, of whose core no pixel may be usable."""
RESPONSE_STEP = 1e-3
"""Differences of the score by a parameter [its standard deviation]."""
UNDAMPED = 8
"""Full steps before steps that turn the position back are halved."""
CHUNK = 256  # stars per task: the working set of a chunk stays within a few MB of cache


class PixelModel(Protocol):
    """Expected electrons of a star, without background, in the pixels of its window.

    The first three parameters are x and y [px from the window's first pixel] and the flux [e-].
    """

    max_step: FloatArray
    """(k,) Largest change of each parameter in one step."""

    def prior(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Prior of ``parameters`` (n, k): slope and negative curvature (n, k) of its log-density, or None."""

    def evaluate(self, parameters: FloatArray, rows: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Signal (n, p) and its derivatives (n, k, p) for ``parameters`` (n, k) of the stars ``rows`` (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelFit:
    """Result of `fit_pixels`: parameters (n, k), covariance (n, k, k); chi2, freedom, iterations, converged (n,)."""

    parameters: FloatArray
    covariance: FloatArray
    chi2: FloatArray
    freedom: NDArray[np.int64]
    iterations: NDArray[np.int64]
    converged: NDArray[np.bool_]


def fit_pixels(
    model: PixelModel,
    start: FloatArray,
    *,
    data: FloatArray,
    valid: NDArray[np.bool_],
    background: FloatArray,
    noise: NoiseModel,
    fit_background: bool = False,
    tolerance: float = 0.01,
    max_iterations: int = 30,
) -> PixelFit:
    """Fisher scoring: steps ``(J^T W J)^-1 J^T W (d - m)`` with ``W = 1 / variance(m)`` until they are small.

    A prior of the model adds its slope to the score and its curvature to the information. Where the information of a
    parameter after the flux changes steeply, steps would oscillate; one that reverses is at most half of the last.
    After ``UNDAMPED`` steps the same holds for the position: where the model does not fit the data (PSF of another
    filter), the information is smaller than the curvature of the likelihood, and full steps can oscillate.

    Shapes: ``start`` (n, k), ``data`` (n, p), ``valid`` (n, p), ``background`` (n,).
    """
    n, k = start.shape
    total = k + int(fit_background)
    theta = np.empty((n, total))
    theta[:, :k] = start
    strides = _Strides(np.append(model.max_step, [np.inf] * fit_background), n, shape=slice(FLUX + 1, k))
    if fit_background:
        theta[:, k] = background
    covariance = np.full((n, total, total), np.nan)
    chi2 = np.full(n, np.nan)
    iterations = np.zeros(n, np.int64)
    converged = np.zeros(n, dtype=bool)
    active = np.flatnonzero(valid.sum(axis=1) >= total)
    freedom = np.maximum(valid.sum(axis=1) - total, 1)
    for _ in range(max_iterations):
        if not active.size:
            break
        rows: Any = slice(None) if active.size == n else active
        last = theta[rows]
        jacobian, weight, residual = _weighed(model, last, active, data[rows], valid[rows], background[rows], noise)
        weighted = jacobian * weight[:, None, :]
        information = weighted @ jacobian.swapaxes(1, 2)
        score = (weighted @ residual[:, :, None])[:, :, 0]
        _add_prior(model.prior(last[:, :k]), score, information)
        inverse, good = _inverse(information)
        step = (inverse @ score[:, :, None])[:, :, 0]
        sigma = np.sqrt(np.diagonal(inverse, axis1=1, axis2=2))
        small = np.all(np.abs(step[:, : FLUX + 1]) <= tolerance * sigma[:, : FLUX + 1], axis=1)
        step = strides.shortened(step, active)
        moved = last + step
        moved[:, FLUX] = np.maximum(moved[:, FLUX], 1e-3 * np.abs(last[:, FLUX]) + 1e-6)  # a star has no negative light
        good &= np.all(np.isfinite(moved), axis=1)
        theta[active[good]] = moved[good]
        covariance[active] = np.where(good[:, None, None], inverse, np.nan)
        chi2[active] = np.einsum("np,np,np->n", weight, residual, residual) / freedom[active]
        iterations[active] += 1
        converged[active] = small & good
        active = active[good & ~small]
    return PixelFit(
        parameters=theta, covariance=covariance, chi2=chi2, freedom=freedom, iterations=iterations, converged=converged
    )


def _weighed(
    model: PixelModel,
    theta: FloatArray,
    rows: NDArray[np.int64],
    data: FloatArray,
    valid: NDArray[np.bool_],
    background: FloatArray,
    noise: NoiseModel,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Derivatives (n, k, p) of the expectation, weights (n, p) and residuals (n, p) of stars ``rows`` of the model."""
    k = len(model.max_step)
    signal, jacobian = model.evaluate(theta[:, :k], rows)
    if theta.shape[1] > k:  # the background is fitted
        jacobian = np.concatenate([jacobian, np.ones_like(jacobian[:, :1])], axis=1)
        background = theta[:, k]
    mean = signal + background[:, None]
    return jacobian, valid / noise.variance_e2(mean), data - mean


def fit_response(
    model: PixelModel,
    fit: PixelFit,
    *,
    data: FloatArray,
    valid: NDArray[np.bool_],
    background: FloatArray,
    noise: NoiseModel,
) -> FloatArray:
    """Derivatives (n, 2, p) of x and y, the root of the score, by the data: implicit function theorem.

    The derivatives of the score are central differences by a thousandth of a standard deviation of each parameter; of
    data that do not fit the model they differ from the information. NaN where the fit has no covariance.
    """
    theta, rows = fit.parameters, np.arange(len(data))
    sigma = np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2))
    k = len(model.max_step)

    def score(at: FloatArray) -> FloatArray:
        jacobian, weight, residual = _weighed(model, at, rows, data, valid, background, noise)
        value = ((jacobian * weight[:, None, :]) @ residual[:, :, None])[:, :, 0]
        _add_prior(model.prior(at[:, :k]), value, np.zeros_like(fit.covariance))
        return value * sigma  # in standard deviations, so that the matrix of derivatives is close to -1

    slope = np.empty_like(fit.covariance)
    for i in range(theta.shape[1]):
        step = np.zeros_like(theta)
        step[:, i] = RESPONSE_STEP * sigma[:, i]
        slope[:, :, i] = (score(theta + step) - score(theta - step)) / (2.0 * RESPONSE_STEP)
    finite = np.asarray(np.isfinite(slope).all((1, 2)))
    slope[~finite] = np.eye(theta.shape[1])
    jacobian, weight, _ = _weighed(model, theta, rows, data, valid, background, noise)
    response = -np.linalg.solve(slope, jacobian * weight[:, None, :] * sigma[:, :, None])[:, :FLUX]
    return np.where(finite[:, None, None], response * sigma[:, :FLUX, None], np.nan)


def _add_prior(prior: tuple[FloatArray, FloatArray] | None, score: FloatArray, information: FloatArray) -> None:
    """Add the prior, in place."""
    if prior is not None:
        slope, curvature = prior
        index = np.arange(slope.shape[1])
        score[:, index] += slope
        information[:, index, index] += curvature


class _Strides:
    """Lengths of steps of n stars: at most ``longest`` (k,), half the last one where the step of a shape parameter
    reverses, and after `UNDAMPED` steps half of themselves where that of the position does."""

    def __init__(self, longest: FloatArray, n: int, *, shape: slice) -> None:
        self.longest, self.shape = longest, shape
        self.reach = np.tile(longest[shape], (n, 1))
        self.last = np.zeros_like(self.reach)
        self.taken, self.move = 0, np.zeros((n, FLUX))  # Number of steps, and the last one of each position

    def shortened(self, step: FloatArray, active: NDArray[np.int64]) -> FloatArray:
        """The steps (m, k) of the stars ``active`` (m,), scaled down where they are too long."""
        size = np.maximum(np.abs(step), 1e-300)  # avoids division by 0
        fraction = np.min(self.longest / size, axis=1)
        if self.last.size:
            last = self.last[active]
            most = np.minimum(1.3 * self.reach[active], self.longest[self.shape])
            reach = np.where(step[:, self.shape] * last < 0, 0.5 * np.abs(last), most)
            self.reach[active] = reach
            fraction = np.minimum(fraction, np.min(reach / size[:, self.shape], axis=1))
        out = step * np.minimum(1.0, fraction)[:, None]
        self.last[active] = out[:, self.shape]
        if self.taken >= UNDAMPED:
            out[(out[:, :FLUX] * self.move[active]).sum(1) < 0] *= 0.5
        self.taken, self.move[active] = self.taken + 1, out[:, :FLUX]
        return out


def _inverse(information: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Inverses of (n, k, k) information matrices, scaled to unit diagonal first; false where there is none."""
    diagonal = np.diagonal(information, axis1=1, axis2=2)
    good = np.all((diagonal > 0) & np.isfinite(diagonal), axis=1)
    scale = np.where(good[:, None], 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 1.0)
    identity = np.eye(information.shape[1])
    scaled = np.where(good[:, None, None], information * scale[:, :, None] * scale[:, None, :], identity)
    inverse = np.linalg.inv(scaled + 1e-13 * identity)  # below the rounding of a regular matrix; keeps inv from raising
    variance = np.diagonal(inverse, axis1=1, axis2=2)
    good &= np.all((variance > 0) & (variance < 1e10), axis=1)
    inverse = np.where(good[:, None, None], inverse, identity)
    return np.asarray(inverse * scale[:, :, None] * scale[:, None, :]), good


@dataclass(frozen=True, slots=True, kw_only=True)
class LikelihoodFit:
    """Options that all maximum-likelihood centroiders share, and the fit itself."""

    fit_background: bool = False  # Fit a constant per star in place of ``Stamps.background_e``
    # Farthest plausible distance from the start position; beyond it the star is flagged ``NOT_CONVERGED``
    max_shift_px: float = option(2.0, above=0, unit="px")
    tolerance: float = option(0.01, above=0)  # Last step in units of the standard deviation
    max_iterations: int = option(30, at_least=1)  # Most steps taken

    def __post_init__(self) -> None:
        check_options(self)

    def models(self, stamps: Stamps) -> Callable[[slice], PixelModel]:
        """The pixel model of any part of the stamps."""
        raise NotImplementedError

    def shape_start(self) -> FloatArray:
        """First guess of the parameters after the flux."""
        return np.empty(0)

    def measure(self, stamps: Stamps, noise: NoiseModel) -> StarTable:
        """Position, flux and covariance of every stamp."""
        if not len(stamps):
            return StarTable.empty()
        model = self.models(stamps)
        parts = _over_chunks(lambda rows: self._fitted(model(rows), stamps, rows, noise)[1], len(stamps))
        return self._table(stamps, concatenated(parts), noise)

    def response(self, stamps: Stamps, noise: NoiseModel) -> FloatArray:
        """Derivatives (n, 2, h, w) [px/e-] of the position by the signal of each pixel; 0 for pixels not valid."""
        model = self.models(stamps)

        def part(rows: slice) -> FloatArray:
            pixel_model = model(rows)
            pixels, fit = self._fitted(pixel_model, stamps, rows, noise)
            return fit_response(pixel_model, fit, **pixels, noise=noise)

        return np.concatenate(_over_chunks(part, len(stamps))).reshape(-1, 2, *stamps.window)

    def _fitted(
        self, model: PixelModel, stamps: Stamps, rows: slice, noise: NoiseModel
    ) -> tuple[dict[str, Any], PixelFit]:
        """Pixels of some stamps, and the fit to them."""
        data = stamps.electrons[rows].reshape(rows.stop - rows.start, -1)
        pixels: dict[str, Any] = {
            "data": data,
            "valid": stamps.valid[rows].reshape(data.shape),
            "background": stamps.background_e[rows],
        }
        return pixels, fit_pixels(
            model,
            _start(stamps, rows, noise, self.shape_start()),
            **pixels,
            noise=noise,
            fit_background=self.fit_background,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )

    def shape_columns(self, fit: PixelFit) -> dict[str, Any]:
        """Columns of the table that follow from parameters after the flux; ``flags`` are added to the fit's flags."""
        del fit
        return {}

    def _table(self, stamps: Stamps, fit: PixelFit, noise: NoiseModel) -> StarTable:
        theta = fit.parameters
        flags = np.array(stamps.flags)
        lost = fit.iterations == 0
        offset = theta[:, :FLUX] + stamps.corner_px - stamps.start_px
        columns = self.shape_columns(fit)
        flags |= columns.pop("flags", 0)
        shifted = np.hypot(offset[:, X], offset[:, Y]) > self.max_shift_px
        flags[lost] |= int(StarFlag.NO_DATA)
        flags[~lost & (shifted | ~fit.converged)] |= int(StarFlag.NOT_CONVERGED)
        position, flux = theta[:, :FLUX] + stamps.corner_px, theta[:, FLUX]
        background = theta[:, -1] if self.fit_background else stamps.background_e
        covariance = fit.covariance[:, : FLUX + 1, : FLUX + 1]
        light, bound = _light(stamps, noise)
        diverged = ~lost & ~((np.abs(flux) <= bound) & _inside(theta, stamps) & np.isfinite(position).all(axis=1))
        if diverged.any():
            flags[diverged] |= int(StarFlag.UNDETERMINED | StarFlag.NOT_CONVERGED)
            position = np.where(diverged[:, None], stamps.start_px, position)
            flux = np.where(diverged, light, flux)
            background = np.where(diverged, stamps.background_e, background)
            covariance = np.where(diverged[:, None, None], _moment_covariance(stamps, noise, light), covariance)
        return StarTable(
            x_px=np.where(lost, np.nan, position[:, X]),
            y_px=np.where(lost, np.nan, position[:, Y]),
            flux_e=np.where(lost, np.nan, flux),
            background_e=background,
            covariance=covariance,
            chi2=fit.chi2,
            freedom=fit.freedom,
            iterations=fit.iterations,
            flags=flags,
            **columns,
        )


def _light(stamps: Stamps, noise: NoiseModel) -> tuple[FloatArray, FloatArray]:
    """Light of each window (n,) [e-] without background, and the largest plausible flux."""
    above = np.where(stamps.valid, stamps.electrons - stamps.background_e[:, None, None], 0.0)
    variance = noise.variance_e2(stamps.background_e) * stamps.valid.sum(axis=(1, 2))
    light = np.maximum(above.sum(axis=(1, 2)), np.sqrt(variance))
    return light, MOST_LIGHT * (np.maximum(above, 0.0).sum(axis=(1, 2)) + 5.0 * np.sqrt(variance))


def _inside(theta: FloatArray, stamps: Stamps) -> NDArray[np.bool_]:
    """Whether positions (n, k) lie in their windows."""
    position, size = theta[:, : Y + 1], np.array(stamps.window[::-1])
    return np.asarray(((position > -0.5) & (position < size - 0.5)).all(axis=1))


def _moment_covariance(stamps: Stamps, noise: NoiseModel, light: FloatArray) -> FloatArray:
    """Covariance (n, 3, 3) of position and flux by the light of the window alone: a matched filter of 1 px."""
    variance = noise.variance_e2(stamps.background_e) * stamps.valid.sum(axis=(1, 2)) + light
    covariance = np.zeros((len(light), FLUX + 1, FLUX + 1))
    with np.errstate(invalid="ignore", divide="ignore"):  # a window without a valid pixel has neither
        position = 2.0 * variance / light**2
    covariance[:, X, X] = covariance[:, Y, Y] = np.fmin(position, 0.25 * stamps.window[0] ** 2)
    covariance[:, FLUX, FLUX] = variance
    return covariance


def _over_chunks(part: Callable[[slice], T], count: int) -> list[T]:
    """``part`` of slices of ``count`` stars, over the processor's cores."""
    slices = [slice(i, min(i + CHUNK, count)) for i in range(0, count, CHUNK)]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    workers = min(len(slices), cores)
    if workers < 2:
        return [part(rows) for rows in slices]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(part, slices))


def _start(stamps: Stamps, rows: slice, noise: NoiseModel, shape_start: FloatArray) -> FloatArray:
    """First parameters: the stamp's start position and the light of the window."""
    light = np.where(stamps.valid[rows], stamps.electrons[rows] - stamps.background_e[rows, None, None], 0.0)
    flux = np.maximum(light.sum(axis=(1, 2)), 5.0 * np.sqrt(noise.floor_e2 + 1.0))
    position = stamps.start_px[rows] - stamps.corner_px[rows]
    return np.column_stack([position, flux, np.tile(shape_start, (len(flux), 1))])
