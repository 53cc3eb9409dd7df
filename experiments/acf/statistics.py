"""Statistics over Monte-Carlo runs: errors with their uncertainty, pulls, gains, maps; each beside its expectation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from experiments.acf.linear_model import Reprojection, sight_arcsec
from experiments.acf.monte_carlo import Trials
from experiments.acf.points import Point
from experiments.acf.published import FIG4_RMS_PX
from experiments.acf.result import Result
from experiments.acf.trials import field_of
from optics.arrays import FloatArray

__all__ = [
    "FIGURES",
    "angles_in_degrees",
    "camera_errors",
    "correlation_of",
    "distortion_map",
    "expected_distortion",
    "expected_errors",
    "expected_sight_map",
    "failures",
    "gains",
    "iac_pulls",
    "method_errors",
    "outside_limit",
    "own_pulls_over_expected",
    "pooled_errors",
    "published_deviation",
    "pull_limit",
    "pulls",
    "reprojection_lengths",
    "root_mean_square",
    "sight_map",
    "table2_errors",
]

DRAWS = 400
"""Of the predicted errors, for the expected largest residual distortion."""
RESAMPLES = 300
PULL_LIMIT = 0.10
FIGURES = ("x0_px", "y0_px", "focal_length_mm", "distortion_px", "sight_arcsec")
"""What Fig. 5 judges a method by: three parameters, the largest residual distortion, the line of sight."""


def root_mean_square(square: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """Root of a mean of squares, and its standard error."""
    rms = np.sqrt(square.mean(axis))
    return rms, square.std(axis, ddof=1) / np.sqrt(square.shape[axis]) / (2.0 * rms)


def angles_in_degrees(values: FloatArray) -> FloatArray:
    """Numbers of the 14 unknowns (..., 14) with the angles in deg."""
    out = np.array(values)
    out[..., 8:] = np.degrees(out[..., 8:])
    return out


def correlation_of(covariance: FloatArray) -> FloatArray:
    """Correlations of a covariance."""
    variance = np.diag(covariance)
    return np.asarray(covariance / np.sqrt(np.outer(variance, variance)))


def reprojection_lengths(
    result: Result, points: Sequence[Point], expected: Sequence[Sequence[Reprojection]]
) -> dict[str, FloatArray]:
    """RMS length of the reprojection error, run by run, which the document averages."""
    square = np.array(
        [
            [result.trials[point.name].of("acc", "reprojection_px2", k) for k in range(len(row))]
            for point, row in zip(points, expected, strict=True)
        ]
    )
    length = np.sqrt(square.sum(-1))
    runs = length.shape[-1]
    mean, wanted = length.mean(-1), np.array([[one.mean_px for one in row] for row in expected])
    scatter = np.array([[one.scatter_px for one in row] for row in expected])
    return {
        "mean": mean,
        "error": length.std(-1, ddof=1) / np.sqrt(runs),
        "expected": wanted,
        "scatter": scatter,
        "deviation": (mean - wanted) / scatter * runs**0.5,
    }


def published_deviation(expected: Reprojection) -> float:
    """Distance of Fig. 4's RMS length from the expectation, in standard deviations of one run."""
    return (float(np.linalg.norm(FIG4_RMS_PX)) - expected.mean_px) / expected.scatter_px


def table2_errors(result: Result) -> FloatArray:
    """Errors (r, 14) of Table 2's unknowns: px, mm, mm^-2 ..., deg."""
    return angles_in_degrees(result.trials[result.plan.table2.name].of("acc", "error"))


def _fig5(result: Result, method: str, what: str) -> FloatArray:
    """(s, r, ...) by noise and run."""
    return np.stack([result.trials[point.name].of(method, what) for point in result.plan.fig5])


def camera_errors(result: Result, method: str) -> FloatArray:
    """RMS errors (s, 8) of all camera parameters by noise."""
    return np.asarray(np.sqrt((_fig5(result, method, "error")[:, :, :8] ** 2).mean(1)))


def method_errors(result: Result, method: str) -> tuple[FloatArray, FloatArray]:
    """`FIGURES` of a method (5, s) by noise; standard errors (2, s) of the last two.

    RMS errors of the parameters; mean of the largest residual distortion; RMS of the line-of-sight map.
    """
    distortion, sight = _fig5(result, method, "distortion_px"), _fig5(result, method, "sight_arcsec")
    rms, rms_error = root_mean_square(sight**2, 1)
    distortion_error = distortion.std(1, ddof=1) / np.sqrt(distortion.shape[1])
    camera = camera_errors(result, method)[:, :3]
    return np.stack([*camera.T, distortion.mean(1), rms]), np.stack([distortion_error, rms_error])


