"""Reduction of a grid target (ACC18 eq. 17-30): residuals, their polynomial, and what the three printed numbers mean.

    d        = mean centroid - target coordinate                                   (eq. 19-20)
    sigma_d  = standard deviation of d over the points                             (eq. 21-24)
    D        = d - cubic polynomial fitted to d                                    (eq. 25-26)
    sigma_D  = standard deviation of D: what is *left*                             (eq. 27-28)
    sigma_C1 = sqrt(sigma_d^2 - sigma_D^2): the size of what the polynomial *removed*  (eq. 29-30)

A target coordinate has to be in pixels before anything can be subtracted from it, and the document does not say how
(scale, roll, shift). Three ways are offered, each a set of terms linear in its coefficients:

``nominal``
    Through an ideal lens of the design focal length, no roll: d holds focal length, roll and pointing errors.
``aligned``
    Shift, roll and scale fitted: d holds distortion.
``calibrated``
    Shift, roll, scale and the radial and tangential terms of Brown and Conrady (ACF17 eq. 4), fitted in an earlier
    session: d is the residual of a distortion calibration, which is what the document's heading says.

The cubic polynomial contains shift, roll and scale, so sigma_D is the same for the first two (to the order of products
of small quantities); sigma_d and with it sigma_C1 are not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = [
    "LABELS",
    "REFERENCES",
    "DistortionStatistics",
    "Reference",
    "camera_terms",
    "distortion_statistics",
    "fit_camera",
    "polynomial_fit",
    "polynomial_terms",
    "without_pointing",
]

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
            f"{len(place)} points do not determine a polynomial of order {order} ({terms.shape[1]} terms per axis) and "
            "leave anything to judge it by; take more points or a lower order"
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


def without_pointing(place: FloatArray, error_px: FloatArray) -> FloatArray:
    """Map errors (n, 2) without the shift and roll that an attitude would take up (least squares)."""
    terms = camera_terms(place, "aligned")[:, :, [0, 1, 3]].reshape(-1, 3)
    flat = error_px.reshape(-1)
    return np.asarray((flat - terms @ np.linalg.lstsq(terms, flat, rcond=None)[0]).reshape(-1, 2))
