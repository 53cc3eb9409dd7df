"""Attitude from star directions: Wahba's problem for one frame or thousands, with covariance, tests and parity.

The attitude is the rotation with ``v_cam = R v_ref``; ``ref`` is the frame of the reference directions (icrs,
laboratory). Its error is a rotation vector in cam, ``R = exp(error) R_true``: x and y lie across the boresight, z is
the roll. With independent errors of size sigma across each direction, the covariance of the error vector is

    P = (sum (I - v v^T) / sigma^2)^-1        (Shuster and Oh 1981, J. Guid. Control 4, 70)

which is a Cramer-Rao bound that the estimate reaches. In a narrow field the roll is worse than the boresight by about
one over the field's half-width in radians.

Wahba's loss ``sum |v_cam - R v_ref|^2 / (2 sigma^2)`` of n stars is half a chi-square of 2n - 3 degrees of freedom, so
its expected value is (2n - 3) / 2 (the TASTE test; Shuster and Freesland 2005, Flight Mechanics Symposium).

A mirrored sky is found by comparing with the best reflection: the loss of the best rotation and of the best reflection
differ by twice the smallest singular value of the profile matrix. Two stars, or stars on one great circle, fit
both alike, and their parity stays undecided.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from scipy.special import gammaincc

from calib.attitude.exchanged_identities import best_exchange
from calib.attitude.wahba import adjugate3, rotation_quest, rotation_svd
from calib.fitting.misfit import ChiSquare, joined
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.records import freeze, locked
from optics.units import RAD_ARCSEC

Method = Literal["svd", "quest"]

UNIT_TOLERANCE = 1e-6  # a direction further from unit length is something else: degrees, hours, pixels
DEGENERATE_SPREAD = 1e-13  # smallest over largest information; below, all stars lie within 3e-7 rad of one axis
DEGENERATE_SIGMA_RAD = 0.5  # a rotation less certain than this is not measured
PARITY_CHI2 = 25.0  # chi-square by which one parity must beat the other: 5 sigma
EXCHANGED_PART = 0.04  # of the loss, and of that of a reflection: an exchange must make residuals five times smaller
P_LIMIT = 1e-6  # probability of the loss below which measurements and sigma contradict each other


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class AttitudeSolution:
    """One attitude.

    Attributes
    ----------
    rotation : Rotation
        cam from reference. In a degenerate frame one of the many that fit.
    covariance_rad2 : (3, 3)
        Of the error's rotation vector in cam [rad^2]; infinite diagonal where degenerate.
    status : str
        ``"ok"``; ``"degenerate"``: fewer than two stars, or all in one direction (or in two opposite ones);
        ``"exchanged"``: the stars are consistent only if the identifications of two stars are exchanged;
        ``"mirrored"``: a reflection fits at least twice as well (in sigmas) as any rotation; ``"inconsistent"``: the
        loss is too large for the stated sigma (probability below 1e-6), or a reflection fits a little better.
    message : str
        One line on what the status means here, and on a stated sigma that the stars contradict.
    parity : int
        1: a rotation fits better than any reflection by 5 sigma, -1: worse by 5 sigma, 0: undecided.
    loss, expected_loss : float
        ``sum |v_cam - R v_ref|^2 / (2 sigma^2)`` and its expected value (2n - 3) / 2. Without a stated sigma the
        loss is measured with the estimated one, and equal to its expectation.
    probability : float
        Of a loss at least as large, NaN without a stated sigma or without degrees of freedom.
    sigma_rad : float
        Scale of the errors: 1 where the sigmas were stated, else the error per axis of a star of weight 1.
    stars : int
        Number of stars.
    exchanged : (2,) int64
        Rows of the two stars that fit with their names exchanged; -1 unless the status says so. The rotation is that of
        the stars as they were given.
    """

    rotation: Rotation
    covariance_rad2: FloatArray
    status: str
    message: str
    parity: int
    loss: float
    expected_loss: float
    probability: float
    sigma_rad: float
    stars: int
    exchanged: NDArray[np.int64]

    def __post_init__(self) -> None:
        freeze(self, "covariance_rad2", shape=(3, 3), finite=False)
        freeze(self, "exchanged", shape=(2,), dtype=np.int64)

    def __repr__(self) -> str:
        sigma = ", ".join(f"{value:.3g}" for value in self.sigma_arcsec)
        return (
            f"<AttitudeSolution {joined(f'{self.status}: {self.message}', f'sigma {sigma} arcsec', str(self.misfit))}>"
        )

    @property
    def ok(self) -> bool:
        """Whether the attitude can be used."""
        return self.status == "ok"

    @property
    def misfit(self) -> ChiSquare:
        """Twice the loss against its expectation 2n - 3; not tested without a stated sigma."""
        freedom = 0 if np.isnan(self.probability) else round(2.0 * self.expected_loss)
        return ChiSquare(value=2.0 * self.loss, degrees_of_freedom=freedom)

    @property
    def sigma_arcsec(self) -> FloatArray:
        """Standard deviation (3,) of the error about cam x, y (across the boresight) and z (roll) [arcsec]."""
        return np.asarray(np.sqrt(np.diag(self.covariance_rad2)) * RAD_ARCSEC)


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeSolutions:
    """Attitudes of f frames: the fields of `AttitudeSolution` with a leading axis f; ``rotation`` holds f rotations."""

    rotation: Rotation
    covariance_rad2: FloatArray
    status: NDArray[np.str_]
    parity: NDArray[np.int64]
    loss: FloatArray
    expected_loss: FloatArray
    probability: FloatArray
    sigma_rad: FloatArray
    stars: NDArray[np.int64]
    exchanged: NDArray[np.int64]

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {"f": len(self.rotation)}
        freeze(self, "covariance_rad2", shape=("f", 3, 3), finite=False, sizes=sizes)
        object.__setattr__(self, "status", locked(self.status, np.str_))
        for name in ("parity", "stars"):
            freeze(self, name, shape=("f",), dtype=np.int64, sizes=sizes)
        freeze(self, "exchanged", shape=("f", 2), dtype=np.int64, sizes=sizes)
        for name in ("loss", "expected_loss", "probability", "sigma_rad"):
            freeze(self, name, shape=("f",), finite=False, sizes=sizes)

    def __len__(self) -> int:
        return len(self.status)

    @property
    def ok(self) -> NDArray[np.bool_]:
        """(f,) Whether each attitude can be used."""
        return np.asarray(self.status == "ok")

    @property
    def sigma_arcsec(self) -> FloatArray:
        """Standard deviations (f, 3) about cam x, y (across the boresight) and z (roll) [arcsec]."""
        return np.asarray(np.sqrt(np.einsum("fii->fi", self.covariance_rad2)) * RAD_ARCSEC)

    def frame(self, index: int) -> AttitudeSolution:
        """The solution of one frame."""
        numbers = {name: getattr(self, name)[index].item() for name in _PER_FRAME}
        solution = AttitudeSolution(
            rotation=self.rotation[index],
            covariance_rad2=self.covariance_rad2[index],
            message="",
            exchanged=self.exchanged[index],
            **numbers,
        )
        return replace(solution, message=_message(solution))


_PER_FRAME = ("status", "parity", "loss", "expected_loss", "probability", "sigma_rad", "stars")


def solve_wahba(
    v_cam: ArrayLike,
    v_ref: ArrayLike,
    *,
    sigma_rad: ArrayLike | None = None,
    weight: ArrayLike | None = None,
    method: Method = "svd",
) -> AttitudeSolution:
    """Attitude of one frame.

    Parameters
    ----------
    v_cam, v_ref : (n, 3)
        Unit vectors of the stars as measured (cam) and in the reference frame.
    sigma_rad : float or (n,), optional
        Error of the measured directions, per axis [rad].
    weight : (n,), optional
        Relative weights (1 / variance) where no sigma is known; the scale of the errors is then estimated from the fit.
        Without either, all stars weigh the same.
    method : {"svd", "quest"}
        See `calib.attitude.wahba`. Both give the same rotation.

    Returns
    -------
    AttitudeSolution
        Rotation cam from reference, its covariance, and what the fit says about itself.

    Raises
    ------
    DomainError
        On shapes that do not agree, values that are not finite, vectors not of unit length, sigmas or weights that are
        not positive.
    ConfigError
        On an unknown method, or both sigma and weight.
    """
    v_cam = np.asarray(v_cam, float)
    frame = np.zeros(len(v_cam) if v_cam.ndim else 0, np.int64)
    solutions = solve_wahba_many(v_cam, v_ref, frame, frames=1, sigma_rad=sigma_rad, weight=weight, method=method)
    return solutions.frame(0)


def solve_wahba_many(
    v_cam: ArrayLike,
    v_ref: ArrayLike,
    frame: ArrayLike,
    *,
    frames: int | None = None,
    sigma_rad: ArrayLike | None = None,
    weight: ArrayLike | None = None,
    method: Method = "svd",
) -> AttitudeSolutions:
    """Attitudes of many frames at once; frames may hold any number of stars, none included.

    Parameters
    ----------
    v_cam, v_ref : (n, 3)
        Unit vectors of all stars of all frames, in any order.
    frame : (n,) int
        Frame of each star, 0 to ``frames - 1``.
    frames : int, optional
        Number of frames f; the largest index plus one if left out.
    sigma_rad, weight, method : optional
        As in `solve_wahba`.

    Returns
    -------
    AttitudeSolutions
        The same per frame.

    Raises
    ------
    DomainError, ConfigError
        As in `solve_wahba`, and on a frame index out of range.
    """
    if method not in ("svd", "quest"):
        raise ConfigError(f"method = {method!r} of Wahba's problem is not known; take 'svd' or 'quest'")
    v_cam, v_ref = _directions("v_cam", v_cam), _directions("v_ref", v_ref)
    if len(v_cam) != len(v_ref):
        raise DomainError(
            f"{len(v_cam)} directions v_cam and {len(v_ref)} directions v_ref; each star needs both directions"
        )
    index, count = _frame_index(frame, len(v_cam), frames)
    weights = _weights(sigma_rad, weight, len(v_cam))
    stars = np.asarray(np.bincount(index, minlength=count), np.int64)
    total = _counted(index, weights, count)
    fraction = weights / np.where(total > 0, total, 1.0)[index]
    measured, reference = np.ascontiguousarray(v_cam.T), np.ascontiguousarray(v_ref.T)
    profile = _summed(fraction * measured, reference, index, count)
    matrix = rotation_quest(profile) if method == "quest" else rotation_svd(profile)

    predicted = np.matmul(matrix[index], v_ref[:, :, None])[:, :, 0].T
    loss = 0.5 * _counted(index, weights * np.sum((measured - predicted) ** 2, axis=0), count)
    outer = matrix @ _summed(fraction * reference, reference, index, count) @ matrix.swapaxes(1, 2)
    # 2 * smallest eigenvalue of B R^T: what a reflection loses (positive) or gains (negative) against the rotation.
    symmetric = profile @ matrix.swapaxes(1, 2)
    smallest = np.asarray(np.linalg.eigvalsh(0.5 * (symmetric + symmetric.swapaxes(1, 2)))[:, 0], np.float64)
    stated = sigma_rad is not None
    solved = _judged(Rotation.from_matrix(matrix), outer, loss, smallest, total, stars, stated=stated)
    return _with_exchanges(solved, v_cam, v_ref, weights, index, matrix, loss, loss + 2.0 * total * smallest)


def _with_exchanges(
    solved: AttitudeSolutions,
    v_cam: FloatArray,
    v_ref: FloatArray,
    weights: FloatArray,
    index: NDArray[np.int64],
    matrix: FloatArray,
    loss: FloatArray,
    reflected: FloatArray,
) -> AttitudeSolutions:
    """The same, with the frames named in which two stars were exchanged: frames that neither a rotation explains nor,
    five times worse than the exchange, a reflection."""
    doubtful = np.isin(solved.status, ("mirrored", "inconsistent")) & (solved.stars > 2)
    if len(solved) == 1 and np.isnan(solved.probability[0]):  # without a sigma only the comparison tells
        doubtful |= (solved.status == "ok") & (solved.stars > 3)
    if not doubtful.any():
        return solved
    status, exchanged = np.array(solved.status), np.array(solved.exchanged)
    for frame in np.flatnonzero(doubtful):
        rows = np.flatnonzero(index == frame)
        pair, loss_exchanged = best_exchange(v_cam[rows], v_ref[rows], weights[rows], matrix[frame])
        if loss_exchanged < EXCHANGED_PART * min(loss[frame], max(reflected[frame], 0.0)):
            status[frame], exchanged[frame] = "exchanged", rows[pair]
    return replace(solved, status=status, exchanged=exchanged)


def _judged(
    rotation: Rotation,
    outer: FloatArray,
    loss: FloatArray,
    smallest: FloatArray,
    total: FloatArray,
    stars: NDArray[np.int64],
    *,
    stated: bool,
) -> AttitudeSolutions:
    """Covariance, chi-square test, parity and status of solved frames."""
    free = np.maximum(2 * stars - 3, 0)
    reflected = np.maximum(loss + 2.0 * total * smallest, 0.0)
    per_degree = 2.0 / np.maximum(free, 1)
    scale2 = np.ones(len(loss)) if stated else loss * per_degree
    yardstick = scale2 if stated else np.minimum(loss, reflected) * per_degree
    resolved = (np.abs(smallest) > 1e-13) & (4.0 * total * np.abs(smallest) > PARITY_CHI2 * yardstick)
    parity = np.where(resolved, np.sign(smallest), 0).astype(np.int64)

    covariance, spread = _covariance(outer)
    covariance = covariance * np.where(total > 0, scale2 / np.where(total > 0, total, 1.0), 1.0)[:, None, None]
    degenerate = (stars < 2) | (spread < DEGENERATE_SPREAD)
    if stated:
        degenerate |= np.einsum("fii->f", covariance) > DEGENERATE_SIGMA_RAD**2
    covariance = np.where(degenerate[:, None, None], np.where(np.eye(3) > 0, np.inf, np.nan), covariance)

    probability = np.full(len(loss), np.nan)
    if stated:
        tested = (free > 0) & ~degenerate
        probability[tested] = gammaincc(free[tested] / 2.0, loss[tested])
    status = np.full(len(loss), "ok", dtype="<U12")
    status[(probability < P_LIMIT) | (parity < 0)] = "inconsistent"
    status[(parity < 0) & (reflected < 0.25 * loss)] = "mirrored"
    status[degenerate] = "degenerate"
    return AttitudeSolutions(
        rotation=rotation,
        covariance_rad2=covariance,
        status=status,
        parity=parity,
        loss=loss if stated else np.where(scale2 > 0, loss / np.where(scale2 > 0, scale2, 1.0), 0.0),
        expected_loss=free / 2.0,
        probability=probability,
        sigma_rad=np.sqrt(scale2),
        stars=stars,
        exchanged=np.full((len(loss), 2), -1),
    )


def _covariance(outer: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverse (f, 3, 3) of ``I - outer`` and its smallest eigenvalue (f,), the latter within a factor of three."""
    # The weights add up to one, so that tr(outer) I - outer is the information per unit of weight.
    trace = np.trace(outer, axis1=1, axis2=2)
    adjugate, determinant = adjugate3(trace[:, None, None] * np.eye(3) - outer)
    minors = np.trace(adjugate, axis1=1, axis2=2)
    spread = np.where(minors > 0, determinant / np.where(minors > 0, minors, 1.0), 0.0)
    return adjugate / np.where(spread > 0, determinant, 1.0)[:, None, None], spread


def _counted(index: NDArray[np.int64], values: FloatArray, count: int) -> FloatArray:
    """Sums (f,) over the stars (n,) of each frame."""
    return np.asarray(np.bincount(index, values, minlength=count), np.float64)


def _summed(first: FloatArray, second: FloatArray, index: NDArray[np.int64], count: int) -> FloatArray:
    """Sums (f, 3, 3) of ``first second^T`` (3, n each) over the stars of each frame."""
    sums = [[_counted(index, row * column, count) for column in second] for row in first]
    return np.asarray(np.moveaxis(np.array(sums), 2, 0))


def _directions(name: str, values: ArrayLike) -> FloatArray:
    v = np.asarray(values, float)
    if v.ndim != 2 or v.shape[1] != 3:
        raise DomainError(f"{name} has shape {v.shape}; unit vectors of shape (n, 3) are needed")
    length = np.sqrt(np.einsum("ni,ni->n", v, v))
    wrong = np.flatnonzero(~(np.abs(length - 1.0) <= UNIT_TOLERANCE))
    if len(wrong):
        what = "is not finite" if not np.isfinite(length[wrong[0]]) else f"has length {length[wrong[0]]:.9g}"
        raise DomainError(
            f"{name}: row {wrong[0]} {what} ({len(wrong)} such rows); unit vectors are needed, "
            "leave out stars without a direction"
        )
    return np.asarray(v / length[:, None])