def pooled_errors(result: Result, method: str) -> FloatArray:
    """RMS errors (3,) of x0, y0 and f per pixel of noise, all noises together."""
    noise = np.array(result.config.noise_px)[:, None, None]
    return np.asarray(np.sqrt(((_fig5(result, method, "error")[:, :, :8] / noise) ** 2).mean((0, 1)))[:3])


def expected_errors(result: Result, method: str) -> FloatArray:
    """Expected `FIGURES` of a method (5, s), from the design; full weights are as good as free attitudes.

    For unweighted angles the parameters' are what the method's own covariance says, on average; the others are NaN.
    """
    bounds = {"acc": "acc", "linked": "linked", "free": "free", "iac_full": "free"}
    if method not in bounds:
        sigma = np.sqrt((_fig5(result, method, "sigma")[:, :, :3] ** 2).mean(1))
        return np.concatenate([sigma.T, np.full((2, len(sigma)), np.nan)])
    covariances = [getattr(one, bounds[method])[:8, :8] for one in result.expected.fig5]
    operator = field_of(result.config, None).operator
    sight = np.array([sight_arcsec(operator, one) for one in covariances])
    camera = np.stack([np.sqrt(np.diag(one)[:3]) for one in covariances])
    return np.stack([*camera.T, expected_distortion(result, covariances), sight])


def expected_distortion(result: Result, covariances: Sequence[FloatArray]) -> FloatArray:
    """Expected largest residual distortion [px]: the mean over draws of the coefficients' errors."""
    from render.engine.random import Streams

    camera, grid = result.scene.camera, field_of(result.config, None)
    by_coefficient = camera.project_jacobian(grid.direction).by_parameter[:, :, 3:]
    draw = Streams(result.config.seed).child("acf").generator("expected distortion").standard_normal((DRAWS, 5))
    found = []
    for covariance in covariances:
        scale = np.sqrt(np.diag(covariance)[3:])
        root = np.linalg.cholesky(covariance[3:, 3:] / np.outer(scale, scale)) * scale[:, None]
        moved = np.einsum("nap,dp->dna", by_coefficient, draw @ root.T)
        found.append(float(np.linalg.norm(moved, axis=2).max(1).mean()))
    return np.array(found)


def pulls(result: Result) -> dict[str, FloatArray]:
    """Errors of the 14 unknowns over a predicted standard deviation (r, 14), all noises of Fig. 5 together.

    "own": ACC by its own covariance, which takes the gyro as perfect; "carried": ACC with the gyro's error carried
    through; "linked": the gyro of stated noise, by its own covariance.
    """
    found: dict[str, list[FloatArray]] = {"own": [], "carried": [], "linked": []}
    for point, expected in zip(result.plan.fig5, result.expected.fig5, strict=True):
        trials = result.trials[point.name]
        error = trials.of("acc", "error")
        found["own"].append(error / trials.of("acc", "sigma"))
        found["carried"].append(error / np.sqrt(np.diag(expected.acc)))
        found["linked"].append(trials.of("linked", "error") / trials.of("linked", "sigma"))
    return {which: np.concatenate(parts) for which, parts in found.items()}


def own_pulls_over_expected(result: Result) -> FloatArray:
    """RMS pulls (14,) of ACC by its own covariance, over what the design lets expect at each noise of Fig. 5.

    That is above 1 by what the gyro's error, which the covariance lacks, adds to an unknown; it adds most where the
    stars are least noisy, so that pulls are divided noise by noise before they are put together.
    """
    square = []
    for point, expected in zip(result.plan.fig5, result.expected.fig5, strict=True):
        trials = result.trials[point.name]
        pull = trials.of("acc", "error") / trials.of("acc", "sigma")
        square.append((pull**2).mean(0) * np.diag(expected.perfect) / np.diag(expected.acc))
    return np.asarray(np.sqrt(np.mean(square, axis=0)))


def iac_pulls(result: Result) -> FloatArray:
    """RMS pulls (8,) of the camera's unknowns by unweighted angles and their own covariance, all noises together."""
    pull = _fig5(result, "iac", "error")[..., :8] / _fig5(result, "iac", "sigma")[..., :8]
    return np.asarray(np.sqrt((pull**2).mean((0, 1))))


