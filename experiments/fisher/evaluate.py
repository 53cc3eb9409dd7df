"""What the experiment on star vectors says in numbers: summary and criteria."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import norm, t

from experiments.fisher.bench import Case
from experiments.fisher.coverage import LEVELS
from experiments.fisher.field import Ratio, baseline_over_sphere, closed_form, opposite_form
from experiments.fisher.predict import table_covariance_px2
from experiments.fisher.result import Result
from experiments.fisher.same import Mean
from experiments.harness.summary import Criterion, Measured

__all__ = ["LEVEL", "baseline_expected", "criteria", "results", "vectors_needed"]

LEVEL = 0.95
CHANCE = 1e-3
"""That a criterion on many numbers fails by chance (Bonferroni)."""
DIGITS_AT_ARCSEC = 0.1
DIGITS_LIMIT = 1e-6
SAME_VECTORS_LIMIT = 5e-4


def vectors_needed(excess: float) -> float:
    """Star vectors for which the 95 % interval of sigma is as narrow as a bias: 1.96/(2 sqrt n) = excess."""
    return float((norm.isf((1.0 - LEVEL) / 2.0) / 2.0 / abs(excess)) ** 2)


def baseline_expected(result: Result, case: Case) -> float:
    """Pixel method over Fisher as covariances and the lens predict it, with the calibrated angle per pixel."""
    taken, run = case.acquisition, result.bench
    motion = taken.places.motion
    noise = np.array(taken.covariance_px2)
    noise = noise + table_covariance_px2(run.model, run.bench, taken.places.reading_rad, motion)
    return baseline_over_sphere(run.model, np.array(taken.position_px), noise)


def _worst(values: Sequence[float]) -> float:
    return float(np.max(np.abs(values))) if len(values) else float("nan")


def _normal_limit(tests: int) -> float:
    return float(norm.isf(CHANCE / 2 / max(tests, 1)))


def _t_limit(tests: int, runs: int) -> float:
    return float(t.isf(CHANCE / 2 / max(tests, 1), max(runs - 1, 1)))


def _off(ratio: Ratio | Mean, expected: float) -> float:
    mean = ratio.mean if isinstance(ratio, Ratio) else ratio.value
    return (mean - expected) / ratio.error


def _ratio_limit(case: Case) -> float:
    """Both methods take the same mean off, unless the camera is rolled: then chance alone makes some 1/n of them."""
    places = case.acquisition.places
    rolled = places.true_rad.shape[1] > 2
    return 3.0 / len(places) if rolled else SAME_VECTORS_LIMIT


def _bench_criteria(result: Result) -> list[Criterion]:
    run = result.bench
    return [
        Criterion(
            name="places without a position, calibrations without convergence",
            value=sum(case.acquisition.lost for case in run.cases) + sum(p.lost for p in result.same_data),
            limit=0,
        ),
        *(
            Criterion(
                name=f"{case.acquisition.name}: scatter of the star vectors against the prediction from covariances",
                value=abs(case.predicted.z_score(case.evaluation.fit.chord_sum_rad2)),
                limit=3.0,
                unit="σ",
            )
            for case in run.cases
        ),
        *(
            Criterion(
                name=f"{case.acquisition.name}: pixel method over Fisher, against what lens and noise predict",
                value=abs(
                    case.evaluation.baseline_arcsec(run.resolutions_arcsec["calibrated"])
                    / case.evaluation.sigma_arcsec
                    / baseline_expected(result, case)
                    - 1.0
                ),
                limit=_ratio_limit(case),
            )
            for case in run.cases
        ),
        Criterion(
            name="static, calibrated with its own data: scatter against the prediction",
            value=abs(run.same_data.predicted.z_score(run.same_data.naive.fit.chord_sum_rad2)),
            limit=3.0,
            unit="σ",
        ),
    ]


def criteria(result: Result) -> list[Criterion]:
    """What has to hold."""
    field, same = result.field_sweep, result.same_data
    field_limit = _t_limit(len(field), result.config.field.runs)
    same_limit = _t_limit(len(same), result.config.same_data.runs)
    fisher = [p for p in result.coverage if p.kind in ("fisher", "moderate")]
    off = [(c - level) / e for p in fisher for c, level, e in zip(p.covered, LEVELS, p.error, strict=True)]
    return [
        *_bench_criteria(result),
        Criterion(
            name="bias of the pixel method against its closed form, all fields",
            value=_worst([_off(p.baseline, closed_form(p.field_deg)) for p in field]),
            limit=field_limit,
            unit="standard errors",
        ),
        Criterion(
            name="Fisher against the truth, all fields",
            value=_worst([_off(p.fisher, 1.0) for p in field]),
            limit=field_limit,
            unit="standard errors",
        ),
        Criterion(
            name="noise isotropic in pixels: Fisher over pixel method against quadrature, all fields",
            value=_worst([_off(p.opposite_fisher, opposite_form(p.field_deg)) for p in field]),
            limit=field_limit,
            unit="standard errors",
        ),
        Criterion(
            name=f"coverage of the {LEVELS[0]:.0%} and {LEVELS[1]:.0%} intervals, Fisher distribution",
            value=_worst(off),
            limit=_normal_limit(len(off)),
            unit="standard errors",
        ),
        Criterion(
            name="same data, 2n − unknowns degrees of freedom: variance against the truth",
            value=_worst([_off(p.corrected, 1.0) for p in same]),
            limit=same_limit,
            unit="standard errors",
        ),
        Criterion(
            name="same data, 2(n − 1) degrees of freedom: variance against the prediction",
            value=_worst([_off(p.naive, p.predicted_naive) for p in same]),
            limit=same_limit,
            unit="standard errors",
        ),
        Criterion(
            name="data of their own: variance against the prediction",
            value=_worst([_off(p.independent, p.predicted_independent) for p in same]),
            limit=same_limit,
            unit="standard errors",
        ),
        Criterion(
            name=f"concentration at {DIGITS_AT_ARCSEC:g}″ against 50 digits, relative",
            value=max(p.chords for p in result.digits if p.sigma_arcsec >= DIGITS_AT_ARCSEC),
            limit=DIGITS_LIMIT,
        ),
    ]


def _case_results(result: Result, case: Case) -> dict[str, Any]:
    judged, run = case.evaluation, result.bench
    fit = judged.fit
    return {
        "n": fit.count,
        "outliers": int(judged.outlier.sum()),
        "one_minus_resultant_length": fit.deficit,
        "concentration_document": fit.concentration_document,
        "concentration": fit.concentration,
        "concentration_unbiased": fit.concentration_unbiased,
        "concentration_interval_95": fit.concentration_interval(LEVEL),
        "sigma_arcsec": Measured(
            value=judged.sigma_arcsec,
            unit="arcsec",
            uncertainty=judged.sigma_arcsec / float(np.sqrt(2 * fit.degrees_of_freedom)),
            n=fit.count,
        ),
        "sigma_interval_95_arcsec": judged.interval_arcsec(LEVEL),
        "sigma_predicted_arcsec": case.predicted.sigma_arcsec,
        "z_score": case.predicted.z_score(fit.chord_sum_rad2),
        "sigma_without_table_arcsec": case.camera_arcsec,
        "expected_arcsec": dict(case.expected_arcsec),
        "realised_arcsec": dict(case.realised_arcsec),
        "baseline_arcsec": {k: judged.baseline_arcsec(v) for k, v in run.resolutions_arcsec.items()},
        "baseline_over_fisher": judged.baseline_arcsec(run.resolutions_arcsec["calibrated"]) / judged.sigma_arcsec,
        "baseline_over_fisher_predicted": baseline_expected(result, case),
        "sigma_interval_95_own_degrees_arcsec": judged.own_interval_arcsec(LEVEL),
        "effective_degrees": judged.effective_degrees,
        "isotropy_p_value": judged.isotropy.p_value,
        "isotropy_ratio": judged.isotropy.ratio,
        "exponential_statistic": judged.tails.statistic,
        "streak_px": case.smear_px,
    }


def results(result: Result) -> dict[str, Any]:
    """``results`` of ``summary.json``."""
    run = result.bench
    return {
        **{case.acquisition.name: _case_results(result, case) for case in run.cases},
        "same_data_rendered": {
            "unknowns": run.same_data.unknowns,
            "naive_arcsec": run.same_data.naive.sigma_arcsec,
            "corrected_arcsec": run.same_data.corrected.sigma_arcsec,
            "predicted_naive_arcsec": run.same_data.predicted.sigma_arcsec,
        },
        "resolutions_arcsec": dict(run.resolutions_arcsec),
        "field_sweep": [
            {
                "field_deg": p.field_deg,
                "baseline_bias_percent": Measured(
                    value=p.baseline.percent, unit="percent", uncertainty=p.baseline.percent_error
                ),
                "closed_form_percent": 100 * (closed_form(p.field_deg) - 1),
                "fisher_bias_percent": Measured(
                    value=p.fisher.percent, unit="percent", uncertainty=p.fisher.percent_error
                ),
                "wrong_resolution_percent": p.wrong_resolution.percent,
                "field_over_pixels_percent": p.field_over_pixels.percent,
                "pixel_noise_fisher_percent": Measured(
                    value=p.opposite_fisher.percent, unit="percent", uncertainty=p.opposite_fisher.percent_error
                ),
                "pixel_noise_quadrature_percent": 100 * (opposite_form(p.field_deg) - 1),
                "vectors_needed": vectors_needed(closed_form(p.field_deg) - 1),
            }
            for p in result.field_sweep
        ],
        "coverage": list(result.coverage),
        "same_data": list(result.same_data),
        "digits": list(result.digits),
        "table_sweep": list(result.table_sweep),
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }
