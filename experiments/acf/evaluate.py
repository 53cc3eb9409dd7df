"""Reduction of the runs: each figure's numbers with their uncertainty, beside what was expected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.acf.forecast import Covariances
from experiments.acf.plan import COMPARED, Outcome
from experiments.acf.predict import sight_arcsec
from experiments.acf.published import FIG4_LARGEST_PX, FIG4_RMS_PX
from experiments.acf.result import Result
from experiments.acf.tasks import field_of
from optics.arrays import FloatArray

__all__ = [
    "Comparison",
    "Fig4",
    "Gains",
    "Pulls",
    "Runs",
    "comparison",
    "counts",
    "distortion_rms",
    "failures",
    "fig3",
    "fig4",
    "gains",
    "map_expected",
    "map_rms",
    "pulls",
    "runs_of_lengths",
    "table2_runs",
]


DRAWS = 400
"""Of the predicted errors, for the expected largest residual distortion."""
RESAMPLES = 300


@dataclass(frozen=True, slots=True, kw_only=True)
class Runs:
    """A figure of merit over runs, and what was expected.

    Attributes
    ----------
    value, error : float
        Mean over the runs and its standard error.
    expected, scatter : float
        Expected mean, and standard deviation of one run.
    n : int
        Runs.
    """

    value: float
    error: float
    expected: float
    scatter: float
    n: int

    @property
    def deviation(self) -> float:
        """Mean minus expectation, in standard errors as expected."""
        return (self.value - self.expected) / self.scatter * self.n**0.5


def runs_of_lengths(outcome: Outcome, gyro: int, expected: tuple[float, float]) -> Runs:
    """RMS length of the reprojection error of each run; the document averages these."""
    length = np.sqrt(outcome.of("acc", "reprojection_px2", gyro).sum(1))
    return Runs(
        value=float(length.mean()),
        error=float(length.std(ddof=1) / np.sqrt(len(length))),
        expected=expected[0],
        scatter=expected[1],
        n=len(length),
    )


def fig3(result: Result) -> list[list[Runs]]:
    """Reprojection error by noise and gyro."""
    return [
        [
            runs_of_lengths(result.outcome[point.name], k, (one.mean_px, one.scatter_px))
            for k, one in enumerate(expected)
        ]
        for point, expected in zip(result.plan.fig3, result.forecast.fig3, strict=True)
    ]


def counts(result: Result) -> list[list[Runs]]:
    """The same by number of stars; a perfect gyro, then Table 1's."""
    return [
        [
            runs_of_lengths(result.outcome[point.name], k, (one.mean_px, one.scatter_px))
            for k, one in enumerate(expected)
        ]
        for point, expected in zip(result.plan.counts, result.forecast.counts, strict=True)
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fig4:
    """Reprojection errors at 0.1 px.

    Attributes
    ----------
    rms_px, error_px : (2,)
        Over all stars and runs, x and y, and the standard error.
    expected_px : (2,)
        What was expected.
    runs : Runs
        RMS length, run by run.
    published_px : float
        RMS length of Fig. 4.
    published_deviation : float
        Distance of that from the expectation, in standard deviations of one run.
    largest_px : float
        Median over the runs of the largest error.
    inside : float
        Part of the errors below the document's 0.04 px.
    """

    rms_px: FloatArray
    error_px: FloatArray
    expected_px: FloatArray
    runs: Runs
    published_px: float
    published_deviation: float
    largest_px: float
    inside: float


def fig4(result: Result, *, inferred: bool = False) -> Fig4:
    """Fig. 4 with the assumed pixel and sky, or with those that the document's numbers ask for."""
    outcome = result.outcome[(result.plan.inferred if inferred else result.plan.table2).name]
    expected = result.forecast.inferred if inferred else result.forecast.fig4
    square = outcome.of("acc", "reprojection_px2")
    runs = runs_of_lengths(outcome, 0, (expected.mean_px, expected.scatter_px))
    published = float(np.linalg.norm(FIG4_RMS_PX))
    length = np.linalg.norm(outcome.of("acc", "reprojected_px"), axis=2)
    rms = np.sqrt(square.mean(0))
    return Fig4(
        rms_px=rms,
        error_px=square.std(0, ddof=1) / np.sqrt(len(square)) / (2.0 * rms),
        expected_px=expected.axis_px,
        runs=runs,
        published_px=published,
        published_deviation=(published - expected.mean_px) / expected.scatter_px,
        largest_px=float(np.median(length.max(1))),
        inside=float((length < FIG4_LARGEST_PX).mean()),
    )


def table2_runs(result: Result) -> FloatArray:
    """Errors (r, 14) of Table 2's unknowns: px, mm, mm^-2 ..., deg."""
    error = result.outcome[result.plan.table2.name].of("acc", "error").copy()
    error[:, 8:] = np.degrees(error[:, 8:])
    return error


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One method over the noises of Fig. 5.

    Attributes
    ----------
    method : str
        Name.
    camera : (s, 8)
        RMS error of the camera's parameters.
    distortion_px, sight_arcsec : (s,)
        Mean of the largest residual distortion; RMS of the line-of-sight map.
    distortion_error_px, sight_error_arcsec : (s,)
        Their standard errors.
    expected_camera : (s, 8)
        Expected RMS errors: from the design, or (unweighted angles) by the method's own covariance.
    expected_distortion_px, expected_sight_arcsec : (s,) or None
        Expected figures; None for unweighted angles.
    pooled : (8,)
        RMS error over noise, all noises together.
    runs : int
        Runs per noise.
    """

    method: str
    camera: FloatArray
    distortion_px: FloatArray
    distortion_error_px: FloatArray
    sight_arcsec: FloatArray
    sight_error_arcsec: FloatArray
    expected_camera: FloatArray
    expected_distortion_px: FloatArray | None
    expected_sight_arcsec: FloatArray | None
    pooled: FloatArray
    runs: int


def comparison(result: Result) -> dict[str, Comparison]:
    """Fig. 5, every method."""
    return {method: _compared(result, method) for method in COMPARED}


def _compared(result: Result, method: str) -> Comparison:
    outcomes = [result.outcome[point.name] for point in result.plan.fig5]
    error = np.stack([outcome.of(method, "error")[:, :8] for outcome in outcomes])
    distortion = np.stack([outcome.of(method, "distortion_px") for outcome in outcomes])
    sight = np.stack([outcome.of(method, "sight_arcsec") for outcome in outcomes])
    runs = error.shape[1]
    rms_sight = np.sqrt((sight**2).mean(1))
    noise = np.array(result.config.noise_px)
    expected = _expected_covariances(result, method)
    return Comparison(
        method=method,
        camera=np.sqrt((error**2).mean(1)),
        distortion_px=distortion.mean(1),
        distortion_error_px=distortion.std(1, ddof=1) / np.sqrt(runs),
        sight_arcsec=rms_sight,
        sight_error_arcsec=(sight**2).std(1, ddof=1) / np.sqrt(runs) / (2.0 * rms_sight),
        expected_camera=_expected_camera(outcomes, method, expected),
        expected_distortion_px=None if expected is None else _expected_distortion(result, expected),
        expected_sight_arcsec=None if expected is None else _expected_sight(result, expected),
        pooled=np.sqrt(((error / noise[:, None, None]) ** 2).mean((0, 1))),
        runs=runs,
    )


def _expected_camera(outcomes: Sequence[Outcome], method: str, expected: Sequence[FloatArray] | None) -> FloatArray:
    """Expected RMS errors (s, 8); of unweighted angles what their own covariance says, on average."""
    if expected is None:
        return np.stack([np.sqrt((one.of(method, "sigma")[:, :8] ** 2).mean(0)) for one in outcomes])
    return np.stack([np.sqrt(np.diag(one)[:8]) for one in expected])


def _expected_covariances(result: Result, method: str) -> list[FloatArray] | None:
    """What a method is expected to reach; full weights are as good as free attitudes."""
    chosen = {"acc": "acc", "linked": "linked", "free": "free", "iac_full": "free"}.get(method)
    return None if chosen is None else [getattr(one, chosen)[:8, :8] for one in result.forecast.fig5]


def _expected_sight(result: Result, covariances: Sequence[FloatArray]) -> FloatArray:
    operator = field_of(result.config, None).operator
    return np.array([sight_arcsec(operator, one) for one in covariances])


def _expected_distortion(result: Result, covariances: Sequence[FloatArray]) -> FloatArray:
    """Expected largest residual distortion: the mean over draws of the coefficients' errors."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Pulls:
    """Errors of the 14 unknowns over a predicted standard deviation, all noises of Fig. 5 together.

    Attributes
    ----------
    own : (r, 14)
        ACC, by its own covariance, which takes the gyro as perfect.
    carried : (r, 14)
        ACC, with the gyro's error carried through.
    linked : (r, 14)
        The gyro of stated noise, by its own covariance.
    """

    own: FloatArray
    carried: FloatArray
    linked: FloatArray

    def rms(self, which: str) -> FloatArray:
        """RMS pull of each unknown (14,)."""
        return np.asarray(np.sqrt((getattr(self, which) ** 2).mean(0)))


def pulls(result: Result) -> Pulls:
    """Pulls of ACC and of the linked adjustment."""
    own, carried, linked = [], [], []
    for point, expected in zip(result.plan.fig5, result.forecast.fig5, strict=True):
        outcome = result.outcome[point.name]
        error = outcome.of("acc", "error")
        own.append(error / outcome.of("acc", "sigma"))
        carried.append(error / np.sqrt(np.diag(expected.acc)))
        linked.append(outcome.of("linked", "error") / outcome.of("linked", "sigma"))
    return Pulls(own=np.concatenate(own), carried=np.concatenate(carried), linked=np.concatenate(linked))


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains:
    """How many times better than free attitudes: ratio of the median line-of-sight errors over the skies.

    Attributes
    ----------
    acc, linked : (n, g)
        By number of stars and gyro: ACC, which trusts the gyro, and the gyro of stated noise.
    acc_error, linked_error : (n, g)
        Standard errors (resampled runs).
    acc_bound, linked_bound : (n, g)
        Expected.
    point, point_bound : (n, g)
        ACC's gain in the principal point, found and expected.
    runs : int
        Skies per number of stars.
    """

    acc: FloatArray
    linked: FloatArray
    acc_error: FloatArray
    linked_error: FloatArray
    acc_bound: FloatArray
    linked_bound: FloatArray
    point: FloatArray
    point_bound: FloatArray
    runs: int


def gains(result: Result) -> Gains:
    """Gain over free attitudes against stars per frame and gyro noise."""
    points, factors = result.plan.sweep, range(len(result.config.sweep.gyro_factor))
    rng = np.random.default_rng(result.config.seed)
    found: dict[str, list[list[float]]] = {name: [] for name in Gains.__slots__ if name != "runs"}
    for point in points:
        outcome = result.outcome[point.name]
        row: dict[str, list[float]] = {name: [] for name in found}
        free, free_bound = _usable(outcome, "free", "sight_arcsec"), outcome.values["bound.free"]
        pick = rng.integers(0, len(free), (RESAMPLES, len(free)))
        for k in factors:
            for method in ("acc", "linked"):
                other, bound = _usable(outcome, method, "sight_arcsec", k), outcome.values[f"bound@{k}.{method}"]
                row[method].append(float(np.median(free) / np.median(other)))
                again = np.median(free[pick], axis=1) / np.median(other[pick], axis=1)
                row[f"{method}_error"].append(float(again.std(ddof=1)))
                row[f"{method}_bound"].append(float(np.median(free_bound[:, -1]) / np.median(bound[:, -1])))
            away, away_free = outcome.of("acc", "error", k)[:, :2], outcome.of("free", "error")[:, :2]
            row["point"].append(float(_median_length(away_free) / _median_length(away)))
            bound = outcome.values[f"bound@{k}.acc"][:, :2]
            row["point_bound"].append(float(_median_length(free_bound[:, :2]) / _median_length(bound)))
        for name, values in row.items():
            found[name].append(values)
    return Gains(**{name: np.array(values) for name, values in found.items()}, runs=result.config.sweep.skies)


def _usable(outcome: Outcome, method: str, what: str, gyro: int | None = 0) -> FloatArray:
    """A figure of merit, infinitely bad where the adjustment did not converge or has no direction for a pixel."""
    values = outcome.of(method, what, gyro)
    good = (outcome.of(method, "converged", gyro) > 0.5) & np.isfinite(values)
    return np.where(good, values, np.inf)


def _median_length(xy: FloatArray) -> float:
    return float(np.median(np.linalg.norm(xy, axis=1)))


def map_rms(result: Result, errors: FloatArray) -> FloatArray:
    """RMS line-of-sight error at each place of the grid (m, m) [arcsec] of camera errors (r, 8)."""
    operator = field_of(result.config, None).operator
    square = ((errors[:, :8] @ operator.T) ** 2).mean(0).reshape(-1, 2).sum(1)
    side = round(np.sqrt(len(square)))
    return np.asarray(np.sqrt(square).reshape(side, side))


def distortion_rms(result: Result, errors: FloatArray) -> FloatArray:
    """RMS residual distortion at each place of the grid (m, m) [px] of camera errors (r, 8): the coefficients alone."""
    grid = field_of(result.config, None)
    by_coefficient = result.scene.camera.project_jacobian(grid.direction).by_parameter[:, :, 3:]
    square = (np.einsum("nap,rp->rna", by_coefficient, errors[:, 3:8]) ** 2).mean(0).sum(1)
    side = round(np.sqrt(len(square)))
    return np.asarray(np.sqrt(square).reshape(side, side))


def map_expected(result: Result, expected: Covariances) -> FloatArray:
    """Expected RMS line-of-sight error of ACC at each place of the grid (m, m) [arcsec]."""
    operator = field_of(result.config, None).operator
    square = np.einsum("ij,jk,ik->i", operator, expected.acc[:8, :8], operator, optimize=True).reshape(-1, 2).sum(1)
    side = round(np.sqrt(len(square)))
    return np.asarray(np.sqrt(square).reshape(side, side))


def failures(result: Result, *, sweep: bool) -> dict[str, tuple[int, int]]:
    """Calibrations that did not converge, and how many there were, by method; of the sweep or of all else.

    In the sweep some are expected: two stars in a frame, or a gyro so bad that ACC's residuals refuse it.
    """
    found: dict[str, tuple[int, int]] = {}
    for outcome in result.outcome.values():
        if (outcome.point in result.plan.sweep) != sweep:
            continue
        for key, values in outcome.values.items():
            if key.endswith(".converged"):
                method = key.split(".")[0].split("@")[0]
                failed, count = found.get(method, (0, 0))
                found[method] = failed + int((values < 0.5).sum()), count + len(values)
    return found
