"""Circle and ellipse through edge points: orthogonal distances, weights, outliers, covariance.

The sum of squared orthogonal distances is what is made smallest (Gander, Golub & Strebel 1994, BIT 34, 558), by
Gauss-Newton from an algebraic start: Taubin's circle fit (1991, IEEE PAMI 13, 1115) in the form of Chernov (2010,
*Circular and Linear Regression*, sec. 5.9), and scikit-image's direct ellipse fit (Halir & Flusser 1998). Distances to
an ellipse come from its foot points, found by Newton's method on the angle.

The covariance of the parameters is ``(J^T W J)^-1`` with the stated errors of the points, scaled up by the reduced
chi-square where the points scatter more than they say.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.records import freeze

__all__ = ["CircleFit", "CurveFit", "EllipseFit", "fit_circle", "fit_ellipse"]


DistanceTo = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Signed distances (n,) of points (n, 2) from a curve of given parameters (k,), and their derivatives (n, k)."""

STEPS = 50
CLIP_SIGMA = 4.0
CLIP_ROUNDS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveFit:
    """What every fit of a closed curve tells.

    Attributes
    ----------
    centre : (2,)
        Its centre, in the unit of the points.
    covariance : (k, k)
        Of the parameters.
    rms : float
        Of the orthogonal distances of the points used.
    chi2 : float
        Weighted squared distances per degree of freedom; NaN without stated errors.
    used : (n,) bool
        Points that were not rejected.
    """

    centre: FloatArray
    covariance: FloatArray
    rms: float
    chi2: float
    used: NDArray[np.bool_]

    def __post_init__(self) -> None:
        freeze(self, "centre", shape=(2,))
        freeze(self, "covariance", shape=("k", "k"), sizes={})
        freeze(self, "used", shape=("n",), dtype=np.bool_)

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations of the parameters, in the order of the covariance."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, slots=True, kw_only=True)
class CircleFit(CurveFit):
    """A circle; parameters x, y, radius, and the attributes of `CurveFit`.

    Attributes
    ----------
    radius : float
        Its radius.
    """

    radius: float


@dataclass(frozen=True, slots=True, kw_only=True)
class EllipseFit(CurveFit):
    """An ellipse; parameters x, y, a, b, angle, and the attributes of `CurveFit`.

    Of a circle the angle means nothing and its variance is huge.

    Attributes
    ----------
    semi_axes : (2,)
        The longer and the shorter half axis, a and b.
    angle_rad : float
        Direction of the longer one from +x towards +y, -pi/2 to pi/2.
    """

    semi_axes: FloatArray
    angle_rad: float

    def __post_init__(self) -> None:
        CurveFit.__post_init__(self)
        freeze(self, "semi_axes", shape=(2,))


def fit_circle(points: ArrayLike, *, sigma: ArrayLike | None = None, clip_sigma: float = CLIP_SIGMA) -> CircleFit:
    """Circle of least squared orthogonal distance.

    Parameters
    ----------
    points : (n, 2)
        Edge points, at least 4.
    sigma : (n,) or float, optional
        Standard deviation of each point across the edge; without it the scatter tells.
    clip_sigma : float
        Points farther off than this many standard deviations (of the median scatter, if that is larger than stated) are
        rejected; infinity keeps all.

    Returns
    -------
    CircleFit

    Raises
    ------
    DomainError
        Too few points, values that are not finite, a sigma that is not positive, points on a line.
    ConvergenceError
        The iteration did not settle.
    """
    (x, y, radius), fit = _robust_fit(points, sigma, clip_sigma, start=_taubin, distance_to=_circle_distance, least=4)
    return CircleFit(centre=np.array([x, y]), radius=float(radius), **fit)


def fit_ellipse(points: ArrayLike, *, sigma: ArrayLike | None = None, clip_sigma: float = CLIP_SIGMA) -> EllipseFit:
    """Ellipse of least squared orthogonal distance.

    Parameters
    ----------
    points : (n, 2)
        Edge points, at least 6, that show more than a short arc.
    sigma, clip_sigma
        As in `fit_circle`.

    Returns
    -------
    EllipseFit

    Raises
    ------
    DomainError, ConvergenceError
        As `fit_circle`.
    """
    value, fit = _robust_fit(points, sigma, clip_sigma, start=_direct_ellipse, distance_to=_ellipse_distance, least=6)
    x, y, a, b, angle = value
    if b > a:
        a, b, angle = b, a, angle + np.pi / 2
        swapped = [0, 1, 3, 2, 4]  # x, y, the other half axis, this one, angle
        fit["covariance"] = fit["covariance"][np.ix_(swapped, swapped)]
    return EllipseFit(
        centre=np.array([x, y]),
        semi_axes=np.array([a, b]),
        angle_rad=float((angle + np.pi / 2) % np.pi - np.pi / 2),
        **fit,
    )


def _robust_fit(
    points: ArrayLike,
    sigma: ArrayLike | None,
    clip_sigma: float,
    *,
    start: Callable[[FloatArray], FloatArray],
    distance_to: DistanceTo,
    least: int,
) -> tuple[FloatArray, dict[str, Any]]:
    """Parameters of a curve, points far off it rejected; covariance, rms, chi2 and the points used, by field name."""
    point, error, stated = _checked(points, sigma, least=least)
    used = np.ones(len(point), bool)
    for _ in range(CLIP_ROUNDS):
        value = _gauss_newton(point[used], error[used], start(point[used]), distance_to)
        distance, _ = distance_to(point, value)
        kept = _inliers(distance, error, used, clip_sigma, stated)
        if np.array_equal(kept, used) or kept.sum() < least:
            break
        used = kept
    covariance, rms, chi2 = _quality(point[used], error[used], value, distance_to, stated)
    return value, {"covariance": covariance, "rms": rms, "chi2": chi2, "used": used}


