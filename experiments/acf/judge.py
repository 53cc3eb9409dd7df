"""What has to hold, and what goes into ``summary.json``."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import norm

from experiments.acf.evaluate import (
    Comparison,
    Gains,
    Pulls,
    Runs,
    comparison,
    counts,
    failures,
    fig3,
    fig4,
    gains,
    pulls,
    table2_runs,
)
from experiments.acf.pixels import pixel_criteria, pixel_results
from experiments.acf.published import FIG4_RMS_PX, RUNS, TABLE2_CALIBRATED, TABLE2_NAMES, TABLE2_TRUE, TABLE2_UNITS
from experiments.acf.result import Result
from experiments.harness.summary import Criterion, Measured
from optics.arrays import FloatArray

__all__ = ["criteria", "degrees_of", "own_misses", "results", "worse_by"]


PULL_LIMIT = 0.10
CAMERA, EVERY = slice(0, 8), slice(0, 14)
SIGHT_FREEDOM = 4.0
"""The line-of-sight map has five or so independent shapes of unequal size; as many squares as this scatter alike."""


def criteria(result: Result) -> list[Criterion]:
    """What has to hold for the run to count as passed."""
    compared, pulled = comparison(result), pulls(result)
    return [
        *_reprojection_criteria(result),
        *_pull_criteria(pulled),
        *_method_criteria(compared),
        *_gain_criteria(gains(result)),
        *pixel_criteria(result),
        Criterion(
            name="Fig. 3 to 5 and Table 2: calibrations that did not converge, all methods",
            value=float(sum(failed for failed, _ in failures(result, sweep=False).values())),
            limit=0.0,
        ),
    ]


def _two_sided(count: int, false_alarm: float = 0.01) -> float:
    """Standard deviations that the largest of ``count`` normal deviates exceeds with that probability at most."""
    return float(norm.isf(false_alarm / (2 * count)))


def _reprojection_criteria(result: Result) -> list[Criterion]:
    every = [one for row in (*fig3(result), *counts(result)) for one in row]
    table = table2_runs(result)
    sigma = degrees_of(np.sqrt(np.diag(result.forecast.table2.acc)))
    here, there = fig4(result), fig4(result, inferred=True)
    return [
        Criterion(
            name=f"Fig. 3 and star counts: mean reprojection error against its prediction, largest of {len(every)}",
            value=max(abs(one.deviation) for one in every),
            limit=_two_sided(len(every)),
            unit="sigma",
        ),
        Criterion(
            name="Fig. 4: mean reprojection error against its prediction",
            value=abs(here.runs.deviation),
            limit=3.0,
            unit="sigma",
        ),
        Criterion(
            name=f"Fig. 4: published RMS (called a mean of {RUNS} runs) against the expected mean here, in the scatter "
            "of one run, not of a mean",
            value=abs(here.published_deviation),
            limit=2.0,
            unit="sigma",
        ),
        Criterion(
            name="Fig. 4: the same, in the scatter of one run, with pixel and stars inferred from Table 2",
            value=abs(there.published_deviation),
            limit=2.0,
            unit="sigma",
        ),
        Criterion(
            name="Table 2: mean of the runs against the truth, largest of 14",
            value=float(np.abs(table.mean(0) / sigma).max() * np.sqrt(len(table))),
            limit=_two_sided(14),
            unit="sigma",
        ),
    ]


def _pull_criteria(found: Pulls) -> list[Criterion]:
    n = len(found.own)
    limit = max(PULL_LIMIT, 3.5 / np.sqrt(2 * n))  # the RMS of n unit normal numbers scatters by 1 / sqrt(2 n)
    return [
        Criterion(
            name=f"{label}: RMS pull of each of the {unknowns}, farthest from 1 (N = {n})",
            value=float(np.abs(found.rms(which)[part] - 1.0).max()),
            limit=float(limit),
        )
        for which, label, unknowns, part in (
            ("own", "ACC, own covariance (gyro taken as perfect)", "camera's 8 unknowns, angles not judged", CAMERA),
            ("carried", "ACC, not its own covariance but one with the gyro's error added", "14 unknowns", EVERY),
            ("linked", "gyro of stated noise, own covariance", "14 unknowns", EVERY),
        )
    ]


def own_misses(found: Pulls) -> dict[str, float]:
    """RMS pulls by ACC's own covariance of the unknowns that miss 10 % (for few runs, what chance allows)."""
    limit = max(PULL_LIMIT, 3.5 / np.sqrt(2 * len(found.own)))
    pairs = zip(TABLE2_NAMES, found.rms("own"), strict=True)
    return {name: float(value) for name, value in pairs if abs(value - 1.0) > limit}


def worse_by(found: dict[str, Comparison], method: str, than: str) -> dict[str, float]:
    """Ratios of RMS errors, all noises together."""
    a, b = found[method], found[than]
    return {
        "x0": float(a.pooled[0] / b.pooled[0]),
        "y0": float(a.pooled[1] / b.pooled[1]),
        "f": float(a.pooled[2] / b.pooled[2]),
        "distortion": float(np.mean(a.distortion_px / b.distortion_px)),
        "line_of_sight": float(np.mean(a.sight_arcsec / b.sight_arcsec)),
    }


def _method_criteria(found: dict[str, Comparison]) -> list[Criterion]:
    full, free, acc = found["iac_full"], found["free"], found["acc"]
    pairs = [
        (full.camera, free.camera),
        (full.distortion_px, free.distortion_px),
        (full.sight_arcsec, free.sight_arcsec),
    ]
    assert acc.expected_sight_arcsec is not None
    squares = float(np.mean((acc.sight_arcsec / acc.expected_sight_arcsec) ** 2))
    n = acc.runs * len(acc.sight_arcsec)
    return [
        Criterion(
            name="Fig. 5: unweighted IAC over ACC, least ratio of RMS errors (x0, y0, f, distortion, line of sight)",
            value=min(worse_by(found, "iac", "acc").values()),
            limit=1.0,
            relation=">",
        ),
        Criterion(
            name="Fig. 5: fully weighted IAC against free attitudes, largest difference of RMS errors",
            value=float(max(np.abs(a / b - 1.0).max() for a, b in pairs)),
            limit=0.03,
        ),
        Criterion(
            name=f"Fig. 5: line-of-sight error of ACC against its prediction, off 1 by (N = {n})",
            value=abs(float(np.sqrt(squares)) - 1.0),
            limit=max(0.05, 4.0 * 0.5 * float(np.sqrt(2.0 / (SIGHT_FREEDOM * n)))),
        ),
    ]


def _gain_criteria(found: Gains) -> list[Criterion]:
    away = [
        np.abs(found.acc - found.acc_bound) / found.acc_error,
        np.abs(found.linked - found.linked_bound) / found.linked_error,
    ]
    return [
        Criterion(
            name=f"gain over free attitudes against its bound, largest of {2 * found.acc.size}",
            value=float(max(one.max() for one in away)),
            limit=_two_sided(2 * found.acc.size),
            unit="sigma",
        )
    ]


def degrees_of(values: FloatArray) -> FloatArray:
    """Numbers of the 14 unknowns with the angles in deg."""
    out = np.array(values)
    out[8:] = np.degrees(out[8:])
    return out


def _table2(result: Result) -> dict[str, Any]:
    table, expected = table2_runs(result), result.forecast.table2
    true = _truth(result)
    bound, carried = (degrees_of(np.sqrt(np.diag(one))) for one in (expected.perfect, expected.acc))
    return {
        name: {
            "unit": TABLE2_UNITS[k],
            "true": true[k],
            "published": TABLE2_CALIBRATED[k],
            "published_error": TABLE2_CALIBRATED[k] - TABLE2_TRUE[k],
            "mean": true[k] + table[:, k].mean(),
            "mean_error": table[:, k].mean(),
            "std": table[:, k].std(ddof=1),
            "bound": bound[k],
            "bound_with_gyro_error": carried[k],
            "n": len(table),
        }
        for k, name in enumerate(TABLE2_NAMES)
    }


def _truth(result: Result) -> FloatArray:
    config = result.config
    return np.concatenate([result.scene.camera.parameters, config.sky.phi_deg, config.gyro.installation_deg])


def _curves(rows: list[list[Runs]], columns: list[int]) -> dict[str, Any]:
    return {
        "rms_px": [[row[k].value for k in columns] for row in rows],
        "error_px": [[row[k].error for k in columns] for row in rows],
        "expected_px": [[row[k].expected for k in columns] for row in rows],
    }