def _frame_index(frame: ArrayLike, n: int, frames: int | None) -> tuple[NDArray[np.int64], int]:
    index = np.asarray(frame)
    if index.shape != (n,) or (n and not np.issubdtype(index.dtype, np.integer)):
        raise DomainError(
            f"frame has shape {index.shape} and type {index.dtype}; one whole number per star ({n}) is needed"
        )
    index = index.astype(np.int64)
    count = int(index.max(initial=-1)) + 1 if frames is None else int(frames)
    if n and (index.min() < 0 or index.max() >= count):
        raise DomainError(
            f"frame runs from {index.min()} to {index.max()}; 0 to {count - 1} is allowed for {count} frames"
        )
    return index, count


def _weights(sigma_rad: ArrayLike | None, weight: ArrayLike | None, n: int) -> FloatArray:
    if sigma_rad is not None and weight is not None:
        raise ConfigError(
            "sigma_rad and weight are both given; state the error (sigma_rad) or, if it is unknown, the weights"
        )
    name, given = ("weight", weight) if sigma_rad is None else ("sigma_rad", sigma_rad)
    values = np.asarray(1.0 if given is None else given, float)
    if values.shape not in ((), (n,)):
        raise DomainError(f"{name} has shape {values.shape}; one number, or one for each of the {n} stars, is needed")
    if not (np.isfinite(values) & (values > 0)).all():
        bad: Any = values[()] if values.ndim == 0 else values[~(np.isfinite(values) & (values > 0))][0]
        raise DomainError(f"{name} = {bad}; it must be finite and positive")
    values = np.broadcast_to(values, (n,))
    return np.asarray(values if sigma_rad is None else values**-2)


def _message(solution: AttitudeSolution) -> str:
    stars, status = solution.stars, solution.status
    if status == "degenerate":
        return f"{stars} stars do not fix a rotation: at least two in different directions are needed"
    if status == "exchanged":
        first, second = solution.exchanged
        return f"stars {first} and {second} (rows) are interchanged: with exchanged identities the {stars} stars fit"
    if status == "mirrored":
        return (
            f"mirrored sky: a reflection fits the {stars} stars better than any rotation; one image axis is flipped, "
            "or rows and columns are exchanged"
        )
    if status == "inconsistent":
        return (
            f"loss {solution.loss:.4g} of {stars} stars where {solution.expected_loss:.4g} is expected: wrong matches, "
            "a wrong camera model or too small a sigma"
        )
    return joined(f"{stars} stars", solution.misfit.note)
