"""Zero point, colour, vignetting and extinction from the light of stars at known positions.

The flux of a star is that of its PSF at its catalogue position. Its difference to the catalogue is, in magnitudes,

    G + 2.5 lg(flux) = zero point(frame) + colour(5040 K / T) + vignetting(r),

with a colour term that is linear between knots (zero at the reference), vignetting a polynomial of the squared distance
from the middle, and a zero point of every frame. Extinction is the slope of the zero points against airmass. Scatter
beyond the noise of the fluxes is the same for all stars of a frame: scintillation, catalogue, colours of single stars.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from experiments.harness.summary import Measured
from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError

POGSON = 2.5 / np.log(10.0)
COLOUR_KNOTS = np.array([0.40, 0.60, 0.80, 1.00, 1.25, 1.55, 1.90])
REFERENCE_KNOT = 3
FEWEST_STARS = 20
FEWEST_OF_A_KNOT = 4
CLIP_SIGMA = 4.0
ROUNDS = 8
LEAST_AIRMASS_RANGE = 0.1


def hats(colour: FloatArray) -> FloatArray:
    """Weights (n, k) of linear interpolation between the knots; constant beyond the outermost."""
    return np.stack([np.interp(colour, COLOUR_KNOTS, row) for row in np.eye(len(COLOUR_KNOTS))], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Photometry:
    """Brightness of stars in a camera."""

    zero_point_mag: (
        FloatArray  # (frames,) Star of 1 e- per exposure, in the middle, reference colour; NaN without stars
    )
    zero_point_error_mag: FloatArray
    colour_mag: FloatArray  # (k,) At the knots: brighter than the catalogue's magnitude tells; NaN where no star is
    colour_error_mag: FloatArray
    vignetting_mag: FloatArray  # (2,) Coefficients of (r/R)^2 and (r/R)^4, R half of the diagonal
    vignetting_covariance: FloatArray  # (2, 2)
    scatter_mag: FloatArray  # (frames,) Beyond the noise of the fluxes
    residual_mag: FloatArray  # (n,) Of the stars handed in
    kept: NDArray[np.bool_]  # (n,) Not clipped
    extinction_mag: Measured | None = None  # Per airmass
    zero_point_above_mag: Measured | None = None  # Above the atmosphere; without airmasses the mean of the frames

    def loss_at(self, u2: FloatArray) -> FloatArray:
        """Vignetting (n,) [mag] at squared distances in units of half of the diagonal."""
        return self.vignetting_mag[0] * u2 + self.vignetting_mag[1] * u2 * u2

    def loss_error_at(self, u2: float) -> float:
        """Standard deviation of the loss [mag]."""
        by = np.array([u2, u2 * u2])
        return float(np.sqrt(by @ self.vignetting_covariance @ by))


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
) -> Photometry:
    """Fit all stars of all frames at once.

    Shapes: ``magnitude``, ``colour``, ``u2``, ``frame``, ``flux_e``, ``flux_error_e`` (n,), ``airmass`` (frames,) of
    the middle of each frame; ``shape_error_mag`` is the error that all fluxes share, by the shape of the PSF.
    """
    good = (flux_e > 3.0 * flux_error_e) & np.isfinite(flux_e)
    if good.sum() < FEWEST_STARS:
        raise DomainError(f"{int(good.sum())} stars with a flux; photometry needs {FEWEST_STARS}")
    measured = magnitude + POGSON * np.log(np.maximum(flux_e, 1e-9))
    noise = POGSON * flux_error_e / np.maximum(flux_e, 1e-9)
    design, used = _design(colour, u2, frame, frames, good)
    scatter: FloatArray = np.full(frames, 0.05)
    kept = good.copy()
    value: FloatArray = np.zeros(design.shape[1])
    covariance: FloatArray = np.zeros((design.shape[1],) * 2)
    for _ in range(ROUNDS):
        w = np.where(kept, 1.0 / (noise**2 + scatter[frame] ** 2), 0.0)
        covariance = np.asarray(np.linalg.pinv(design.T @ (w[:, None] * design)), float)
        value = covariance @ (design.T @ (w * measured))
        left = measured - design @ value
        mine = [kept & (frame == k) for k in range(frames)]
        scatter = np.array([_excess(left[one], noise[one]) for one in mine])
        kept = good & (np.abs(left) < CLIP_SIGMA * np.sqrt(noise**2 + scatter[frame] ** 2))
    error = np.sqrt(np.diag(covariance))
    whole = np.full(frames + len(COLOUR_KNOTS) + 2, np.nan)
    errors = whole.copy()
    whole[used], errors[used] = value, error
    knots = slice(frames, frames + len(COLOUR_KNOTS))
    colours, colour_errors = whole[knots].copy(), errors[knots].copy()
    colours[REFERENCE_KNOT], colour_errors[REFERENCE_KNOT] = 0.0, 0.0
    zero, zero_error = whole[:frames], errors[:frames]
    shape = covariance[-2:, -2:]
    there = used < frames
    common = float(np.sqrt(covariance[np.ix_(there, there)].mean()))
    slope, above = _extinction(zero, zero_error, airmass)
    above = replace(above, uncertainty=float(np.hypot(max(above.uncertainty or 0.0, common), shape_error_mag)))
    return Photometry(
        zero_point_mag=zero,
        zero_point_error_mag=zero_error,
        colour_mag=colours,
        colour_error_mag=colour_errors,
        vignetting_mag=-whole[-2:],
        vignetting_covariance=shape,
        scatter_mag=scatter,
        residual_mag=np.where(good, measured - design @ value, np.nan),
        kept=kept,
        extinction_mag=slope,
        zero_point_above_mag=above,
    )


def _design(
    colour: FloatArray, u2: FloatArray, frame: IntArray, frames: int, good: NDArray[np.bool_]
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Columns: frames, knots (without the reference and those without stars), two of vignetting; and which they are."""
    knots = hats(colour)
    whole = np.column_stack([np.eye(frames)[frame], knots, u2, u2 * u2])
    there = np.bincount(frame[good], minlength=frames) > 0
    enough = (knots[good] > 0.3).sum(axis=0) >= FEWEST_OF_A_KNOT
    enough[REFERENCE_KNOT] = False
    used = np.flatnonzero(np.concatenate([there, enough, [True, True]]))
    return whole[:, used], used