def pull_limit(runs: int) -> float:
    """How far an RMS pull may be from 1: a tenth, or for few runs what sampling allows, 3.5 / sqrt(2 n)."""
    return float(max(PULL_LIMIT, 3.5 / np.sqrt(2 * runs)))


def outside_limit(rms_pull: FloatArray, runs: int) -> NDArray[np.bool_]:
    """Which unknowns' RMS pulls miss `pull_limit`."""
    return np.asarray(np.abs(rms_pull - 1.0) > pull_limit(runs))


def gains(result: Result) -> dict[str, FloatArray]:
    """How many times better than free attitudes: ratio of the median line-of-sight errors over the skies."""
    factors, rng = range(len(result.config.sweep.gyro_factor)), np.random.default_rng(result.config.seed)
    names = ("acc", "acc_error", "acc_bound", "linked", "linked_error", "linked_bound", "point", "point_bound")
    found = {name: np.empty((len(result.plan.sweep), len(factors))) for name in names}
    for n, point in enumerate(result.plan.sweep):
        trials = result.trials[point.name]
        free, free_bound = _usable_sight(trials, "free"), trials.values["bound.free"]
        pick = rng.integers(0, len(free), (RESAMPLES, len(free)))
        for k in factors:
            for method in ("acc", "linked"):
                other, bound = _usable_sight(trials, method, k), trials.values[f"bound@{k}.{method}"]
                again = np.median(free[pick], axis=1) / np.median(other[pick], axis=1)
                found[method][n, k] = np.median(free) / np.median(other)
                found[f"{method}_error"][n, k] = again.std(ddof=1)
                found[f"{method}_bound"][n, k] = np.median(free_bound[:, -1]) / np.median(bound[:, -1])
            away, away_free = trials.of("acc", "error", k)[:, :2], trials.of("free", "error")[:, :2]
            found["point"][n, k] = _median_length(away_free) / _median_length(away)
            bound = trials.values[f"bound@{k}.acc"][:, :2]
            found["point_bound"][n, k] = _median_length(free_bound[:, :2]) / _median_length(bound)
    return found


def _usable_sight(trials: Trials, method: str, gyro: int | None = 0) -> FloatArray:
    """Line-of-sight error, infinitely bad where the adjustment did not converge or has no direction for a pixel."""
    values = trials.of(method, "sight_arcsec", gyro)
    good = (trials.of(method, "converged", gyro) > 0.5) & np.isfinite(values)
    return np.where(good, values, np.inf)


def _median_length(xy: FloatArray) -> float:
    return float(np.median(np.linalg.norm(xy, axis=1)))


def sight_map(result: Result, errors: FloatArray) -> FloatArray:
    """RMS line-of-sight error at each place of the grid (m, m) [arcsec] of camera errors (r, 8)."""
    operator = field_of(result.config, None).operator
    return _square_map(((errors[:, :8] @ operator.T) ** 2).mean(0).reshape(-1, 2).sum(1))


def expected_sight_map(result: Result, covariance: FloatArray) -> FloatArray:
    """The same of errors with that covariance, camera parameters first."""
    operator = field_of(result.config, None).operator
    square = np.einsum("ij,jk,ik->i", operator, covariance[:8, :8], operator, optimize=True)
    return _square_map(square.reshape(-1, 2).sum(1))


def distortion_map(result: Result, errors: FloatArray) -> FloatArray:
    """RMS residual distortion at each place of the grid (m, m) [px] of camera errors (r, 8): the coefficients alone."""
    grid = field_of(result.config, None)
    by_coefficient = result.scene.camera.project_jacobian(grid.direction).by_parameter[:, :, 3:]
    return _square_map((np.einsum("nap,rp->rna", by_coefficient, errors[:, 3:8]) ** 2).mean(0).sum(1))


def _square_map(square: FloatArray) -> FloatArray:
    side = round(np.sqrt(len(square)))
    return np.asarray(np.sqrt(square).reshape(side, side))


def failures(trials: Mapping[str, Trials], points: Sequence[Point]) -> dict[str, tuple[int, int]]:
    """Calibrations that did not converge, and how many there were, by method, at some points."""
    found: dict[str, tuple[int, int]] = {}
    for point in points:
        for key, values in trials[point.name].values.items():
            if key.endswith(".converged"):
                method = key.split(".")[0].split("@")[0]
                failed, count = found.get(method, (0, 0))
                found[method] = failed + int((values < 0.5).sum()), count + len(values)
    return found