def _fig3(result: Result) -> dict[str, Any]:
    config, rows = result.config, fig3(result)
    biases = len(config.bias_deg_per_h)
    walks = len(config.angle_random_walk_deg_per_sqrt_h)
    return {
        "fig3a": {
            "noise_px": config.noise_px,
            "bias_deg_per_h": (0.0, *config.bias_deg_per_h),
            "n": config.runs,
            **_curves(rows, list(range(biases + 1))),
        },
        "fig3b": {
            "noise_px": config.noise_px,
            "angle_random_walk_deg_per_sqrt_h": (0.0, *config.angle_random_walk_deg_per_sqrt_h),
            "n": config.runs,
            **_curves(rows, [0, *range(biases + 1, biases + walks + 1)]),
        },
    }


def _fig4(result: Result, *, inferred: bool) -> dict[str, Any]:
    found = fig4(result, inferred=inferred)
    return {
        "rms_px": {"x": found.rms_px[0], "y": found.rms_px[1]},
        "error_px": {"x": found.error_px[0], "y": found.error_px[1]},
        "expected_px": {"x": found.expected_px[0], "y": found.expected_px[1]},
        "published_px": {"x": FIG4_RMS_PX[0], "y": FIG4_RMS_PX[1]},
        "mean_rms_length_px": Measured(value=found.runs.value, unit="px", uncertainty=found.runs.error, n=found.runs.n),
        "scatter_of_a_run_px": found.runs.scatter,
        "published_deviation_sigma": found.published_deviation,
        "published_deviation_sigma_of_a_mean": found.published_deviation * RUNS**0.5,
        "largest_px": found.largest_px,
        "part_below_0_04_px": found.inside,
    }


def _fig5(result: Result) -> dict[str, Any]:
    found = comparison(result)
    return {
        "noise_px": result.config.noise_px,
        "n": result.config.runs,
        **{
            method: {
                "x0_px": one.camera[:, 0],
                "y0_px": one.camera[:, 1],
                "focal_length_mm": one.camera[:, 2],
                "largest_residual_distortion_px": one.distortion_px,
                "line_of_sight_arcsec": one.sight_arcsec,
                "expected_line_of_sight_arcsec": one.expected_sight_arcsec,
            }
            for method, one in found.items()
        },
        "iac_over_acc": worse_by(found, "iac", "acc"),
        "iac_full_over_free": worse_by(found, "iac_full", "free"),
        "free_over_acc": worse_by(found, "free", "acc"),
    }


def results(result: Result) -> dict[str, Any]:
    """The ``results`` of ``summary.json``."""
    here, gained = fig4(result), gains(result)
    found, guess = pulls(result), result.inference
    covariance = result.forecast.table2.perfect
    correlation = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    return {
        "table2": _table2(result),
        **_fig3(result),
        "fig4_rms_px": {"x": here.rms_px[0], "y": here.rms_px[1]},
        "fig4": _fig4(result, inferred=False),
        "fig4_inferred": _fig4(result, inferred=True),
        "fig5": _fig5(result),
        "pulls": {
            which: dict(zip(TABLE2_NAMES, found.rms(which), strict=True)) for which in ("own", "carried", "linked")
        }
        | {"n": len(found.own), "own_outside_limit": own_misses(found)},
        "correlation": {"q1_q2": correlation[3, 4], "q1_q3": correlation[3, 5], "q2_q3": correlation[4, 5]},
        "gain_sweep": {
            "stars_per_frame": result.config.sweep.stars,
            "gyro_factor": result.config.sweep.gyro_factor,
            "n": gained.runs,
            "acc": gained.acc,
            "acc_error": gained.acc_error,
            "acc_bound": gained.acc_bound,
            "linked": gained.linked,
            "linked_error": gained.linked_error,
            "linked_bound": gained.linked_bound,
            "principal_point_acc": gained.point,
            "principal_point_acc_bound": gained.point_bound,
        },
        "inference": {
            "pixel_um": Measured(value=guess.best_um, unit="um", uncertainty=guess.sigma_um, n=11),
            "stars_per_frame": guess.best_stars,
            "stars_per_frame_range": (guess.low_stars, guess.high_stars),
            "chi2_of_11": guess.chi2,
            "chi2_of_11_at_assumed_pixel": guess.chi2_assumed,
            "stars_for_fig4": [
                {
                    "pixel_um": one.pixel_um,
                    "closed_form": one.closed_form,
                    "with_gyro": one.with_gyro,
                    "range": (one.low, one.high),
                }
                for one in result.forecast.matching
            ],
        },
        "stars_per_frame": result.stars_per_frame,
        "rendered": pixel_results(result),
        "not_converged": {
            part: {method: {"failed": failed, "n": n} for method, (failed, n) in failures(result, sweep=sweep).items()}
            for part, sweep in (("figures", False), ("gain_sweep", True))
        },
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }
