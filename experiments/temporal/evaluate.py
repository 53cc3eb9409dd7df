"""Criteria and numbers of the temporal-error test."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import norm

from experiments.harness.summary import Criterion, Measured
from experiments.laboratory.temporal_error import (
    TemporalMeasurement,
    TemporalPrediction,
    small_sample_factor,
)
from experiments.temporal.result import PUBLISHED_ARCSEC, Result
from optics.arrays import FloatArray

__all__ = ["bound_ratio", "criteria", "ratio", "results"]


def ratio(
    measured: TemporalMeasurement, predicted: TemporalPrediction, method: str, level: int
) -> tuple[Measured, Measured]:
    """Measured over predicted (drawn noise, small-sample factor included), x and y.

    The uncertainty holds the N frames, the finite draws and the difference from chip to chip.
    """
    c4 = small_sample_factor(measured.frames)
    expected, spread = predicted.sampled_te_arcsec(method, level) * c4, predicted.te_uncertainty_arcsec(method, level)
    out = []
    for axis, one in enumerate(measured.te_arcsec(method, level)):
        value = one.value / float(expected[axis])
        error = value * np.hypot((one.uncertainty or 0.0) / one.value, spread[axis] * c4 / expected[axis])
        out.append(Measured(value=value, uncertainty=float(error), n=one.n))
    return out[0], out[1]


def bound_ratio(result: Result, level: int) -> FloatArray:
    """ePSF fit over Cramer-Rao bound (2,)."""
    c4 = small_sample_factor(result.measured.frames)
    found = np.array([one.value for one in result.measured.te_arcsec("epsf", level)])
    return np.asarray(found / (c4 * result.predicted.bound_te_arcsec(level)))


def _pulls(result: Result, method: str) -> FloatArray:
    """(measured / predicted - 1) over its uncertainty (l, 2)."""
    rows = [ratio(result.measured, result.predicted, method, level) for level in range(len(result.measured.levels_e))]
    return np.array([[(one.value - 1.0) / (one.uncertainty or np.nan) for one in row] for row in rows])


def criteria(result: Result) -> list[Criterion]:
    """What has to hold for the run to count as passed; limits leave a chance of one in a hundred each."""
    found = []
    for method in result.config.methods:
        pulls = _pulls(result, method)
        found.append(
            Criterion(
                name=f"{method}: measured against predicted over all levels, largest deviation",
                value=float(np.abs(pulls).max()),
                limit=float(norm.isf(0.01 / (2 * pulls.size))),
                unit="sigma",
            )
        )
    first = result.config.methods[0]
    for axis, one in zip("xy", ratio(result.nominal, result.predicted_nominal, first, 0), strict=True):
        found.append(
            Criterion(
                name=f"{first}, {axis}: measured over predicted at the signal of the source, off 1 by",
                value=abs(one.value - 1.0),
                limit=max(0.1, 3.0 * (one.uncertainty or 0.0)),
            )
        )
    if "epsf" in result.config.methods:
        levels = range(len(result.measured.levels_e))
        best = np.array([bound_ratio(result, level) for level in levels])
        spread = max(ratio(result.measured, result.predicted, "epsf", level)[0].uncertainty or 0.0 for level in levels)
        found.append(
            Criterion(
                name="ePSF fit against the Cramer-Rao bound, mean over levels and axes, off 1 by",
                value=float(abs(best.mean() - 1.0)),
                limit=float(0.02 + 3.0 * spread / np.sqrt(best.size)),
            )
        )
    return found


def _xy(values: Any) -> dict[str, float]:
    return {"x": float(values[0]), "y": float(values[1])}


def _measured_xy(values: tuple[Measured, Measured]) -> dict[str, Measured]:
    return {"x": values[0], "y": values[1]}


def results(result: Result) -> dict[str, Any]:
    """The ``results`` of ``summary.json``."""
    measured, predicted = result.measured, result.predicted
    return {
        "temporal_error_arcsec_3sigma": {m: _measured_xy(result.nominal.te_arcsec(m)) for m in result.config.methods},
        "raw_arcsec_3sigma": {m: _measured_xy(result.nominal.te_arcsec(m, 0, "raw")) for m in result.config.methods},
        "predicted_arcsec_3sigma": {
            m: _xy(result.predicted_nominal.sampled_te_arcsec(m)) for m in result.config.methods
        },
        "predicted_linear_arcsec_3sigma": {
            m: _xy(result.predicted_nominal.te_arcsec(m)) for m in result.config.methods
        },
        "cramer_rao_arcsec_3sigma": _xy(result.predicted_nominal.bound_te_arcsec()),
        "ratio": {
            m: _measured_xy(ratio(result.nominal, result.predicted_nominal, m, 0)) for m in result.config.methods
        },
        "published_arcsec_3sigma": _xy(PUBLISHED_ARCSEC),
        "signal_that_gives_the_published_e": {m: _xy(v) for m, v in result.published_level_e.items()},
        "signal_e": result.config.source.signal_e,
        "levels": [
            {
                "signal_e": float(level),
                "methods": {
                    m: {
                        "measured": _measured_xy(measured.te_arcsec(m, n)),
                        "raw": _measured_xy(measured.te_arcsec(m, n, "raw")),
                        "predicted": _xy(predicted.sampled_te_arcsec(m, n)),
                        "linear": _xy(predicted.te_arcsec(m, n)),
                    }
                    for m in result.config.methods
                },
                "cramer_rao": _xy(predicted.bound_te_arcsec(n)),
            }
            for n, level in enumerate(measured.levels_e)
        ],
        "frames": measured.frames,
        "stars": int(measured.light.photon_px.shape[0]),
        "pixel_arcsec": measured.pixel_arcsec,
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }
