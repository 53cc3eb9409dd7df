r"""Expected scatter of the star vectors from covariances alone.

An image moves by centroid noise and by errors of the table readings; both form a covariance C_i on the detector. To
first order the error of a star vector, on the plane tangent at the star, is

.. math:: e_i = T_i\, (n_i - A_i\, \delta), \qquad n_i \sim N(0, C_i)

with T_i the derivative of the vector by the image, A_i that of the image by the unknowns of the calibration that enter
a vector (camera, installation, axes; not the star) and delta the error of the calibration. For separate data delta is
independent of the n_i and has the covariance of the calibration. For the calibration's own data delta = G n with G =
(A^T W A)^{-1} A^T W, star included, W = C^{-1}; the residuals then have q degrees of freedom less, q the number of
unknowns.

The sum of squared chords is then a quadratic form of normal variables; its mean and variance follow from the covariance
of all e_i about their mean, and the chi-square with the same mean and variance (Satterthwaite) gives its interval.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from calib.calibration.record import Calibration
from calib.calibration.turntable import STAR_NAMES
from calib.cameras.base import CameraModel, unproject_jacobian
from calib.directional.fisher import tangent_basis
from experiments.fisher.acquire import Motion
from experiments.laboratory.single_star.bench import Bench
from experiments.laboratory.single_star.derivatives import angle_effect, design, reading_covariance_px2
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC

STAR_COLUMNS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Scatter:
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
    def noise_arcsec(self) -> float:
        """The same of the noise alone."""
        return float(np.sqrt(self.noise_rad2) * RAD_ARCSEC)

    @property
    def effective_degrees(self) -> float:
        """Degrees of freedom that make the sum unbiased for the noise."""
        return self.sum_rad2 / self.noise_rad2

    @property
    def satterthwaite(self) -> float:
        """Degrees of freedom of the chi-square with the same relative variance."""
        return 2.0 * self.sum_rad2**2 / self.variance_rad4

    def z_score(self, chord_sum_rad2: float) -> float:
        """Deviation of a measured sum, as a normal deviate."""
        nu = self.satterthwaite
        below = chi2.cdf(chord_sum_rad2 / self.sum_rad2 * nu, nu)
        return float(np.clip(norm.ppf(np.clip(below, 1e-12, 1 - 1e-12)), -7.0, 7.0))


def tangent_maps(model: CameraModel, bench: Bench, angle_rad: FloatArray) -> FloatArray:
    """Derivatives (n, 2, 2) of the star vector on its tangent plane by the image [rad per px]."""
    seen = bench.seen(angle_rad)
    by_pixel = unproject_jacobian(model, model.project(seen)).by_pixel
    turn = bench.table.rotation(angle_rad).as_matrix() @ bench.installation.inv().as_matrix()
    return np.asarray(tangent_basis(bench.star) @ turn @ by_pixel)


def jitter_covariance_px2(model: CameraModel, bench: Bench, angle_rad: FloatArray, motion: Motion) -> FloatArray:
    """Covariance on the detector by the jitter of the clocks, (n, 2, 2) [px^2]."""
    by_direction = model.project_jacobian(bench.seen(angle_rad)).by_direction
    shift = (by_direction @ angle_effect(bench, angle_rad)[:, 1, :, None])[..., 0] * motion.smear_rad
    return np.asarray(shift[:, :, None] * shift[:, None, :])


def table_covariance_px2(model: CameraModel, bench: Bench, angle_rad: FloatArray, motion: Motion) -> FloatArray:
    """Covariance on the detector by readings and clocks of the table, (n, 2, 2) [px^2]."""
    angle = np.array(angle_rad)
    return reading_covariance_px2(model, bench, angle) + jitter_covariance_px2(model, bench, angle, motion)


def on_the_sphere(maps: FloatArray, covariance_px2: FloatArray) -> float:
    """Mean standard deviation per axis [arcsec] of star vectors with such images."""
    trace = np.einsum("nij,njk,nik->n", maps, covariance_px2, maps)
    return float(np.sqrt(trace.mean() / 2.0) * RAD_ARCSEC)


def calibration_of_rows(model: CameraModel, bench: Bench, angle_rad: FloatArray) -> FloatArray:
    """Derivatives (n, 2, q) of the image by the unknowns, the star's two direction angles last."""
    rows = design(model, bench, np.array(angle_rad), leans=True)
    star = len(model.parameters) + np.arange(STAR_COLUMNS)
    rest = np.setdiff1d(np.arange(rows.shape[2]), star)
    return np.asarray(rows[:, :, np.concatenate([rest, star])])


def covariance_of_rows(calibration: Calibration) -> FloatArray:
    """Covariance (q, q) of the unknowns in the order of `calibration_of_rows`."""
    solution = calibration.solution
    star = [solution.index(name) for name in STAR_NAMES]
    order = [i for i in range(len(solution.names)) if i not in star] + star
    return np.array(solution.covariance)[np.ix_(order, order)]


def predict_independent(
    maps: FloatArray, noise_px2: FloatArray, rows: FloatArray, calibration_covariance: FloatArray
) -> Scatter:
    """Scatter of data that the calibration has not seen."""
    spread = _blocks(maps @ noise_px2 @ np.swapaxes(maps, 1, 2))
    enters = (maps @ rows)[:, :, :-STAR_COLUMNS].reshape(len(spread), -1)
    part = calibration_covariance[:-STAR_COLUMNS, :-STAR_COLUMNS]
    return _scatter(spread + enters @ part @ enters.T, maps, noise_px2)


def predict_same_data(maps: FloatArray, noise_px2: FloatArray, rows: FloatArray) -> Scatter:
    """Scatter of the data that the calibration was fitted to, weighted by their noise."""
    flat = rows.reshape(-1, rows.shape[2])
    flat = flat / np.linalg.norm(flat, axis=0)
    weight = _blocks(np.asarray(np.linalg.inv(noise_px2), np.float64))
    gain = np.linalg.solve(flat.T @ weight @ flat, flat.T @ weight)
    left = np.eye(len(flat)) - flat[:, :-STAR_COLUMNS] @ gain[:-STAR_COLUMNS]
    carried = _blocks(maps) @ left
    return _scatter(carried @ _blocks(noise_px2) @ carried.T, maps, noise_px2)


def ratio_scatter(maps: FloatArray, noise_px2: FloatArray) -> float:
    r"""Standard deviation, relative, of pixel method over Fisher on the same vectors.

    Both are roots of sums of squares, ``b`` of the residuals n_i in pixels and ``a`` of T_i n_i on the sphere. If the
    angle per pixel were constant over the field, the ratio would be constant; where it varies, the ratio depends on
    which places have the large residuals. To first order, for normal n_i of covariance C_i and M_i = T_i^T T_i,

    .. math:: \mathrm{var}\,\log(b/a) = \frac{1}{4} \sum_i 2\, \mathrm{tr}
        \left[\left(C_i / \textstyle\sum \mathrm{tr}\, C_j
        - M_i C_i / \sum \mathrm{tr}\, M_j C_j\right)^2\right]
    """
    sphere = np.swapaxes(maps, 1, 2) @ maps @ noise_px2
    apart = noise_px2 / np.einsum("nii->", noise_px2) - sphere / np.einsum("nii->", sphere)
    return float(np.sqrt(np.einsum("nij,nji->", apart, apart) / 2.0))


def _blocks(matrices: FloatArray) -> FloatArray:
    """Block-diagonal (2n, 2n) of (n, 2, 2)."""
    count = len(matrices)
    full = np.zeros((count, 2, count, 2))
    full[np.arange(count), :, np.arange(count)] = matrices
    return full.reshape(2 * count, 2 * count)


def _scatter(covariance: FloatArray, maps: FloatArray, noise_px2: FloatArray) -> Scatter:
    count = len(maps)
    about = np.array(covariance).reshape(count, 2, count, 2)
    about -= about.mean(0, keepdims=True)
    about -= about.mean(2, keepdims=True)
    square = about.reshape(2 * count, 2 * count)
    noise = np.einsum("nij,njk,nik->", maps, noise_px2, maps) / (2 * count)
    return Scatter(
        count=count,
        sum_rad2=float(np.trace(square)),
        variance_rad4=float(2.0 * np.sum(square * square)),
        noise_rad2=float(noise),
    )
