"""Circle through edge points: orthogonal distances, weights, outliers, covariance.

The sum of squared orthogonal distances (Gander, Golub & Strebel 1994, BIT 34, 558) is minimal, from an algebraic start:
Taubin's fit (1991, IEEE PAMI 13, 1115) in the form of Chernov (2010, *Circular and Linear Regression*, sec. 5.9).

Outliers. Circles through three points each, an even selection of all such sets without random draws, are ranked by the
distance within which most points lie (least median of squares, Rousseeuw 1984, JASA 79, 871); the points near the best
circle start a fit that includes and excludes points until they are stable. Up to 40 % of the points may be outliers,
even on another circle; with more the fit is refused.

The covariance of the parameters is ``(J^T W J)^-1`` with the stated errors of the points, scaled up by the reduced
chi-square if the points scatter more than stated, and by the variance of an estimated scatter (Student's law). An arc
that is indistinguishable from a line determines no circle: its curvature 1/r must differ from zero by three sigma, r >
3 sigma_r, otherwise the status is "singular" and the sigmas are infinite.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.special import stdtrit

from calib.fitting.determined import covariance_of_jacobian
from calib.fitting.misfit import LARGEST_RATIO, LARGEST_WRONG_PART, ChiSquare, joined
from calib.fitting.solution import STATUSES
from optics.arrays import FloatArray
from optics.errors import DomainError, unknown_name
from optics.records import freeze

STEPS = 50
CLIP_SIGMA = 4.0
CLIP_ROUNDS = 20
SETS = 150
"""Number of trial circles: with 40 % outliers a fifth of all triples are without outliers."""
FEWEST = 4
"""Points of a fit."""
CURVED_SIGMA = 3.0
"""Smallest significance of the curvature of a circle, against a line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CircleFit:
    """A fitted circle, and the residuals of the fit."""

    centre: FloatArray  # (2,) In the unit of the points
    radius: float
    covariance: FloatArray  # (3, 3) Of x, y and radius; infinite on the diagonal for undetermined parameters
    rms: float  # Of the orthogonal distances of the points used
    misfit: ChiSquare  # Weighted squared distances of the points used; not tested without stated errors
    used: NDArray[np.bool_]  # (n,) Points that were not rejected
    # "converged"; "singular": undetermined, or indistinguishable from a line; "refused": more than 40 % outliers, or
    # scatter above 10 times sigma; "iteration_limit"
    status: str
    message: str  # One line on the status, on outliers, and on a stated noise that the points contradict

    def __post_init__(self) -> None:
        if self.status not in STATUSES:
            raise unknown_name("status", self.status, STATUSES)
        freeze(self, "centre", shape=(2,))
        freeze(self, "covariance", shape=(3, 3), finite=False)
        freeze(self, "used", shape=("n",), dtype=np.bool_)

    @property
    def converged(self) -> bool:
        """Whether the circle may be used."""
        return self.status == "converged"

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations of the parameters, in the order of the covariance."""
        return np.sqrt(np.diag(self.covariance))


def fit_circle(points: ArrayLike, *, sigma: ArrayLike | None = None) -> CircleFit:
    """Circle of least squared orthogonal distance.

    Examples
    --------
    A line with noise gives a circle with the status "singular":

    >>> x = np.arange(40.0)
    >>> line = fit_circle(np.column_stack([x, 2 * x + 0.1 * np.cos(37 * x**2)]), sigma=0.1)
    >>> line.status, line.sigma
    ('singular', array([inf, inf, inf]))

    Shapes: ``points`` (n, 2), ``sigma`` (n,).
    """
    point, error, stated = _checked(points, sigma)
    used, converged = _consensus(point, error, stated), True
    for _ in range(CLIP_ROUNDS):
        value, converged = _least_squares(point[used], error[used], _taubin(point[used]))
        distance = np.abs(_distance(point, value)[0]) / error
        inliers = _inliers(distance, distance[used], len(value), stated)
        if np.array_equal(inliers, used) or inliers.sum() < FEWEST:
            break
        used = inliers
    x, y, radius = value.tolist()
    return CircleFit(centre=np.array([x, y]), radius=radius, **_judged(point, error, value, used, converged, stated))


def _consensus(point: FloatArray, error: FloatArray, stated: bool) -> NDArray[np.bool_]:
    """Inliers (n,) of the circle of least median of squares."""
    n, size = len(point), 3
    value = _circles(point[_even_sets(n, size, SETS)])
    rank = (n + size + 1) // 2
    distance = _distances(value, point) / error
    score = np.partition(distance, rank - 1, axis=1)[:, rank - 1]
    best = distance[int(np.nanargmin(score))] if np.isfinite(score).any() else np.zeros(n)
    # the rank-th of n distances, corrected for the few points that define the circle (Rousseeuw & Leroy 1987, ch. 5)
    nearest = np.sort(best)[:rank] * (1.0 + 5.0 / max(n - size, 1))
    inliers = _inliers(best, np.concatenate([nearest, np.full(n - rank, nearest[-1])]), 0, stated)
    return inliers if inliers.sum() >= FEWEST else np.ones(n, bool)


@lru_cache(maxsize=16)
def _even_sets(n: int, size: int, count: int) -> NDArray[np.int64]:
    """Sets (m, size) of different numbers below n, evenly spread by the additive recurrence of Roberts (2018)."""
    root = 2.0
    for _ in range(40):  # the root above 1 of x^(size + 1) = x + 1
        root = (1.0 + root) ** (1.0 / (size + 1))
    step = root ** -np.arange(1.0, size + 1)
    sets = np.floor(((0.5 + np.arange(1, count + 1)[:, None] * step) % 1.0) * n).astype(np.int64)
    return sets[(np.diff(np.sort(sets, axis=1), axis=1) > 0).all(axis=1)]


def _checked(points: ArrayLike, sigma: ArrayLike | None) -> tuple[FloatArray, FloatArray, bool]:
    point = np.asarray(points, np.float64)
    if point.ndim != 2 or point.shape[1] != 2 or len(point) < FEWEST:
        raise DomainError(f"edge points of shape {point.shape}; at least {FEWEST} points (n, 2) are needed for the fit")
    error = np.broadcast_to(np.asarray(1.0 if sigma is None else sigma, np.float64), (len(point),))
    if not (np.all(np.isfinite(point)) and np.all(np.isfinite(error))):
        raise DomainError("an edge point or its sigma is not finite; drop such points before the fit")
    if not np.all(error > 0):
        raise DomainError(f"sigma of an edge point is {error.min():g}; it must be positive")
    return point, error, sigma is not None


def _taubin(point: FloatArray) -> FloatArray:
    """Algebraic circle (x, y, r), Taubin's by singular values (Chernov 2010)."""
    middle = point.mean(0)
    x, y = (point - middle).T
    z = x**2 + y**2
    scale = z.mean()
    if scale <= 0:
        raise DomainError("all edge points coincide; a circle cannot be fitted")
    _, singular, vt = np.linalg.svd(np.column_stack([(z - scale) / (2 * np.sqrt(scale)), x, y]), full_matrices=False)
    if singular[-2] < 1e-9 * singular[0]:
        raise DomainError("the edge points lie on a line; a circle cannot be fitted")
    first = vt[-1, 0] / (2 * np.sqrt(scale))
    if abs(first) < 1e-12 / np.sqrt(scale):
        raise DomainError("the edge points lie on a line; a circle cannot be fitted")
    constant = -scale * first
    centre = -vt[-1, 1:] / (2 * first)
    radius = np.sqrt(vt[-1, 1] ** 2 + vt[-1, 2] ** 2 - 4 * first * constant) / (2 * abs(first))
    return np.array([*(centre + middle), radius])


