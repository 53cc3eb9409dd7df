"""Zero point, colour term, vignetting and extinction from instrumental fluxes of catalogue stars.

The difference of a star's flux to its catalogue magnitude is

    G + 2.5 lg(flux) = zero point(frame) + colour term(5040 K / T) - vignetting(r),

with a colour term that is linear between knots (zero at the reference), vignetting a polynomial of the squared distance
from the middle, and a zero point of every frame. Extinction is the slope of the zero points against air mass. Scatter
beyond the noise of the fluxes is the same for all stars of a frame: scintillation, catalogue, colours of single stars.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.fitting.excess_error import excess_sigma
from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError

POGSON = 2.5 / np.log(10.0)
COLOUR_KNOTS = np.array([0.40, 0.60, 0.80, 1.00, 1.25, 1.55, 1.90])
"""Knots of the colour term in 5040 K / T."""
REFERENCE_KNOT = 3
FEWEST_STARS, FEWEST_OF_A_KNOT, FEWEST_OF_A_FRAME = 20, 4, 5
CLIP_SIGMA, ROUNDS = 4.0, 8
START_SCATTER_MAG = 0.05
LEAST_AIRMASS_RANGE = 0.1
ZERO_POINT_FLOOR_MAG = 0.005
"""Error of a frame's zero point by the atmosphere, for the weights of the extinction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotometricSolution:
    """Response of a camera to starlight; errors are standard deviations."""

    # (frames,) G of a star of 1 e- per exposure, in the middle, of the reference colour; NaN in frames without stars
    zero_point_mag: FloatArray
    zero_point_error_mag: FloatArray
    colour_mag: FloatArray  # (k,) Excess brightness over G at `COLOUR_KNOTS`; NaN without stars
    colour_error_mag: FloatArray
    vignetting_mag: FloatArray  # (2,) Coefficients of (r/R)^2 and (r/R)^4, R half of the diagonal
    vignetting_covariance: FloatArray  # (2, 2)
    scatter_mag: FloatArray  # (frames,) Beyond the noise of the fluxes
    extinction_mag: float = float("nan")  # Per air mass; NaN without different air masses
    extinction_error_mag: float = float("nan")
    above_mag: float = float("nan")  # Zero point above the atmosphere; the mean of the frames without air masses
    above_error_mag: float = float("nan")
    frames: int = 0  # Frames with a zero point

    def vignetting_at(self, u2: ArrayLike) -> FloatArray:
        """Vignetting (n,) [mag] at squared distances from the middle in units of half of the diagonal."""
        u2 = np.asarray(u2, float)
        return np.asarray(self.vignetting_mag[0] * u2 + self.vignetting_mag[1] * u2 * u2)

    def vignetting_error_at(self, u2: float) -> float:
        """Standard deviation of the vignetting [mag]."""
        powers = np.array([u2, u2 * u2])
        return float(np.sqrt(powers @ self.vignetting_covariance @ powers))


def fit_photometry(
    *,
    magnitude: FloatArray,
    colour: FloatArray,
    u2: FloatArray,
    frame: IntArray,
    frames: int,
    flux_e: FloatArray,
    flux_error_e: FloatArray,
    airmass: FloatArray | None = None,
    shape_error_mag: float = 0.0,
) -> PhotometricSolution:
    """Photometric solution of all stars of all frames.

    Parameters
    ----------
    magnitude, colour, u2, frame, flux_e, flux_error_e : (n,)
        Catalogue magnitude (G), 5040 K / T, squared distance from the middle over half of the diagonal, number of the
        frame, flux per exposure and its standard deviation.
    frames : int
        Number of frames.
    airmass : (frames,), optional
        Air mass of the middle of each frame.
    shape_error_mag : float
        Error common to all fluxes, from the shape of the PSF.

    Raises
    ------
    DomainError
        On fewer than 20 stars with a flux above 3 sigma.
    """
    good = (flux_e > 3.0 * flux_error_e) & np.isfinite(flux_e)
    if good.sum() < FEWEST_STARS:
        raise DomainError(f"{int(good.sum())} stars with a flux; photometry needs {FEWEST_STARS}")
    measured = magnitude + POGSON * np.log(np.maximum(flux_e, 1e-9))
    noise = POGSON * flux_error_e / np.maximum(flux_e, 1e-9)
    design, determined = _design(colour, u2, frame, frames, good)
    scatter: FloatArray = np.full(frames, START_SCATTER_MAG)
    used = good.copy()
    covariance: FloatArray = np.zeros((design.shape[1],) * 2)
    for _ in range(ROUNDS):
        weight = np.where(used, 1.0 / (noise**2 + scatter[frame] ** 2), 0.0)
        covariance = np.asarray(np.linalg.pinv(design.T @ (weight[:, None] * design)), float)
        value = covariance @ (design.T @ (weight * measured))
        residual = measured - design @ value
        of_frame = [used & (frame == k) for k in range(frames)]
        scatter = np.array(
            [
                excess_sigma(residual[rows, None], noise[rows] ** 2) if rows.sum() >= FEWEST_OF_A_FRAME else start
                for rows, start in zip(of_frame, scatter, strict=True)
            ]
        )
        used = good & (np.abs(residual) < CLIP_SIGMA * np.sqrt(noise**2 + scatter[frame] ** 2))
    parameters = np.full((2, frames + len(COLOUR_KNOTS) + 2), np.nan)
    parameters[:, determined] = value, np.sqrt(np.diag(covariance))
    zero, zero_error = parameters[:, :frames]
    colours = parameters[:, frames:-2].copy()
    colours[:, REFERENCE_KNOT] = 0.0
    of_frames = determined < frames
    common = float(np.sqrt(covariance[np.ix_(of_frames, of_frames)].mean()))
    solution = PhotometricSolution(
        zero_point_mag=zero,
        zero_point_error_mag=zero_error,
        colour_mag=colours[0],
        colour_error_mag=colours[1],
        vignetting_mag=-parameters[0, -2:],
        vignetting_covariance=covariance[-2:, -2:],
        scatter_mag=scatter,
    )
    solution = _with_extinction(solution, airmass)
    return replace(solution, above_error_mag=float(np.hypot(max(solution.above_error_mag, common), shape_error_mag)))


