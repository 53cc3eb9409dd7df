"""Attitude from N stars by Monte-Carlo through the estimator, against the rule total / sqrt(N) (ACC18 section 2.4).

Stars are uniform over the detector. Temporal and pixel errors are independent from star to star. The low-frequency
error has three interpretations (`Correlation`):

* ``independent`` from star to star, as dividing the *total* by sqrt(N) assumes;
* ``smooth``: the chromatic part moves all stars alike (eq. 16 is a mean over the field), the distortion part is a
  smooth map, here a random cubic polynomial over the field in every trial;
* ``common``: all of it moves all stars alike.

Pointing errors are displacements of the boresight along x and y (a turn about y displaces along x), and roll about the
boresight. The expected attitude error of a field follows in closed form from its star positions
(`expected_attitude_variance`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from calib.accuracy.error_budget import ErrorBudget, ErrorTerm, over_stars
from calib.attitude.attitude_solution import solve_wahba_many
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from optics.units import ARCSEC_RAD

Correlation = Literal["independent", "smooth", "common"]
DEGREE = 3
"""Of the smooth map: the polynomial of ACC18 eq. 19 is cubic."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectionErrors:
    """Errors of one star, 3 sigma (2,) [arcsec]."""

    random_arcsec: FloatArray  # (2,) Temporal and pixel error
    chromatic_arcsec: FloatArray  # (2,) Low-frequency error
    distortion_arcsec: FloatArray  # (2,)

    @classmethod
    def of(cls, budget: ErrorBudget) -> DirectionErrors:
        """Split of a budget; the total is the same."""
        return cls(
            random_arcsec=np.hypot(budget["TE"].arcsec, budget["HSFE"].arcsec),
            chromatic_arcsec=np.array(budget["LSFE-S"].arcsec),
            distortion_arcsec=budget["LSFE-C1"].arcsec + budget["LSFE-C2"].arcsec,
        )

    @property
    def total_arcsec(self) -> FloatArray:
        """Root sum of squares (2,)."""
        return np.sqrt(self.random_arcsec**2 + self.chromatic_arcsec**2 + self.distortion_arcsec**2)

    def draw_arcsec(self, position: FloatArray, correlation: Correlation, rng: np.random.Generator) -> FloatArray:
        """Errors (t, n, 2), 1 sigma, of stars at positions (t, n, 2) in half widths from the middle."""
        random = self.random_arcsec / 3.0 * rng.standard_normal(position.shape)
        chromatic, distortion = self.chromatic_arcsec / 3.0, self.distortion_arcsec / 3.0
        common = rng.standard_normal((2, len(position), 1, 2))
        if correlation == "independent":
            low = np.hypot(chromatic, distortion) * rng.standard_normal(position.shape)
        elif correlation == "common":
            low = np.hypot(chromatic, distortion) * common[0]
        else:
            low = chromatic * common[0] + distortion * smooth_maps(position, rng)
        return np.asarray(random + low)


def smooth_maps(position: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Random cubic maps (t, n, 2) of unit variance over the field, each with its own coefficients.

    Products of Legendre polynomials of positions (t, n, 2) in half widths, without the constant, which a calibration
    would have removed.
    """
    terms = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i) if i + j > 0]
    along_x, along_y = (np.polynomial.legendre.legvander(position[..., axis], DEGREE) for axis in range(2))
    norm = np.sqrt(2.0 * np.arange(DEGREE + 1) + 1.0)
    basis = np.stack([norm[i] * norm[j] * along_x[..., i] * along_y[..., j] for i, j in terms], axis=-1)
    weight = rng.standard_normal((len(position), len(terms), 2)) / np.sqrt(len(terms))
    return np.asarray(np.einsum("tnk,tka->tna", basis, weight))


def attitude_rule_arcsec(errors: DirectionErrors, half_field: FloatArray, stars: int) -> FloatArray:
    """Total / sqrt(N), (3,) for x, y and roll, 3 sigma; ``half_field`` (2,): half width and height as tangents.

    Roll is the total across the direction to a star, over the RMS distance of a star from the middle; stars at a
    distance along x turn the field by their error along y, and the other way round.
    """
    total, square = errors.total_arcsec, np.square(half_field)
    fraction = square / square.sum()
    across = over_stars(np.sqrt(fraction[0] * total[1] ** 2 + fraction[1] * total[0] ** 2), stars)
    return np.array([*over_stars(total, stars), across / np.sqrt(square.sum() / 3.0)])


def expected_attitude_variance(plane: FloatArray, total_arcsec: FloatArray) -> FloatArray:
    """Variance (t, 3) of x, y and roll that least squares make of independent errors of stars at tangents (t, n, 2).

    The roll moves the boresight by its distance from the mean of the stars. In the square of the unit of
    ``total_arcsec`` (2,).
    """
    middle = plane.mean(1)
    xx, yy = np.moveaxis(((plane - middle[:, None]) ** 2).sum(1), -1, 0)
    roll = (total_arcsec[0] ** 2 * yy + total_arcsec[1] ** 2 * xx) / (xx + yy) ** 2
    shift = over_stars(total_arcsec, plane.shape[1]) ** 2
    return np.stack([shift[0] + middle[:, 1] ** 2 * roll, shift[1] + middle[:, 0] ** 2 * roll, roll], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeScatter:
    """Errors of solved attitudes: x, y, roll."""

    arcsec: FloatArray  # (3,) 3 sigma, root mean square over the trials
    stated_arcsec: FloatArray  # (3,) The same as stated by the estimator
    over_expected: FloatArray  # (3,) In units of `expected_attitude_variance` of each field, root mean square
    trials: int  # Fields of stars
    failed: int  # Trials without an attitude

    @property
    def relative_error(self) -> float:
        """Relative standard error of the numbers: standard deviations from so many trials."""
        return float(1.0 / np.sqrt(2.0 * self.trials))


def simulate_attitudes(
    errors: DirectionErrors,
    half_field: FloatArray,
    stars: int,
    *,
    trials: int,
    rng: np.random.Generator,
    correlation: Correlation = "independent",
) -> AttitudeScatter:
    """Solve the attitudes of drawn fields of two stars or more.

    ``half_field`` (2,): half width and height as tangents; ``correlation`` of the low-frequency error as of the module.
    """
    position = rng.uniform(-1.0, 1.0, (trials, stars, 2))
    plane = position * half_field
    true = np.concatenate([plane, np.ones((trials, stars, 1))], axis=2)
    true /= np.linalg.norm(true, axis=2, keepdims=True)
    shift = errors.draw_arcsec(position, correlation, rng) * ARCSEC_RAD
    observed = _shifted(true, shift)
    attitude = Rotation.random(trials, rng=rng)
    reference = np.einsum("tji,tnj->tni", attitude.as_matrix(), true)
    solved = solve_wahba_many(
        observed.reshape(-1, 3),
        reference.reshape(-1, 3),
        np.repeat(np.arange(trials), stars),
        frames=trials,
        sigma_rad=float(np.sqrt((errors.total_arcsec**2).mean())) / 3.0 * ARCSEC_RAD,
    )
    usable = np.isfinite(np.einsum("fii->f", solved.covariance_rad2))
    turn = attitude_error_arcsec(solved.rotation, attitude)[usable]
    order = [1, 0, 2]  # a turn about y displaces the boresight along x
    expected = expected_attitude_variance(plane, errors.total_arcsec)[usable] / 9.0
    return AttitudeScatter(
        arcsec=3.0 * np.sqrt(np.mean(turn**2, axis=0))[order],
        stated_arcsec=3.0 * np.sqrt(np.mean(solved.sigma_arcsec[usable] ** 2, axis=0))[order],
        over_expected=np.sqrt(np.mean(turn[:, order] ** 2 / expected, axis=0)),
        trials=trials,
        failed=int(np.count_nonzero(~usable)),
    )


def _shifted(direction: FloatArray, shift_rad: FloatArray) -> FloatArray:
    """Unit vectors (t, n, 3) moved by angles (t, n, 2) along x and y of the camera."""
    along = np.array([1.0, 0.0, 0.0]) - direction * direction[..., :1]
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    moved = direction + shift_rad[..., :1] * along + shift_rad[..., 1:] * np.cross(direction, along)
    return np.asarray(moved / np.linalg.norm(moved, axis=2, keepdims=True))


def attitude_term(
    budget: ErrorBudget, half_field: FloatArray, *, stars: int, trials: int, rng: np.random.Generator
) -> ErrorTerm:
    """Error of attitudes solved from N stars with the errors of a budget, independent from star to star.

    Without the rule ``total / sqrt(N)``; parameters as of `simulate_attitudes`.
    """
    scatter = simulate_attitudes(DirectionErrors.of(budget), half_field, stars, trials=trials, rng=rng)
    of_total = budget.total.uncertainty_arcsec / np.maximum(budget.total.arcsec, 1e-300)
    value = scatter.arcsec[:2]
    return ErrorTerm(arcsec=value, uncertainty_arcsec=value * np.hypot(of_total, scatter.relative_error), n=trials)
