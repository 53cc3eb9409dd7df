"""Line-of-sight error of a calibrated camera: the map error, and its prediction from the covariance.

A camera and its attitude can be rotated against one another without moving any star; parameters that differ by such a
rotation are equivalent. The map is therefore compared with the truth t_i (unit vectors of the same pixels) after the
best rotation (Kabsch 1976, Acta Crystallographica A32, 922): with d_i the model's directions,

    R = argmin sum |R d_i - t_i|^2,   e_i = R d_i - t_i.

The same rotation is removed from the prediction. Parameter errors dtheta with covariance C move the directions by J_i
dtheta (J_i perpendicular to d_i); the small rotation w that fits these movements best, w x d_i = -[d_i] w, is

    w = M^-1 sum [d_i] J_i dtheta,   M = sum of (1 - d_i d_i^T),   [d] v = d x v,

and K_i dtheta remains, with K_i = J_i + [d_i] M^-1 sum [d_j] J_j. The predicted covariance of e_i is K_i C K_i^T.
Combinations of parameters that act as a rotation cancel in both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.special import gammaincinv

from calib.cameras.base import CameraModel, checked_vectors, unproject_jacobian
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all
from optics.units import RAD_ARCSEC


@dataclass(frozen=True, slots=True, kw_only=True)
class LineOfSightMap:
    """Errors of the directions of pixels, the best rotation removed."""

    pixel_px: FloatArray  # (n, 2) Pixels, (column, row)
    # (n, 2) Model minus truth, towards increasing column and increasing row, as angles on the sky; NaN where the
    # model has no direction
    error_arcsec: FloatArray
    # (n, 2) Standard deviations of the same from the covariance of the parameters; NaN without a covariance, infinite
    # if it is not finite
    predicted_sigma_arcsec: FloatArray
    # (p,) Eigenvalues of the predicted covariance of all errors, over n [arcsec^2]: ``rms_arcsec**2`` is the sum of
    # their products with squares of independent standard normal deviates; as the standard deviations without it
    mean_square_arcsec2: FloatArray
    # The rotation that was removed: applied to the model's directions, it brings them closest to the truth
    rotation: Rotation

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "pixel_px", shape=("n", 2), sizes=sizes)
        freeze_all(
            self,
            error_arcsec=("n", 2),
            predicted_sigma_arcsec=("n", 2),
            mean_square_arcsec2=("p",),
            sizes=sizes,
            finite=False,
        )

    @property
    def rms_arcsec(self) -> float:
        """Root mean square length of the error, both axes together; NaN if a pixel has no direction."""
        return float(np.sqrt(np.mean(np.sum(self.error_arcsec**2, axis=1))))

    @property
    def error_length_arcsec(self) -> FloatArray:
        """Lengths (n,) of the errors."""
        return np.asarray(np.linalg.norm(self.error_arcsec, axis=1))

    @property
    def predicted_length_arcsec(self) -> FloatArray:
        """Root mean square lengths (n,) that the covariance predicts."""
        return np.asarray(np.linalg.norm(self.predicted_sigma_arcsec, axis=1))

    @property
    def predicted_rms_arcsec(self) -> float:
        """Root of the expected mean square length of the error; compare with `rms_arcsec`."""
        return float(np.sqrt(np.mean(np.sum(self.predicted_sigma_arcsec**2, axis=1))))

    @property
    def predicted_rms_spread_arcsec(self) -> float:
        """Standard deviation of `rms_arcsec` around its prediction, to first order."""
        mean = self.predicted_rms_arcsec
        return float(np.sqrt(2.0 * (self.mean_square_arcsec2**2).sum()) / (2.0 * mean)) if mean > 0 else np.nan

    def rms_limit_arcsec(self, probability: float) -> float:
        """Value that `rms_arcsec` stays below with a probability, if the covariance is right and errors are normal.

        A weighted sum of chi-squares, by a chi-square with the same first three cumulants (Hall-Buckley-Eagleson;
        Buckley and Eagleson 1988, Australian Journal of Statistics 30A, 150).
        """
        first, second, third = (float((self.mean_square_arcsec2**power).sum()) for power in (1, 2, 3))
        if not np.isfinite(third) or third == 0.0:
            return third
        freedom = second**3 / third**2
        deviate = (2.0 * gammaincinv(freedom / 2.0, probability) - freedom) / np.sqrt(2.0 * freedom)
        return float(np.sqrt(first + np.sqrt(2.0 * second) * deviate))


def best_rotation(direction: ArrayLike, reference: ArrayLike) -> Rotation:
    """Rotation that brings unit vectors (n, 3) closest to others in the sense of least squares."""
    a, b = checked_vectors(direction, 3, "direction"), checked_vectors(reference, 3, "reference direction")
    if len(a) != len(b) or len(a) < 2:
        raise DomainError(
            f"{len(a)} directions and {len(b)} references; two or more pairs are needed to fit a rotation"
        )
    u, _, vt = np.linalg.svd(b.T @ a)
    u[:, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    return Rotation.from_matrix(u @ vt)


def line_of_sight_map(
    model: CameraModel,
    reference_direction: ArrayLike,
    pixel_px: ArrayLike,
    *,
    covariance: ArrayLike | None = None,
    band: ArrayLike | None = None,
) -> LineOfSightMap:
    """Compare the directions of a calibrated camera with true ones, the best rotation removed.

    Parameters
    ----------
    model : CameraModel
        The calibrated camera.
    reference_direction : (n, 3)
        True unit vectors of the pixels, in cam or in any frame turned against it.
    pixel_px : (n, 2)
        Pixels, (column, row); they also say over what the rotation is fitted and the means are taken, so spread them
        evenly over the detector (`SensorGeometry.grid_px`).
    covariance : (p, p), optional
        Covariance of ``model.parameters``, e.g. ``Calibration.covariance``.
    band : int or (n,) int, optional
        Bands, for models that know them.

    Returns
    -------
    LineOfSightMap
        Errors and predicted standard deviations.

    Raises
    ------
    DomainError
        On reference directions that are not unit vectors, wrong shapes, values that are not finite, fewer than two
        pixels to which the model gives a direction.
    """
    pixel = checked_vectors(pixel_px, 2, "pixel_px")
    truth = checked_vectors(reference_direction, 3, "reference_direction")
    if len(truth) != len(pixel):
        raise DomainError(f"{len(truth)} reference directions for {len(pixel)} pixels; one per pixel is needed")
    length = np.linalg.norm(truth, axis=1)
    if np.any(np.abs(length - 1.0) > 1e-9):
        raise DomainError(f"reference_direction: row {np.argmax(np.abs(length - 1.0))} is not a unit vector")
    if covariance is None:
        direction, jacobian = model.unproject(pixel, band), None
    else:
        direction, _, jacobian = unproject_jacobian(model, pixel, band)
    finite = np.asarray(np.isfinite(direction).all(axis=1))
    rotation = best_rotation(direction[finite], truth[finite])
    # taken in cam, at the model's directions, so that the frame of the truth does not matter
    axes = _tangent_axes(direction)
    error = np.einsum("nai,ni->na", axes, direction - truth @ rotation.as_matrix())
    sigma, weights = np.full(pixel.shape, np.nan), np.full(1, np.nan)
    if covariance is not None and jacobian is not None:
        sigma[finite], weights = _predicted(direction[finite], axes[finite], jacobian[finite], covariance)
    return LineOfSightMap(
        pixel_px=pixel,
        error_arcsec=error * RAD_ARCSEC,
        predicted_sigma_arcsec=sigma * RAD_ARCSEC,
        mean_square_arcsec2=weights * RAD_ARCSEC**2,
        rotation=rotation,
    )


def _tangent_axes(direction: FloatArray) -> FloatArray:
    """Unit vectors (n, 2, 3) perpendicular to directions: towards +X as far as possible, and Z cross that."""
    along = np.array([1.0, 0.0, 0.0]) - direction * direction[:, :1]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack([along, np.cross(direction, along)], axis=1)


def _predicted(
    direction: FloatArray, axes: FloatArray, jacobian: FloatArray, covariance: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Standard deviations [rad] (n, 2) along the axes and weights [rad^2] (p,) of the mean square, the fitted rotation
    removed.
    """
    spread = np.asarray(covariance, dtype=np.float64)
    count = jacobian.shape[2]
    if spread.shape != (count, count):
        raise DomainError(f"covariance of shape {spread.shape} for a camera with {count} parameters")
    if not np.all(np.isfinite(spread)):
        return np.full((len(direction), 2), np.inf), np.full(count, np.inf)
    along = _without_rotation(direction, axes, jacobian)
    variance = np.einsum("nap,pq,naq->na", along, spread, along, optimize=True)
    square = np.einsum("nap,naq->pq", along, along) / len(direction)
    weights = np.linalg.eigvals(
        square @ spread
    ).real  # of a product of two positive semidefinite matrices: none below 0
    return np.sqrt(np.maximum(variance, 0.0)), np.maximum(weights, 0.0)