def _design(
    colour: FloatArray, u2: FloatArray, frame: IntArray, frames: int, good: NDArray[np.bool_]
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Design matrix of the determined parameters, and their indices among frames, knots and two of vignetting."""
    hats = np.stack([np.interp(colour, COLOUR_KNOTS, row) for row in np.eye(len(COLOUR_KNOTS))], axis=1)
    design = np.column_stack([np.eye(frames)[frame], hats, u2, u2 * u2])
    with_stars = np.bincount(frame[good], minlength=frames) > 0
    with_colour = (hats[good] > 0.3).sum(axis=0) >= FEWEST_OF_A_KNOT
    with_colour[REFERENCE_KNOT] = False
    determined = np.flatnonzero(np.concatenate([with_stars, with_colour, [True, True]]))
    return design[:, determined], determined


def _with_extinction(solution: PhotometricSolution, airmass: FloatArray | None) -> PhotometricSolution:
    """Solution with loss per air mass and zero point above the atmosphere, or with the mean zero point."""
    zero, error = solution.zero_point_mag, solution.zero_point_error_mag
    finite = np.isfinite(zero)
    count = int(finite.sum())
    if airmass is None or count < 3 or np.ptp(airmass[finite]) < LEAST_AIRMASS_RANGE:
        spread = float(np.nanstd(zero, ddof=1)) if count > 1 else 0.0
        mean = float(np.nanmean(zero))
        return replace(solution, above_mag=mean, above_error_mag=spread / np.sqrt(max(count, 1)), frames=count)
    x, y = airmass[finite], zero[finite]
    weight = 1.0 / (error[finite] ** 2 + ZERO_POINT_FLOOR_MAG**2)
    design = np.stack([np.ones_like(x), -x], axis=1)
    inverse = np.linalg.inv(design.T @ (weight[:, None] * design))
    value = inverse @ (design.T @ (weight * y))
    misfit = max(1.0, float((weight * (y - design @ value) ** 2).sum() / max(count - 2, 1)))
    errors = np.sqrt(np.diag(inverse) * misfit)
    return replace(
        solution,
        extinction_mag=float(value[1]),
        extinction_error_mag=float(errors[1]),
        above_mag=float(value[0]),
        above_error_mag=float(errors[0]),
        frames=count,
    )


def noiseless_zero_point(
    magnitude: FloatArray, colour: FloatArray, u2: FloatArray, flux_e: FloatArray
) -> tuple[float, float]:
    """Zero point and vignetting at the corner [mag] by least squares of noiseless stars (n,) near reference colour."""
    near = (np.abs(colour - 1.0) < 0.15) & (u2 < 0.9)
    value = magnitude[near] + 2.5 * np.log10(flux_e[near])
    design = np.column_stack([np.ones(near.sum()), colour[near] - 1.0, -u2[near], -(u2[near] ** 2)])
    zero, _, *loss = np.linalg.lstsq(design, value, rcond=None)[0]
    return float(zero), float(loss[0] + loss[1])


def scatter_at(airmass: FloatArray, scatter_mag: FloatArray, at: float) -> float:
    """Photometric scatter [mag] at an air mass, from that of other frames (n,): linear in air mass, or their mean.

    The mean of fewer than four frames, of unknown air masses, and of a range below 0.1.
    """
    finite = np.isfinite([*airmass, at]).all()
    if finite and len(airmass) >= 4 and np.ptp(airmass) > LEAST_AIRMASS_RANGE:
        return float(np.clip(np.polyval(np.polyfit(airmass, scatter_mag, 1), at), 0.0, 1.0))
    return float(np.mean(scatter_mag))
