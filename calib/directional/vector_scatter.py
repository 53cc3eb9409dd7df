r"""Expected scatter of star vectors from covariances alone.

An image moves by centroid noise and by errors of the table readings; both form a covariance C_i on the detector. To
first order the error of a star vector, on the plane tangent at the star, is

.. math:: e_i = T_i\, (n_i - A_i\, \delta), \qquad n_i \sim N(0, C_i)

with T_i the derivative of the vector by the image (``vector_by_pixel``), A_i that of the image by the unknowns of the
calibration (``design``: the star's two direction angles last, which do not enter a vector) and delta the error of the
calibration. For separate data delta is independent of the n_i and has the covariance of the calibration. For the
calibration's own data delta = G n with G = (A^T W A)^{-1} A^T W, star included, W = C^{-1}; the residuals then have q
degrees of freedom less, q the number of unknowns.

The sum of squared chords is then a quadratic form of normal variables; its mean and variance follow from the covariance
of all e_i about their mean, and the chi-square with the same mean and variance (Satterthwaite) gives its interval.
`calib.calibration.star_bench` has the derivatives of a turntable before a star.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import chi2, norm

from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC

STAR_COLUMNS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class VectorScatter:
    """Expected sum of squared chords of n vectors."""

    count: int  # n
    sum_rad2: float  # Its mean
    variance_rad4: float  # Its variance
    noise_rad2: float  # Mean variance per axis of the noise alone, without calibration and without the mean taken off

    @property
    def sigma_arcsec(self) -> float:
        """Standard deviation per axis as 2 (n - 1) degrees of freedom give it."""
        return float(np.sqrt(self.sum_rad2 / (2 * (self.count - 1))) * RAD_ARCSEC)

    @property
    def satterthwaite(self) -> float:
        """Degrees of freedom of the chi-square with the same relative variance."""
        return 2.0 * self.sum_rad2**2 / self.variance_rad4

    def z_score(self, chord_sum_rad2: float) -> float:
        """Deviation of a measured sum, as a normal deviate."""
        nu = self.satterthwaite
        below = chi2.cdf(chord_sum_rad2 / self.sum_rad2 * nu, nu)
        return float(np.clip(norm.ppf(np.clip(below, 1e-12, 1 - 1e-12)), -7.0, 7.0))


def vector_sigma_arcsec(vector_by_pixel: FloatArray, covariance_px2: FloatArray) -> float:
    """Mean standard deviation per axis [arcsec] of star vectors with such images."""
    trace = np.einsum("nij,njk,nik->n", vector_by_pixel, covariance_px2, vector_by_pixel)
    return float(np.sqrt(trace.mean() / 2.0) * RAD_ARCSEC)


def scatter_of_other_data(
    vector_by_pixel: FloatArray, noise_px2: FloatArray, design: FloatArray, calibration_covariance: FloatArray
) -> VectorScatter:
    """Scatter of star vectors of data that the calibration did not use.

    Shapes: ``vector_by_pixel`` (n, 2, 2) [rad/px], ``noise_px2`` (n, 2, 2), ``design`` (n, 2, q),
    ``calibration_covariance`` (q, q).
    """
    spread = block_diag(*vector_by_pixel @ noise_px2 @ np.swapaxes(vector_by_pixel, 1, 2))
    by_unknown = (vector_by_pixel @ design)[:, :, :-STAR_COLUMNS].reshape(len(spread), -1)
    part = calibration_covariance[:-STAR_COLUMNS, :-STAR_COLUMNS]
    return _scatter(spread + by_unknown @ part @ by_unknown.T, vector_by_pixel, noise_px2)


def scatter_of_own_data(vector_by_pixel: FloatArray, noise_px2: FloatArray, design: FloatArray) -> VectorScatter:
    """Scatter of star vectors of the data that the calibration was fitted to, weighted by their noise.

    Shapes: ``vector_by_pixel`` (n, 2, 2) [rad/px], ``noise_px2`` (n, 2, 2), ``design`` (n, 2, q).
    """
    flat = design.reshape(-1, design.shape[2])
    flat = flat / np.linalg.norm(flat, axis=0)
    weight = block_diag(*np.asarray(np.linalg.inv(noise_px2), np.float64))
    gain = np.linalg.solve(flat.T @ weight @ flat, flat.T @ weight)
    residual_maker = np.eye(len(flat)) - flat[:, :-STAR_COLUMNS] @ gain[:-STAR_COLUMNS]
    carried = block_diag(*vector_by_pixel) @ residual_maker
    return _scatter(carried @ block_diag(*noise_px2) @ carried.T, vector_by_pixel, noise_px2)


def pixel_method_scatter(vector_by_pixel: FloatArray, noise_px2: FloatArray) -> float:
    r"""Standard deviation, relative, of pixel method over Fisher on the same vectors.

    Both are roots of sums of squares, ``b`` of the residuals n_i in pixels and ``a`` of T_i n_i on the sphere. If the
    angle per pixel were constant over the field, the ratio would be constant; where it varies, the ratio depends on
    which places have the large residuals. To first order, for normal n_i of covariance C_i and M_i = T_i^T T_i,

    .. math:: \mathrm{var}\,\log(b/a) = \frac{1}{4} \sum_i 2\, \mathrm{tr}
        \left[\left(C_i / \textstyle\sum \mathrm{tr}\, C_j
        - M_i C_i / \sum \mathrm{tr}\, M_j C_j\right)^2\right]
    """
    sphere = np.swapaxes(vector_by_pixel, 1, 2) @ vector_by_pixel @ noise_px2
    difference = noise_px2 / np.einsum("nii->", noise_px2) - sphere / np.einsum("nii->", sphere)
    return float(np.sqrt(np.einsum("nij,nji->", difference, difference) / 2.0))


def _scatter(covariance: FloatArray, vector_by_pixel: FloatArray, noise_px2: FloatArray) -> VectorScatter:
    count = len(vector_by_pixel)
    about = np.array(covariance).reshape(count, 2, count, 2)
    about -= about.mean(0, keepdims=True)
    about -= about.mean(2, keepdims=True)
    square = about.reshape(2 * count, 2 * count)
    noise = np.einsum("nij,njk,nik->", vector_by_pixel, noise_px2, vector_by_pixel) / (2 * count)
    return VectorScatter(
        count=count,
        sum_rad2=float(np.trace(square)),
        variance_rad4=float(2.0 * np.sum(square * square)),
        noise_rad2=float(noise),
    )