def _without_rotation(direction: FloatArray, axes: FloatArray, jacobian: FloatArray) -> FloatArray:
    """Derivatives (n, 2, p) along the axes by the parameters, the rotation that fits them best removed."""
    turning = np.cross(direction[:, :, None], jacobian, axis=1)
    moment = len(direction) * np.eye(3) - direction.T @ direction
    rotation = np.linalg.solve(moment, turning.sum(axis=0))
    remaining = jacobian + np.cross(direction[:, :, None], rotation[None, :, :], axis=1)
    return np.einsum("nai,nip->nap", axes, remaining)


def mean_square_matrix(model: CameraModel, pixel_px: ArrayLike) -> FloatArray:
    """Matrix (p, p) of the mean square error over pixels [arcsec^2]: ``e @ matrix @ e`` for errors e of the parameters.

    The length of the error after the best rotation, to first order; pixels (n, 2) as of `line_of_sight_map`.
    """
    direction, _, jacobian = unproject_jacobian(model, checked_vectors(pixel_px, 2, "pixel_px"))
    along = _without_rotation(direction, _tangent_axes(direction), jacobian) * RAD_ARCSEC
    return np.asarray(np.einsum("nap,naq->pq", along, along) / len(direction))


def expected_rms(matrix: FloatArray, covariance: FloatArray) -> float:
    """Root of the expected mean square for parameters of that covariance (at least (p, p)), by `mean_square_matrix`."""
    count = len(matrix)
    return float(np.sqrt(np.trace(matrix @ covariance[:count, :count])))


def drawn_rms(
    matrix: FloatArray, better: FloatArray, worse: FloatArray, count: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """RMS errors (count,) of an efficient estimate and of a worse one from the same data, for drawn parameter errors.

    ``matrix`` is that of `mean_square_matrix`, the others are covariances (p, p). The additional error of the worse
    estimate is independent of the error of the efficient one (otherwise their mean would be better still).
    """
    scale = np.sqrt(np.diag(worse))
    errors = []
    for covariance in (better, worse - better):
        size, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
        root = scale[:, None] * axes * np.sqrt(np.maximum(size, 0.0))
        errors.append(rng.standard_normal((count, len(scale))) @ root.T)
    first, second = (np.einsum("dp,pq,dq->d", error, matrix, error) for error in (errors[0], errors[0] + errors[1]))
    return np.sqrt(first), np.sqrt(second)
