"""What the turntable calibration says in numbers: summary, criteria, what dominates."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import chi2

from calib.attitude.star_vectors import initial_frame_vectors
from experiments.harness.summary import Criterion, Measured
from experiments.turntable.bound import closed_form_px
from experiments.turntable.result import Case, Result
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC

__all__ = [
    "criteria",
    "crossover_arcsec",
    "map_ratio",
    "point_over_line",
    "principal_point_arcsec",
    "pull_limit",
    "rendered_limit",
    "results",
    "unit_of",
    "vector_scatter_arcsec",
]


PULL_TOLERANCE = 0.10
ENOUGH_RUNS = 300
"""So many that a standard deviation is known to 4 %."""
SWEEP_TOLERANCE = 1.25
RENDERED_QUANTILE = 0.998
"""Of a scaled chi-square with the mean and the variance of the runs: their own quantile would be their largest."""


def principal_point_arcsec(result: Result, case: Case) -> FloatArray:
    """Standard deviation of the principal point alone, as an angle on the axis, (2,)."""
    reduction = case.reductions["estimated"]
    return np.array([reduction.sigma(name) for name in ("x0_px", "y0_px")]) * result.instrument.pixel_arcsec


def map_ratio(case: Case) -> float:
    """Map error of the rendered run over what its covariance predicts."""
    line = case.reductions["estimated"].line_of_sight
    return line.rms_arcsec / line.predicted_rms_arcsec


def rendered_limit(ratio: FloatArray) -> float:
    """What the map error over its prediction stays below with probability `RENDERED_QUANTILE`.

    Its square is a sum of squares of unequal size; a scaled chi-square takes its mean and variance from all runs
    (Satterthwaite), where a quantile so far out would hang on one or two of them.
    """
    square = ratio**2
    if len(square) < 2:
        return float("nan")
    mean, variance = float(square.mean()), float(square.var(ddof=1))
    freedom = 2.0 * mean**2 / variance
    return float(np.sqrt(mean * chi2.ppf(RENDERED_QUANTILE, freedom) / freedom))


def point_over_line(sigma_arcsec: float, map_arcsec: float) -> float:
    """How many times worse one coordinate of the principal point is known than the line of sight, both per axis.

    ``map_arcsec`` is an RMS length over two axes.
    """
    return float(sigma_arcsec / map_arcsec * np.sqrt(2.0))


def crossover_arcsec(result: Result) -> float:
    """Reading noise, the same on both axes, that doubles the variance of the map against centroids alone.

    The bound is b^2 = b0^2 + (s r)^2 to first order; s is taken where readings dominate.
    """
    most = max(result.reading_sweep, key=lambda point: point.reading_arcsec)
    slope2 = (most.bound_arcsec**2 - result.centroid_bound_arcsec**2) / max(most.reading_arcsec, 1e-300) ** 2
    return float(result.centroid_bound_arcsec / np.sqrt(slope2)) if slope2 > 0 else float("nan")


def vector_scatter_arcsec(case: Case) -> FloatArray:
    """Standard deviation (2,) of the star vectors in the table's initial frame (S300), across the star [arcsec].

    Two directions: along the laboratory's X as seen from the star, and square to it.
    """
    reduction = case.reductions["known"]
    installation = reduction.calibration.installation
    assert installation is not None
    measurement = case.measurement
    vectors = initial_frame_vectors(
        reduction.calibration.model,
        measurement.readings.position_px,
        installation=installation,
        table_rotation=measurement.bench.table.rotation(measurement.visits.reading_rad),
    )
    mean = vectors.mean(0) / np.linalg.norm(vectors.mean(0))
    along = np.array([1.0, 0.0, 0.0]) - mean[0] * mean
    along /= np.linalg.norm(along)
    basis = np.stack([along, np.cross(mean, along)])
    return np.asarray((vectors @ basis.T).std(0, ddof=1) * RAD_ARCSEC)


def pull_limit(case: Case) -> float:
    """10 %, or three standard errors where there are few runs."""
    runs = case.monte_carlo.runs
    return PULL_TOLERANCE if runs >= ENOUGH_RUNS else 3.0 / np.sqrt(2.0 * max(runs, 1))


def _case_criteria(case: Case) -> list[Criterion]:
    found, solution = case.monte_carlo, case.reductions["estimated"].calibration.solution
    worst = float(np.abs(found.pull_std - 1).max()) if found.runs else float("nan")
    chi2_error = np.sqrt(2.0 / solution.degrees_of_freedom)
    ratios = found.map_rms_arcsec / found.predicted_map_arcsec
    return [
        Criterion(name=f"{case.name}: RMS pull farthest from 1, Monte-Carlo", value=worst, limit=pull_limit(case)),
        Criterion(
            name=f"{case.name}: map error over Cramér–Rao bound, Monte-Carlo",
            value=found.map_arcsec / case.bound.map_sigma_arcsec,
            limit=1.10,
        ),
        Criterion(
            name=f"{case.name}: rendered run, map error over prediction (limit: {RENDERED_QUANTILE:.1%} "
            "of a scaled χ² with mean and variance of the runs)",
            value=map_ratio(case),
            limit=rendered_limit(ratios),
        ),
        Criterion(
            name=f"{case.name}: rendered run, |χ²/dof − 1| in its standard errors",
            value=abs(solution.reduced_chi2 - 1) / chi2_error,
            limit=3.0,
            unit="σ",
        ),
        Criterion(
            name=f"{case.name}: camera model against traced lens, over the predicted map error",
            value=case.split["model"].line_of_sight.rms_arcsec
            / case.reductions["estimated"].line_of_sight.predicted_rms_arcsec,
            limit=0.1,
        ),
    ]


def criteria(result: Result) -> list[Criterion]:
    """What has to hold."""
    lost = sum(case.monte_carlo.lost for case in result.cases)
    lost += sum(not r.calibration.converged for case in result.cases for r in case.reductions.values())
    narrow = result.field_sweep[0]
    closed = closed_form_px(narrow.field_deg, result.field_sigma_px)
    leans = result.lean_sweep
    return [
        Criterion(name="calibrations that did not converge", value=lost, limit=0),
        *(criterion for case in result.cases for criterion in _case_criteria(case)),
        Criterion(
            name=f"principal point over line of sight, per axis, at {narrow.field_deg:g}° field",
            value=point_over_line(narrow.full.of("x0_px") * narrow.arcsec_per_px, narrow.full.map_sigma_arcsec),
            limit=100.0,
            relation=">=",
        ),
        Criterion(
            name=f"bound against closed form at {narrow.field_deg:g}° field",
            value=abs(narrow.plain.of("x0_px") / closed - 1),
            limit=0.02,
        ),
        Criterion(
            name=f"map error at {leans[-1].lean_arcsec:g}″ of non-orthogonality over that at "
            f"{leans[0].lean_arcsec:g}″, estimated",
            value=leans[-1].estimated_arcsec / leans[0].estimated_arcsec,
            limit=SWEEP_TOLERANCE,
        ),
    ]


def unit_of(name: str) -> str:
    """Unit that the name of an unknown ends in."""
    return f"1/{name.rpartition('_per_')[2]}" if "_per_" in name else name.rpartition("_")[2]


def _case_results(result: Result, case: Case) -> dict[str, Any]:
    found, reduction = case.monte_carlo, case.reductions["estimated"]
    solution, readings = reduction.calibration.solution, case.measurement.readings
    best = case.split["model"].calibration.model
    truth = case.coordinates.truth(solution.names)
    bias = readings.position_px - case.measurement.bundle_px
    return {
        "unknowns": {
            name: {
                "truth": truth[i],
                "estimate": Measured(
                    value=float(solution.value[i]), uncertainty=float(solution.sigma[i]), unit=unit_of(name)
                ),
                "monte_carlo_rms_pull": found.pull_std[i] if found.runs else None,
            }
            for i, name in enumerate(solution.names)
        },
        "camera_model_fitted_to_rays": dict(zip(best.parameter_names, best.parameters, strict=True)),
        "reduced_chi2": {name: one.calibration.solution.reduced_chi2 for name, one in case.reductions.items()},
        "condition": solution.condition,
        "iterations": solution.iterations,
        "map_error_arcsec": {name: one.line_of_sight.rms_arcsec for name, one in case.reductions.items()},
        "map_predicted_arcsec": reduction.line_of_sight.predicted_rms_arcsec,
        "map_bound_arcsec": case.bound.map_sigma_arcsec,
        "map_monte_carlo_arcsec": Measured(value=found.map_arcsec, unit="arcsec", n=found.runs),
        "map_split_arcsec": {name: one.line_of_sight.rms_arcsec for name, one in case.split.items()},
        "noise_shares_arcsec": case.shares,
        "map_bound_if_known_arcsec": {name: one.map_sigma_arcsec for name, one in case.knowledge.items()},
        "principal_point_sigma_arcsec": principal_point_arcsec(result, case),
        "centroid_error_px": {"rms": np.sqrt((bias**2).mean(0)), "n": len(bias)},
        "centroid_predicted_px": np.sqrt(np.einsum("nii->ni", readings.covariance_px2).mean(0)),
        "star_vector_scatter_arcsec": vector_scatter_arcsec(case),
        "lost_runs": found.lost,
    }


def results(result: Result) -> dict[str, Any]:
    """``results`` of ``summary.json``."""
    return {
        **{case.name.replace("-", "_"): _case_results(result, case) for case in result.cases},
        "reading_sweep": list(result.reading_sweep),
        "reading_noise_equal_to_centroids_arcsec": crossover_arcsec(result),
        "camera_model_on_lenses": list(result.lenses),
        "lean_sweep": list(result.lean_sweep),
        "field_sweep": [
            {
                "field_deg": point.field_deg,
                "principal_point_sigma_px": point.full.of("x0_px"),
                "principal_point_sigma_arcsec": point.full.of("x0_px") * point.arcsec_per_px,
                "principal_point_inflation": point.full.inflation("x0_px"),
                "map_sigma_arcsec": point.full.map_sigma_arcsec,
                "map_sigma_rolled_arcsec": point.rolled.map_sigma_arcsec,
                "condition": point.full.condition,
            }
            for point in result.field_sweep
        ],
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }
