"""Reduction of a grid target (ACC18 eq. 17-30): residuals, their polynomial, and the meaning of the three printed
numbers.

    d        = mean centroid - target coordinate                                   (eq. 19-20)
    sigma_d  = standard deviation of d over the points: *before*                   (eq. 21-24)
    D        = d - cubic polynomial fitted to d                                    (eq. 25-26)
    sigma_D  = standard deviation of D: *after*                                    (eq. 27-28)
    sigma_C1 = sqrt(sigma_d^2 - sigma_D^2): *removed* by the polynomial            (eq. 29-30)

A target coordinate has to be in pixels before anything can be subtracted from it, and the document does not state the
conversion (scale, roll, shift). Three conversions are offered, each a set of terms linear in its coefficients:

``nominal``
    Through an ideal lens of the design focal length, no roll: d contains focal length, roll and pointing errors.
``aligned``
    Shift, roll and scale fitted: d contains distortion.
``calibrated``
    Shift, roll, scale and the radial and tangential terms of Brown and Conrady (ACF17 eq. 4), fitted in an earlier
    session: d is the residual of a distortion calibration, as the document's heading states.

The cubic polynomial contains shift, roll and scale, so that sigma_D is the same for the first two (to the order of
products of small quantities), but sigma_d and sigma_C1 differ.

None of the three is the error of the map between the points. With H the projector onto camera terms and polynomials and
e the residuals, points b left out of the fit are off by ``(1 - H_bb)^-1 e_b`` (Cook and Weisberg 1982, Residuals and
Influence in Regression, sec. 2.2): b is a point, or the points of an inner row or column, without which a polynomial
may pass through all others and be arbitrary at b.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray
from optics.errors import DomainError

Reference = Literal["nominal", "aligned", "calibrated"]

REFERENCES: Mapping[Reference, str] = {
    "nominal": "ideal lens of the design focal length",
    "aligned": "shift, roll and scale fitted",
    "calibrated": "camera model from an earlier session",
}
LABELS = ("σδ, before", "σΔδ, after", "σC1, removed")
"""What readers call the three numbers: sigma_d, sigma_D, sigma_C1."""


def polynomial_terms(place: FloatArray, order: int) -> FloatArray:
    """Monomials x^a y^b, a + b <= order, at places (..., n, 2) of order 1: (..., n, k)."""
    x, y = place[..., 0], place[..., 1]
    return np.stack([x ** (d - b) * y**b for d in range(order + 1) for b in range(d + 1)], axis=-1)


def camera_terms(place: FloatArray, reference: Reference) -> FloatArray:
    """Terms of a camera at places (n, 2): (n, 2, k), pixels from places being linear in their coefficients.

    Shift (2), scale, roll; for "calibrated" also r^2, r^4 (radial) and the two tangential terms.
    """
    x, y = place[:, 0], place[:, 1]
    one, zero, r2 = np.ones_like(x), np.zeros_like(x), x**2 + y**2
    if reference == "nominal":
        return np.zeros((len(place), 2, 0))
    columns = [(one, zero), (zero, one), (x, y), (-y, x)]
    if reference == "calibrated":
        columns += [(x * r2, y * r2), (x * r2**2, y * r2**2)]
        columns += [(2 * x**2 + r2, 2 * x * y), (2 * x * y, 2 * y**2 + r2)]
    return np.stack([np.stack(column, axis=1) for column in columns], axis=2)


def fit_camera(place: FloatArray, offset_px: FloatArray, reference: Reference) -> FloatArray:
    """Coefficients (k,) that explain offsets (n, 2) [px] of measured from nominal pixels at places (n, 2)."""
    terms = camera_terms(place, reference)
    if not terms.shape[2]:
        return np.zeros(0)
    flat = terms.reshape(-1, terms.shape[2])
    if flat.shape[0] <= flat.shape[1]:
        raise DomainError(f"{len(place)} points do not determine a camera of {flat.shape[1]} terms; take more points")
    return np.asarray(np.linalg.lstsq(flat, offset_px.reshape(-1), rcond=None)[0])


def polynomial_fit(place: FloatArray, d_px: FloatArray, order: int) -> FloatArray:
    """Coefficients (k, 2) of the polynomial that fits residuals (n, 2) best."""
    terms = polynomial_terms(place, order)
    if len(place) <= terms.shape[1]:
        raise DomainError(
            f"{len(place)} points do not determine a polynomial of order {order} ({terms.shape[1]} terms per axis) "
            "with degrees of freedom left for a test; use more points or a lower order"
        )
    return np.asarray(np.linalg.lstsq(terms, d_px, rcond=None)[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class DistortionStatistics:
    """The document's numbers, 1 sigma, per axis [px]."""

    d_px: FloatArray  # (n, 2) Residuals, eq. 19-20
    left_px: FloatArray  # (n, 2) After the polynomial, eq. 25-26
    sigma_d_px: FloatArray  # (2,) Eq. 23-24, 27-28, 29-30: found, left, removed
    sigma_left_px: FloatArray  # (2,)
    sigma_c1_px: FloatArray  # (2,)
    coefficient_px: FloatArray  # (k, 2) Of the polynomial


def distortion_statistics(place: FloatArray, d_px: FloatArray, order: int) -> DistortionStatistics:
    """Eq. 21-30 on residuals."""
    coefficient = polynomial_fit(place, d_px, order)
    left = d_px - polynomial_terms(place, order) @ coefficient
    sigma_d, sigma_left = d_px.std(axis=0, ddof=1), left.std(axis=0, ddof=1)
    return DistortionStatistics(
        d_px=d_px,
        left_px=left,
        sigma_d_px=sigma_d,
        sigma_left_px=sigma_left,
        sigma_c1_px=np.sqrt(np.maximum(sigma_d**2 - sigma_left**2, 0.0)),
        coefficient_px=coefficient,
    )


DETERMINED = 1e-3
"""Variance of a residual in the fit over that of the point: below it the other points do not determine the place."""


def cross_validated(place: FloatArray, offset_px: FloatArray, order: int, reference: Reference) -> FloatArray:
    """Errors of fits at points left out (3, n, 2), camera and polynomial fitted together.

    First every point left out by itself; then with all points of its row, then of its column, but those of the
    outermost ones, beyond which there is nothing. NaN where the other points do not determine the place. Shapes:
    ``place`` (n, 2) in units of order 1, ``offset_px`` (n, 2) measured minus nominal.
    """
    count = len(place)
    polynomial = np.kron(polynomial_terms(place, order), np.eye(2))
    terms = np.hstack([polynomial, camera_terms(place, reference).reshape(2 * count, -1)])
    across, size, _ = np.linalg.svd(terms, full_matrices=False)
    base = across[:, size > 1e-9 * size[0]]
    left = offset_px.reshape(-1) - base @ (base.T @ offset_px.reshape(-1))
    found = np.full((3, 2 * count), np.nan)
    single = np.arange(count)
    for row, groups in enumerate((single, _strips(place[:, 1]), _strips(place[:, 0]))):
        ends = (groups.min(), groups.max()) if row else ()
        for group in range(groups.max() + 1):
            for points in [np.flatnonzero(groups == group)] if group not in ends else single[groups == group][:, None]:
                rows = (2 * points[:, None] + [0, 1]).ravel()
                share, way = np.linalg.eigh(np.eye(len(rows)) - base[rows] @ base[rows].T)
                if share[0] > DETERMINED:
                    found[row, rows] = way @ ((way.T @ left[rows]) / share)
    return found.reshape(3, count, 2)


def left_out(place: FloatArray, offset_px: FloatArray, order: int, reference: Reference) -> FloatArray:
    """RMS error (2, 2) per axis at points left out, and at rows or columns left out, the larger (`cross_validated`)."""
    rms = np.sqrt((cross_validated(place, offset_px, order, reference) ** 2).mean(1))
    return np.stack([rms[0], rms[1:].max(0)])


def _strips(coordinate: FloatArray) -> NDArray[np.int64]:
    """Number of the row that each point belongs to; strips of as many points where the target has no rows."""
    order = np.argsort(coordinate, kind="stable")
    gap = np.diff(coordinate[order])
    number = np.zeros(len(coordinate), np.int64)
    number[order[1:]] = np.cumsum(gap > 0.5 * gap.max())
    sizes = np.bincount(number)
    if len(sizes) < 3 or sizes.max() > 2 * sizes.min():
        number[order] = np.arange(len(order)) * round(np.sqrt(len(order))) // len(order)
    return number


def without_pointing(place: FloatArray, error_px: FloatArray) -> FloatArray:
    """Map errors (n, 2) without the shift and roll that an attitude would take up (least squares)."""
    terms = camera_terms(place, "aligned")[:, :, [0, 1, 3]].reshape(-1, 3)
    flat = error_px.reshape(-1)
    return np.asarray((flat - terms @ np.linalg.lstsq(terms, flat, rcond=None)[0]).reshape(-1, 2))
