"""What has to hold for a budget, and what goes into its ``summary.json``."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import norm

from experiments.budget.combine import ECSS, PRINTED, TERMS, Budget, Value
from experiments.budget.result import Result
from experiments.harness.summary import Criterion, Measured

__all__ = ["criteria", "results"]

TERM_LIMIT, TOTAL_LIMIT = 0.10, 0.05
ALARM = 0.01
"""Chance that a pull criterion fails although everything is right."""
SUMS = ("LSFE", "total", "attitude")


def _limit(count: int) -> float:
    return float(norm.isf(ALARM / (2 * count)))


def criteria(result: Result) -> list[Criterion]:
    """Predicted over measured, term by term; sums; statistics of the tolerances; the document's arithmetic.

    A ratio is judged by 10 % (the total by 5 %), or by three of its own standard deviations where a run was made too
    small to tell 10 %. A term that does not stand out of its uncertainty has no ratio: its difference is judged.
    """
    found: list[Criterion] = []
    for name, limit in (*((term, TERM_LIMIT) for term in TERMS[:-1]), ("total", TOTAL_LIMIT)):
        ratio, spread = result.ratio(name)
        for axis, letter in enumerate("xy"):
            if not np.isfinite(ratio[axis]):
                continue
            own = max(limit, float(f"{3.0 * float(spread[axis]):.2g}"))
            found.append(
                Criterion(
                    name=f"{name} {letter}: predicted / measured, off 1 by", value=abs(ratio[axis] - 1.0), limit=own
                )
            )
    for name in TERMS[:-1]:
        pulls = result.pull(name)
        count = 2 * (len(result.measured.chromatic.table1_px) if name == "LSFE-S" else 1)
        found.append(
            Criterion(
                name=f"{name}: predicted minus measured, x and y, largest",
                value=float(np.abs(pulls).max()),
                limit=round(_limit(count), 2),
                unit="sigma",
            )
        )
    return [*found, *_others(result)]


def _others(result: Result) -> list[Criterion]:
    tolerance = result.tolerances
    apart = np.abs(tolerance.spread_arcsec / np.maximum(tolerance.linear_arcsec, 1e-12) - 1.0)
    found = [
        Criterion(
            name="built lenses: scatter of the chromatic entries against the sum of sensitivities, relative",
            value=float(apart.max()),
            limit=round(max(_limit(apart.size) * tolerance.spread_uncertainty, 0.05), 3),
        ),
        Criterion(
            name="document: total by eq. 31-32 from the printed terms against the printed total",
            value=float(np.abs(result.published.total.arcsec - np.array(PRINTED["total"])).max()),
            limit=0.005,
            unit="arcsec",
        ),
    ]
    within = result.config.published_within_fraction
    if within is not None:
        for name in ("TE", "HSFE", "LSFE-S", "total"):
            wanted, seen = result.published[name].arcsec, result.measured.budget[name]
            for axis, letter in enumerate("xy"):
                own = 3.0 * float(seen.uncertainty_arcsec[axis] / wanted[axis])
                found.append(
                    Criterion(
                        name=f"{name} {letter}: measured / published, off 1 by",
                        value=abs(float(seen.arcsec[axis] / wanted[axis]) - 1.0),
                        limit=max(within, float(f"{own:.2g}")),
                    )
                )
    return found


def as_measured(value: Value, axis: int) -> Measured:
    """One axis of a term."""
    return Measured(
        value=float(value.arcsec[axis]),
        unit="arcsec",
        uncertainty=float(value.uncertainty_arcsec[axis]),
        n=value.n or None,
    )


def _published(result: Result, name: str) -> Value:
    """As printed."""
    return Value(arcsec=np.array(PRINTED[name])) if name in PRINTED else result.published[name]


def _line(result: Result, name: str, axis: int) -> dict[str, Any]:
    predicted, measured = result.predicted.budget[name], result.measured.budget[name]
    ratio, spread = result.ratio(name)
    return {
        "name": name,
        "ecss": ECSS[name],
        "axis": "xy"[axis],
        "predicted_arcsec_3sigma": float(predicted.arcsec[axis]),
        "predicted_uncertainty": float(predicted.uncertainty_arcsec[axis]),
        "measured_arcsec_3sigma": float(measured.arcsec[axis]),
        "measured_uncertainty": float(measured.uncertainty_arcsec[axis]),
        "measured_n": measured.n,
        "published_arcsec_3sigma": float(_published(result, name).arcsec[axis]),
        "ratio": float(ratio[axis]),
        "ratio_uncertainty": float(spread[axis]),
    }


def _xy(values: Any) -> dict[str, float]:
    return {"x": float(values[0]), "y": float(values[1])}


def _budget(budget: Budget) -> dict[str, Any]:
    return {name: _xy(budget[name].arcsec) for name in (*TERMS, *SUMS)}


def results(result: Result) -> dict[str, Any]:
    """The ``results`` of ``summary.json``; angles in arcsec, 3 sigma, uncertainties 1 sigma."""
    sums = {name: {"xy"[axis]: _line(result, name, axis) for axis in range(2)} for name in SUMS}
    predicted, measured, study, built = result.predicted, result.measured, result.attitude, result.tolerances
    percent = [50, 90, 95, 99]
    return {
        "terms": [_line(result, name, axis) for name in TERMS for axis in range(2)],
        "lsfe": sums["LSFE"],
        "total": sums["total"],
        "attitude": {
            **sums["attitude"],
            "stars": study.stars,
            "trials": study.trials,
            "monte_carlo_arcsec_3sigma": {name: study.at[name] for name in study.at},
            "rule_arcsec_3sigma": study.rule_at,
            "layout_arcsec_3sigma": study.layout,
            "columns": ["x", "y", "roll"],
            "relative_uncertainty": study.relative_uncertainty,
        },
        "ratio": {name: _xy(result.ratio(name)[0]) for name in (*TERMS, "total")},
        "published": {
            "printed": {**{name: _xy(result.published[name].arcsec) for name in TERMS}, **PRINTED},
            "by_eq_31_32": {name: _xy(result.published[name].arcsec) for name in SUMS},
        },
        "parts": {
            "cramer_rao_te": _xy(predicted.bound_te_arcsec),
            "hsfe_causes_predicted": {name: _xy(value) for name, value in predicted.causes_arcsec.items()},
            "hsfe_single_position": {
                "predicted": _xy(predicted.single_arcsec),
                "measured": _xy(measured.single_arcsec),
            },
            "sigma_d": {"predicted": _xy(predicted.found_arcsec), "measured": _xy(measured.found_arcsec)},
            "sigma_dd": {"predicted": _xy(predicted.left_arcsec), "measured": _xy(measured.left_arcsec)},
            "c1_one_survey": {
                "measured": _xy(measured.one_survey_arcsec),
                "scatter_from_survey_to_survey": _xy(measured.survey_scatter_arcsec),
            },
            "table1_px": {
                "predicted": {name: _xy(v) for name, v in predicted.chromatic.table1_px.items()},
                "measured": {name: _xy(v) for name, v in measured.chromatic.table1_px.items()},
                "sigma": {name: _xy(v) for name, v in measured.chromatic.sigma_px.items()},
            },
        },
        "sweep": None
        if result.sweep is None
        else {
            "key": result.sweep.key,
            "value": [one.value for one in result.sweep.settings],
            "window_px": [one.window_px for one in result.sweep.settings],
            "predicted": [None if one.predicted is None else _budget(one.predicted) for one in result.sweep.settings],
            "measured": [
                None if one.measured is None else _budget(one.measured.budget) for one in result.sweep.settings
            ],
            "refused": [one.refusal for one in result.sweep.settings],
        },
        "tornado": None
        if result.tornado is None
        else [
            {
                "key": swing.key,
                "low": swing.low,
                "high": swing.high,
                "total_change_arcsec": swing.change("total", result.tornado.base),
            }
            for swing in result.tornado.swings
        ],
        "tolerances": {
            "lenses": len(built.chromatic_arcsec),
            "lost": built.lost,
            "percentiles": percent,
            "chromatic_arcsec_3sigma": np.percentile(built.chromatic_arcsec, percent, axis=0),
            "distortion_residual_arcsec_3sigma": np.percentile(built.distortion_arcsec, percent, axis=0),
            "lsfe_arcsec_3sigma": np.percentile(built.lsfe_arcsec, percent, axis=0),
            "uncalibrated_arcsec_3sigma": np.percentile(built.uncalibrated_arcsec, percent, axis=0),
        },
        "changed_settings": {key: {"default": was, "here": now} for key, (was, now) in result.changed.items()},
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }
