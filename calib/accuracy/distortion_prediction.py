"""Distortion error predicted without frames: expected numbers of ACC18 eq. 21-30, and expected error of the map.

The squares of the numbers are quadratic forms of centroids and coordinates. With H the projector onto the polynomials
and J that onto constants, residuals d at W points have

    (W - 1) sigma_d^2 = |(1 - J) d|^2,    (W - 1) sigma_D^2 = |(1 - H) d|^2,    (W - 1) sigma_C1^2 = |(H - J) d|^2,

and with P the projector onto the terms of the camera behind the coordinates, s and t the errors of the earlier and of
the test session, c their common error (response pattern), m the marking error and u the deterministic part (distortion,
S-curve),

    d = (1 - P) (u + c - m) + t - P s   (camera of an earlier session),    d = (1 - P) (u + c + t - m)   (of the same).

Mean and variance of |Q d|^2 for normal d = u + noise of covariance C are u'Qu + tr(QC) and 2 tr(QCQC) + 4 u'QCQu.
Nothing is drawn, and no code of the reduction (`calib.accuracy.distortion`) takes part: projectors are made by QR of
other bases of the same polynomials.

Map error over the field: with F and F' the camera terms at target points and field points, B and B' the polynomial
terms there, + the pseudo-inverse, offsets u of the points give the map

    B' B+ u + (F' - B' B+ F) F+ u;

the same operator, applied to an error of the points, gives the error of the map. A polynomial that contains the camera
terms leaves nothing of the second term.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from calib.accuracy.distortion import Reference
from optics.arrays import FloatArray
from optics.field_map import polynomial_basis


@dataclass(frozen=True, slots=True, kw_only=True)
class GridErrors:
    """Errors in the residuals of n points [px]."""

    position: FloatArray  # (n, 2) Points from the middle of the detector, in units of order 1
    offset_px: FloatArray  # (n, 2) Mean centroids minus nominal coordinates, without noise: distortion and S-curve
    # (n, 2, 2) Covariance of the mean centroid of each point: fixed pattern of the chip, and noise of one session
    chip_px2: FloatArray
    session_px2: FloatArray
    mean_px2: FloatArray  # (n, 2, 2) Covariance with which ``offset_px`` is known; it is not that of the frames
    marking_px: float  # Standard deviation per axis of a surveyed coordinate


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedNumbers:
    """Expected values of sigma_d, sigma_D, sigma_C1 by axis, (3, 2) [px]."""

    rms_px: FloatArray  # Root mean square over chips, runs and surveys
    scatter_px: FloatArray  # Standard deviation of the number of one survey
    frozen_px: FloatArray  # Standard deviation of the RMS over infinitely many surveys of one chip and one run


def _camera_basis(position: FloatArray, reference: Reference) -> FloatArray:
    """Terms (2 n, k), x and y of point after point, of a camera model.

    With z = x + iy: shift 1 and i, scale z, roll iz; of Brown and Conrady |z|^2 z, |z|^4 z, z^2 + 2 |z|^2 and
    i (2 |z|^2 - z^2).
    """
    z = position[:, 0] + 1j * position[:, 1]
    r2 = np.abs(z) ** 2
    terms = [] if reference == "nominal" else [1.0 + 0.0 * z, 1j + 0.0 * z, z, 1j * z]
    if reference == "calibrated":
        terms += [z * r2, z * r2**2, z**2 + 2.0 * r2, 1j * (2.0 * r2 - z**2)]
    return np.array([np.column_stack([v.real, v.imag]).ravel() for v in terms]).reshape(len(terms), 2 * len(z)).T


def camera_projector(position: FloatArray, reference: Reference) -> FloatArray:
    """Projector (2 n, 2 n), x and y of point after point, onto the terms of a camera model."""
    basis = np.linalg.qr(_camera_basis(position, reference))[0]
    return np.asarray(basis @ basis.T)


def expected_numbers(errors: GridErrors, order: int, reference: Reference) -> ExpectedNumbers:
    """Numbers of `calib.accuracy.distortion.distortion_statistics` expected from the errors in the residuals."""
    points, identity = len(errors.position), np.eye(2 * len(errors.position))
    camera = identity - camera_projector(errors.position, reference)
    chip, session, uncertain_mean = (block_diag(*v) for v in (errors.chip_px2, errors.session_px2, errors.mean_px2))
    if reference == "calibrated":
        frames = camera @ chip @ camera + session + (identity - camera) @ session @ (identity - camera)
    else:
        frames = camera @ (chip + session) @ camera
    mean = camera @ errors.offset_px.reshape(-1)
    marked = errors.marking_px**2 * camera
    basis = np.linalg.qr(polynomial_basis(errors.position, order))[0]
    hat, constant = basis @ basis.T, np.full((points, points), 1.0 / points)
    out = np.empty((3, 3, 2))
    for axis in range(2):
        u, frozen, survey, uncertain = (v[axis::2] for v in (mean, frames, marked, camera @ uncertain_mean @ camera))
        frozen, survey, uncertain = (v[:, axis::2] for v in (frozen, survey, uncertain))
        for row, q in enumerate((np.eye(points) - constant, np.eye(points) - hat, hat - constant)):
            square = u @ q @ u + np.trace(q @ (frozen + survey - uncertain))  # u'Qu contains the noise of the mean
            of_survey = _variance(q, u, frozen + survey + uncertain)
            fixed = _variance(q, u, frozen + uncertain)
            root = np.sqrt(max(square, 0.0) / (points - 1))
            spread = np.array([of_survey, fixed]) / (4.0 * max(square, 1e-300) * (points - 1))
            out[:, row, axis] = root, *np.sqrt(spread)
    return ExpectedNumbers(rms_px=out[0], scatter_px=out[1], frozen_px=out[2])


def _variance(q: FloatArray, u: FloatArray, covariance: FloatArray) -> float:
    """Variance of the squared length of a normal vector of mean u and this covariance, projected by q."""
    inside = q @ covariance @ q
    return float(2.0 * (inside * inside.T).sum() + 4.0 * u @ inside @ u)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedMapError:
    """Error of camera and polynomial over the field, shift and roll taken out; RMS per axis [px]."""

    bias_px: FloatArray  # (2,) Distortion that camera and polynomial cannot follow
    noise_px: FloatArray  # (2,) Errors of the points carried into the map

    @property
    def rms_px(self) -> FloatArray:
        """Both together (2,)."""
        return np.hypot(self.bias_px, self.noise_px)


def expected_map_error(
    position: FloatArray,
    offset_px: FloatArray,
    field_position: FloatArray,
    field_offset_px: FloatArray,
    *,
    order: int,
    reference: Reference,
    point_error_px: float,
) -> ExpectedMapError:
    """Expected error of a map fitted to a grid target, over the field.

    The errors of the points are taken as the same in the sessions of camera and polynomial; ``point_error_px`` is the
    standard deviation per axis of the offset of a point, by centroid and marking.

    Shapes: ``position``, ``offset_px`` (n, 2), target points in units of order 1 and their distortion (true minus
    nominal pixels); ``field_position``, ``field_offset_px`` (m, 2), the same at points over the field.
    """
    polynomial, field_polynomial = (
        np.kron(polynomial_basis(at, order), np.eye(2)) for at in (position, field_position)
    )
    camera, field_camera = (_camera_basis(at, reference) for at in (position, field_position))
    of_polynomial, of_camera = (np.asarray(np.linalg.pinv(terms), np.float64) for terms in (polynomial, camera))
    carry = field_polynomial @ of_polynomial
    carry = carry + (field_camera - carry @ camera) @ of_camera
    pointing = _camera_basis(field_position, "aligned")[:, [0, 1, 3]]

    def absorbed(error: FloatArray) -> FloatArray:
        return np.asarray(error - pointing @ np.linalg.lstsq(pointing, error, rcond=None)[0])

    bias = absorbed(field_offset_px.ravel() - carry @ offset_px.ravel()).reshape(-1, 2)
    noise = absorbed(carry).reshape(len(field_position), 2, -1)
    return ExpectedMapError(
        bias_px=np.sqrt((bias**2).mean(0)),
        noise_px=point_error_px * np.sqrt((noise**2).sum(2).mean(0)),
    )