def _distance(point: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distances (n,) outwards and their derivatives (n, 3)."""
    offset = point - value[:2]
    length = np.maximum(np.hypot(*offset.T), 1e-300)
    outward = offset / length[:, None]
    return length - value[2], np.column_stack([-outward, -np.ones(len(point))])


def _least_squares(point: FloatArray, error: FloatArray, start: FloatArray) -> tuple[FloatArray, bool]:
    """Circle of the least weighted distances, and whether the iteration converged."""
    fit = least_squares(
        lambda value: _distance(point, value)[0] / error,
        start,
        jac=lambda value: _distance(point, value)[1] / error[:, None],
        method="lm",
        x_scale="jac",
        ftol=1e-14,
        xtol=1e-12,
        gtol=1e-14,
        max_nfev=STEPS,
    )
    return fit.x, fit.success


def _inliers(distance: FloatArray, sample: FloatArray, fitted: int, stated: bool) -> NDArray[np.bool_]:
    """Distances [sigma] within a limit by the median of a sample of them, less the number of fitted parameters."""
    freedom = len(sample) / max(len(sample) - fitted, 1)
    scatter = float(np.median(sample)) / 0.6745 * np.sqrt(freedom)  # median absolute deviation of a normal
    limit = CLIP_SIGMA * (max(scatter, 1.0) if stated else scatter)
    return np.asarray(distance <= max(limit, 1e-12))


def _judged(
    point: FloatArray,
    error: FloatArray,
    value: FloatArray,
    used: NDArray[np.bool_],
    converged: bool,
    stated: bool,
) -> dict[str, Any]:
    """Covariance, statistics and status of a fit, by field name."""
    distance, jacobian = _distance(point[used], value)
    residual = distance / error[used]
    freedom = len(residual) - len(value)
    sum2 = float(residual @ residual)
    variance = sum2 / max(freedom, 1)
    # an estimated scatter follows Student's law: two sigmas contain 95 %
    student = (float(stdtrit(max(freedom, 1), 0.975)) / 1.959964) ** 2
    factor = max(variance, 1.0) if stated else variance * student
    estimate = covariance_of_jacobian(jacobian / error[used][:, None], ("x", "y", "radius"), factor=factor)
    covariance, undetermined = estimate.covariance, estimate.message
    radius, sigma = float(abs(value[2])), float(np.sqrt(covariance[2, 2]))
    if not radius > CURVED_SIGMA * sigma and sum2 > 0:
        covariance = np.diag(np.full(len(value), np.inf))
        line = f"the points cannot be told from a line: radius {radius:.3g} +- {sigma:.2g}"
        undetermined = joined(line, undetermined)
    outliers = np.count_nonzero(~used)
    misfit = ChiSquare(value=sum2, degrees_of_freedom=max(freedom, 0) if stated else 0)
    too_many = outliers > LARGEST_WRONG_PART * len(used)
    status = "converged" if converged else "iteration_limit"
    if undetermined or too_many or misfit.ratio > LARGEST_RATIO:
        status = "singular" if undetermined else "refused"
    return {
        "covariance": covariance,
        "rms": float(np.sqrt(np.mean(distance**2))),
        "misfit": misfit,
        "used": used,
        "status": status,
        "message": joined(
            undetermined,
            "" if converged else f"not converged after {STEPS} steps",
            f"{outliers} of {len(used)} points do not lie on the circle" if outliers else "",
            f"more than {100 * LARGEST_WRONG_PART:g} % of them" if too_many else "",
            misfit.note,
        ),
    }


def _circles(sets: FloatArray) -> FloatArray:
    """Circles (m, 3) through triples of points (m, 3, 2); not finite where they lie on a line."""
    (bx, by), (cx, cy) = (np.moveaxis(sets[:, i] - sets[:, 0], -1, 0) for i in (1, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        across = 2.0 * (bx * cy - by * cx)
        x = (cy * (bx**2 + by**2) - by * (cx**2 + cy**2)) / across
        y = (bx * (cx**2 + cy**2) - cx * (bx**2 + by**2)) / across
    return np.column_stack([x + sets[:, 0, 0], y + sets[:, 0, 1], np.hypot(x, y)])


def _distances(value: FloatArray, point: FloatArray) -> FloatArray:
    """Distances (m, n) of all points from all circles; infinite for circles that are not finite."""
    x, y, radius = (column[:, None] for column in value.T)
    with np.errstate(invalid="ignore"):
        distance = np.abs(np.sqrt((point[:, 0] - x) ** 2 + (point[:, 1] - y) ** 2) - radius)
    return np.where(np.isfinite(value).all(axis=1, keepdims=True), distance, np.inf)