def _checked(points: ArrayLike, sigma: ArrayLike | None, *, least: int) -> tuple[FloatArray, FloatArray, bool]:
    point = np.asarray(points, np.float64)
    if point.ndim != 2 or point.shape[1] != 2 or len(point) < least:
        raise DomainError(f"edge points of shape {point.shape}; at least {least} points (n, 2) are needed for the fit")
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


def _direct_ellipse(point: FloatArray) -> FloatArray:
    from skimage.measure import EllipseModel

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = EllipseModel.from_estimate(point) if hasattr(EllipseModel, "from_estimate") else None
    if not model:
        circle = _taubin(point)
        return np.array([*circle[:2], circle[2] * 1.001, circle[2] * 0.999, 0.0])
    return np.array([*model.center, *model.axis_lengths, model.theta], dtype=float)


def _circle_distance(point: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distances (n,) outwards and their derivatives (n, 3)."""
    away = point - value[:2]
    length = np.maximum(np.hypot(*away.T), 1e-300)
    outward = away / length[:, None]
    return length - value[2], np.column_stack([-outward, -np.ones(len(point))])


def _ellipse_distance(point: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distances (n,) outwards from the foot points and their derivatives (n, 5)."""
    x, y, a, b, angle = value
    cosine, sine = np.cos(angle), np.sin(angle)
    u = cosine * (point[:, 0] - x) + sine * (point[:, 1] - y)
    v = -sine * (point[:, 0] - x) + cosine * (point[:, 1] - y)
    t = np.arctan2(v * a, u * b)
    for _ in range(25):  # foot point: (b^2 - a^2) cos t sin t + a u sin t - b v cos t = 0
        c, s = np.cos(t), np.sin(t)
        function = (b * b - a * a) * c * s + a * u * s - b * v * c
        slope = (b * b - a * a) * (c * c - s * s) + a * u * c + b * v * s
        step = np.where(np.abs(slope) > 1e-12, function / np.where(np.abs(slope) > 1e-12, slope, 1.0), 0.0)
        t = t - np.clip(step, -0.5, 0.5)
        if np.max(np.abs(step)) < 1e-14:
            break
    c, s = np.cos(t), np.sin(t)
    normal = np.column_stack([b * c, a * s])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    distance = normal[:, 0] * (u - a * c) + normal[:, 1] * (v - b * s)
    # d(distance) = -n . d(foot point) at fixed foot parameter; the point itself turns with the frame
    by_angle = normal[:, 0] * v - normal[:, 1] * u
    jacobian = np.column_stack(
        [
            -(normal[:, 0] * cosine - normal[:, 1] * sine),
            -(normal[:, 0] * sine + normal[:, 1] * cosine),
            -normal[:, 0] * c,
            -normal[:, 1] * s,
            by_angle,
        ]
    )
    return distance, jacobian


def _gauss_newton(point: FloatArray, error: FloatArray, start: FloatArray, distance_to: DistanceTo) -> FloatArray:
    """Levenberg's damped iteration on the weighted distances."""
    value, damping = start.copy(), 1e-6
    distance, jacobian = distance_to(point, value)
    cost = float(np.sum((distance / error) ** 2))
    size = max(float(np.ptp(point)), 1e-300)
    for _ in range(STEPS):
        weighted = jacobian / error[:, None]
        normal = weighted.T @ weighted
        gradient = weighted.T @ (distance / error)
        lifted = normal + damping * np.diag(np.maximum(np.diag(normal), 1e-12 * np.trace(normal)))
        step = -np.linalg.lstsq(lifted, gradient, rcond=None)[0]
        trial = value + step
        new_distance, new_jacobian = distance_to(point, trial)
        new_cost = float(np.sum((new_distance / error) ** 2))
        if new_cost <= cost * (1 + 1e-12):
            value, distance, jacobian = trial, new_distance, new_jacobian
            damping = max(damping / 10, 1e-12)
            if np.max(np.abs(step[:3])) < 1e-11 * size or cost - new_cost <= 1e-14 * cost:
                return value
            cost = new_cost
        else:
            damping *= 10
            if damping > 1e8:
                return value
    raise ConvergenceError(
        f"the fit of a curve to {len(point)} edge points did not settle in {STEPS} steps; do the points lie on one "
        "curve?"
    )


def _inliers(
    distance: FloatArray, error: FloatArray, used: NDArray[np.bool_], clip_sigma: float, stated: bool
) -> NDArray[np.bool_]:
    pull = np.abs(distance / error)
    scatter = float(np.median(pull[used])) / 0.6745  # median absolute deviation of a normal
    limit = clip_sigma * (max(scatter, 1.0) if stated else scatter)
    return np.asarray(pull <= max(limit, 1e-12))


def _quality(
    point: FloatArray, error: FloatArray, value: FloatArray, distance_to: DistanceTo, stated: bool
) -> tuple[FloatArray, float, float]:
    """Covariance, RMS distance and chi-square per degree of freedom."""
    distance, jacobian = distance_to(point, value)
    weighted = jacobian / error[:, None]
    freedom = max(len(point) - len(value), 1)
    chi2 = float(np.sum((distance / error) ** 2)) / freedom
    covariance = np.linalg.pinv(weighted.T @ weighted) * (max(chi2, 1.0) if stated else chi2)
    return np.asarray(covariance), float(np.sqrt(np.mean(distance**2))), chi2 if stated else float("nan")
