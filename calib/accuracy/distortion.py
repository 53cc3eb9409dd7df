"""Distortion error from a grid target (ACC18 eq. 17-30): residuals, their polynomial, and the error of the map.

    d        = mean centroid - target coordinate                                   (eq. 19-20)
    sigma_d  = standard deviation of d over the points: *before*                   (eq. 21-24)
    D        = d - cubic polynomial fitted to d                                    (eq. 25-26)
    sigma_D  = standard deviation of D: *after*                                    (eq. 27-28)
    sigma_C1 = sqrt(sigma_d^2 - sigma_D^2): *removed* by the polynomial            (eq. 29-30)

A target coordinate has to be in pixels before anything can be subtracted from it, and the paper does not state the
conversion (scale, roll, shift). Three conversions are offered, each a set of terms linear in its coefficients:

``nominal``
    Through an ideal lens of the design focal length, no roll: d contains focal length, roll and pointing errors.
``aligned``
    Shift, roll and scale fitted: d contains distortion.
``calibrated``
    Shift, roll, scale and the radial and tangential terms of Brown and Conrady (ACF17 eq. 4), fitted in an earlier
    session: d is the residual of a distortion calibration, as the paper's heading states.

The cubic polynomial contains shift, roll and scale, so that sigma_D is the same for the first two (to the order of
products of small quantities), but sigma_d and sigma_C1 differ.

None of the three is the error of the map between the points. With H the projector onto camera terms and polynomials and
e the residuals, points b left out of the fit are off by ``(1 - H_bb)^-1 e_b`` (Cook and Weisberg 1982, Residuals and
Influence in Regression, sec. 2.2): b is a point, or the points of an inner row or column, without which a polynomial
may pass through all others and be arbitrary at b.

Positions are coordinates from the middle of the detector in units of order 1 (such as half its diagonal), so that the
fits are well conditioned.
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
"""Names of sigma_d, sigma_D, sigma_C1 for readers."""
HIGHEST_ORDER = 9
DETERMINED = 1e-3
"""Variance of a residual in the fit over that of the point; below it the other points do not determine the map."""


def polynomial_terms(position: FloatArray, order: int) -> FloatArray:
    """Monomials x^a y^b, a + b <= order, at positions (..., n, 2): (..., n, k)."""
    x, y = position[..., 0], position[..., 1]
    return np.stack([x ** (d - b) * y**b for d in range(order + 1) for b in range(d + 1)], axis=-1)


def camera_terms(position: FloatArray, reference: Reference) -> FloatArray:
    """Terms (n, 2, k) of a camera model at positions (n, 2), in whose coefficients pixels are linear.

    Shift (2), scale, roll; for "calibrated" also r^2, r^4 (radial) and the two tangential terms.
    """
    x, y = position[:, 0], position[:, 1]
    unit, zero, r2 = np.ones_like(x), np.zeros_like(x), x**2 + y**2
    if reference == "nominal":
        return np.zeros((len(position), 2, 0))
    columns = [(unit, zero), (zero, unit), (x, y), (-y, x)]
    if reference == "calibrated":
        columns += [(x * r2, y * r2), (x * r2**2, y * r2**2)]
        columns += [(2 * x**2 + r2, 2 * x * y), (2 * x * y, 2 * y**2 + r2)]
    return np.stack([np.stack(column, axis=1) for column in columns], axis=2)


def fit_camera_terms(position: FloatArray, offset_px: FloatArray, reference: Reference) -> FloatArray:
    """Coefficients (k,) of `camera_terms` for offsets (n, 2) [px] of measured from nominal pixels, least squares.

    `DomainError` on too few points.
    """
    terms = camera_terms(position, reference)
    if not terms.shape[2]:
        return np.zeros(0)
    design_matrix = terms.reshape(-1, terms.shape[2])
    if design_matrix.shape[0] <= design_matrix.shape[1]:
        raise DomainError(
            f"{len(position)} points do not determine a camera of {design_matrix.shape[1]} terms; take more points"
        )
    return np.asarray(np.linalg.lstsq(design_matrix, offset_px.reshape(-1), rcond=None)[0])


def grid_residual_px(
    nominal_px: FloatArray, position: FloatArray, earlier_px: FloatArray, test_px: FloatArray, reference: Reference
) -> tuple[FloatArray, FloatArray]:
    """Residuals of a grid target (ACC18 eq. 19-20).

    Parameters
    ----------
    nominal_px : (n, 2)
        Target coordinates through an ideal lens [px].
    position : (n, 2)
        The same in units of order 1.
    earlier_px, test_px : (n, 2)
        Mean centroids of the session that the camera of "calibrated" is fitted to, and of the test [px].
    reference : {"nominal", "aligned", "calibrated"}
        Conversion of target coordinates to pixels (`REFERENCES`).

    Returns
    -------
    d_px : (n, 2)
        Residuals [px].
    coefficient_px : (k,)
        Coefficients of the camera (`camera_terms`).
    """
    coefficient = fit_camera_terms(
        position, (earlier_px if reference == "calibrated" else test_px) - nominal_px, reference
    )
    return test_px - nominal_px - camera_terms(position, reference) @ coefficient, coefficient


@dataclass(frozen=True, slots=True, kw_only=True)
class DistortionStatistics:
    """Numbers of ACC18, 1 sigma, per axis [px]."""

    d_px: FloatArray  # (n, 2) Residuals before the polynomial, eq. 19-20
    residual_px: FloatArray  # (n, 2) After it, eq. 25-26
    sigma_px: FloatArray  # (3, 2) sigma_d (eq. 23-24), sigma_D (eq. 27-28), sigma_C1 (eq. 29-30)
    coefficient_px: FloatArray  # (k, 2) Of the polynomial (`polynomial_terms`)


def distortion_statistics(position: FloatArray, d_px: FloatArray, order: int) -> DistortionStatistics:
    """Standard deviations of residuals before and after a polynomial, and of the part it removes (ACC18 eq. 21-30).

    Parameters
    ----------
    position : (n, 2)
        Points in units of order 1.
    d_px : (n, 2)
        Residuals of `grid_residual_px` [px].
    order : int
        Total degree of the polynomial; 3 in the paper.

    Raises
    ------
    DomainError
        Fewer points than terms of the polynomial, plus one.
    """
    terms = polynomial_terms(position, order)
    if len(position) <= terms.shape[1]:
        raise DomainError(
            f"{len(position)} points do not determine a polynomial of order {order} ({terms.shape[1]} terms per axis) "
            "with degrees of freedom left for a test; use more points or a lower order"
        )
    coefficient = np.asarray(np.linalg.lstsq(terms, d_px, rcond=None)[0], np.float64)
    residual_px = d_px - terms @ coefficient
    before, after = d_px.std(axis=0, ddof=1), residual_px.std(axis=0, ddof=1)
    return DistortionStatistics(
        d_px=d_px,
        residual_px=residual_px,
        sigma_px=np.stack([before, after, np.sqrt(np.maximum(before**2 - after**2, 0.0))]),
        coefficient_px=coefficient,
    )


def deleted_residuals_px(position: FloatArray, offset_px: FloatArray, order: int, reference: Reference) -> FloatArray:
    """Errors of fits at points left out (3, n, 2), camera terms (`REFERENCES`) and polynomial fitted together.

    First every point left out alone; then with all points of its row, then of its column, except those of the outermost
    ones, beyond which no point is left. NaN where the other points do not determine the map.

    Shapes: ``position`` (n, 2) in units of order 1, ``offset_px`` (n, 2) measured minus nominal coordinates.
    """
    count = len(position)
    polynomial = np.kron(polynomial_terms(position, order), np.eye(2))
    design_matrix = np.hstack([polynomial, camera_terms(position, reference).reshape(2 * count, -1)])
    basis, singular_values, _ = np.linalg.svd(design_matrix, full_matrices=False)
    basis = basis[:, singular_values > 1e-9 * singular_values[0]]
    residual_px = offset_px.reshape(-1) - basis @ (basis.T @ offset_px.reshape(-1))
    deleted = np.full((3, 2 * count), np.nan)
    single = np.arange(count)
    for kind, groups in enumerate((single, grid_lines(position[:, 1]), grid_lines(position[:, 0]))):
        ends = (groups.min(), groups.max()) if kind else ()
        for group in range(groups.max() + 1):
            members = single[groups == group]
            for points in members[:, None] if group in ends else [members]:
                rows = (2 * points[:, None] + [0, 1]).ravel()
                variance, modes = np.linalg.eigh(np.eye(len(rows)) - basis[rows] @ basis[rows].T)
                if variance[0] > DETERMINED:
                    deleted[kind, rows] = modes @ ((modes.T @ residual_px[rows]) / variance)
    return deleted.reshape(3, count, 2)


def deleted_rms_px(position: FloatArray, offset_px: FloatArray, order: int, reference: Reference) -> FloatArray:
    """RMS (2, 2) per axis of `deleted_residuals_px`: points left out, and rows or columns left out, the larger."""
    rms = np.sqrt((deleted_residuals_px(position, offset_px, order, reference) ** 2).mean(1))
    return np.stack([rms[0], rms[1:].max(0)])


def grid_lines(coordinate: FloatArray) -> NDArray[np.int64]:
    """Number of the grid line that each point belongs to; strips of equal counts where the target has no lines."""
    order = np.argsort(coordinate, kind="stable")
    gap = np.diff(coordinate[order])
    number = np.zeros(len(coordinate), np.int64)
    number[order[1:]] = np.cumsum(gap > 0.5 * gap.max())
    sizes = np.bincount(number)
    if len(sizes) < 3 or sizes.max() > 2 * sizes.min():
        number[order] = np.arange(len(order)) * round(np.sqrt(len(order))) // len(order)
    return number


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderComparison:
    """Polynomials of several orders o for the same points, RMS over both axes [px]."""

    order: NDArray[np.int64]  # (o,) From 1
    residual_px: FloatArray  # (o,) Standard deviation after the fit
    point_px: FloatArray  # (o,) At points left out
    line_px: FloatArray  # (o,) At rows or columns left out, the larger; NaN where the others do not determine the map

    @property
    def error_px(self) -> FloatArray:
        """Larger of the errors at points and at rows or columns left out, (o,)."""
        return np.fmax(self.point_px, self.line_px)

    @property
    def tested_order(self) -> int:
        """Highest order that the other rows and columns determine where one is left out; 0 if none."""
        return int(self.order[np.isfinite(self.line_px)].max(initial=0))

    @property
    def best_order(self) -> int:
        """Order of the smallest error at points left out, of those that rows and columns test."""
        tested = np.isfinite(self.line_px)
        return int(self.order[np.argmin(np.where(tested | ~tested.any(), self.error_px, np.inf))])

    def over_best(self, order: int) -> float:
        """Error of an order over that of the best one."""
        return float(self.error_px[order - 1] / self.error_px[self.best_order - 1])


def compare_orders(
    position: FloatArray, offset_px: FloatArray, reference: Reference, *, highest: int = HIGHEST_ORDER
) -> OrderComparison:
    """Every order that the points determine, up to ``highest``; other arguments as of `deleted_residuals_px`."""
    rows = []
    for order in range(1, highest + 1):
        if len(position) <= (order + 1) * (order + 2) // 2:
            break
        point, line = deleted_rms_px(position, offset_px, order, reference)
        after = distortion_statistics(position, offset_px, order).sigma_px[1]
        rows.append([order, *(np.sqrt((axes**2).mean()) for axes in (after, point, line))])
    table = np.reshape(rows, (-1, 4)).T
    return OrderComparison(order=table[0].astype(np.int64), residual_px=table[1], point_px=table[2], line_px=table[3])


def misfit_ratio(residual_px: FloatArray, sigma_px: FloatArray, *, parameters: int) -> tuple[float, float]:
    """RMS of residuals over that of their standard deviations, with its own standard deviation.

    ``parameters`` are the fitted ones, which the degrees of freedom lack.
    """
    freedom = residual_px.size - parameters
    expected = float((sigma_px**2).mean()) * freedom
    return float(np.sqrt((residual_px**2).sum() / expected)), float(1.0 / np.sqrt(2.0 * freedom))


def without_pointing(position: FloatArray, error_px: FloatArray) -> FloatArray:
    """Map errors (n, 2) without the shift and roll that an attitude would absorb (least squares)."""
    terms = camera_terms(position, "aligned")[:, :, [0, 1, 3]].reshape(-1, 3)
    flat = error_px.reshape(-1)
    return np.asarray((flat - terms @ np.linalg.lstsq(terms, flat, rcond=None)[0]).reshape(-1, 2))


def map_change_px(position: FloatArray, change_px: FloatArray, *, scaled: bool) -> float:
    """RMS per axis of a change of the map (n, 2) after a common shift, roll and, if ``scaled``, scale."""
    terms = camera_terms(position, "aligned")[:, :, [0, 1, 2, 3] if scaled else [0, 1, 3]]
    return _residual_rms(terms.reshape(2 * len(position), -1), change_px.reshape(-1))


def polynomial_rms_px(position: FloatArray, offset_px: FloatArray) -> float:
    """RMS per axis of offsets (n, 2) about a cubic polynomial of each axis."""
    terms = polynomial_terms(position, 3)
    return float(np.sqrt(np.mean([_residual_rms(terms, axis) ** 2 for axis in offset_px.T])))


def _residual_rms(design_matrix: FloatArray, values: FloatArray) -> float:
    """Root mean square of least-squares residuals, by the degrees of freedom."""
    residual = values - design_matrix @ np.linalg.lstsq(design_matrix, values, rcond=None)[0]
    return float(np.sqrt((residual**2).sum() / (len(values) - design_matrix.shape[1])))


def map_error_px(
    position: FloatArray,
    offset_px: FloatArray,
    *,
    camera_px: FloatArray,
    polynomial_px: FloatArray,
    reference: Reference,
    order: int,
) -> FloatArray:
    """True error (m, 2) of a correction at field points, shift and roll taken out (ACC18 Fig. 8: at target points).

    Shapes: ``position`` (m, 2) in units of order 1, ``offset_px`` (m, 2) true minus nominal pixels there, such as of
    traced bundles; ``camera_px`` (k,) of `grid_residual_px`, ``polynomial_px`` (l, 2) of `distortion_statistics`, with
    the reference and order of their fits.
    """
    corrected = offset_px - camera_terms(position, reference) @ camera_px
    return without_pointing(position, corrected - polynomial_terms(position, order) @ polynomial_px)