def _excess(left: FloatArray, noise: FloatArray) -> float:
    """Standard deviation beyond the noise, by the mean square of what is not clipped."""
    if len(left) < 5:
        return 0.05

    def misfit(scatter: float) -> float:
        return float(np.mean(left**2 / (noise**2 + scatter**2))) - 1.0

    return float(brentq(misfit, 1e-4, 5.0)) if misfit(1e-4) > 0 > misfit(5.0) else 0.0


def _extinction(zero: FloatArray, error: FloatArray, airmass: FloatArray | None) -> tuple[Measured | None, Measured]:
    """Loss per airmass, and the zero point without an atmosphere (or the mean one)."""
    known = np.isfinite(zero)
    if airmass is None or known.sum() < 3 or np.ptp(airmass[known]) < LEAST_AIRMASS_RANGE:
        mean, spread = float(np.nanmean(zero)), float(np.nanstd(zero, ddof=1)) if known.sum() > 1 else 0.0
        return None, Measured(value=mean, uncertainty=spread / np.sqrt(max(known.sum(), 1)), n=int(known.sum()))
    x, y = airmass[known], zero[known]
    w = 1.0 / (error[known] ** 2 + 0.005**2)
    design = np.stack([np.ones_like(x), -x], axis=1)
    inverse = np.linalg.inv(design.T @ (w[:, None] * design))
    found = inverse @ (design.T @ (w * y))
    scale = max(1.0, float((w * (y - design @ found) ** 2).sum() / max(len(x) - 2, 1)))
    errors = np.sqrt(np.diag(inverse) * scale)
    return (
        Measured(value=float(found[1]), unit="mag", uncertainty=float(errors[1]), n=len(x)),
        Measured(value=float(found[0]), unit="mag", uncertainty=float(errors[0]), n=len(x)),
    )
