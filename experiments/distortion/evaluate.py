"""Criteria and numbers of the distortion test."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.distortion.result import MARKING_ARCSEC, PUBLISHED_ARCSEC, Result
from experiments.harness.summary import Criterion
from experiments.laboratory.distortion_model import MapForecast
from experiments.laboratory.distortion_statistics import REFERENCES, Reference
from optics.arrays import FloatArray

__all__ = [
    "STATISTICS",
    "criteria",
    "expected_forecast",
    "noise_removed_arcsec",
    "one_survey",
    "over_surveys",
    "results",
]


STATISTICS = ("sigma_d", "sigma_left", "sigma_c1")
"""Found, left, removed."""


def one_survey(result: Result, method: str, reference: Reference) -> FloatArray:
    """The document's numbers (3, 2) of the survey that counts, arcsec, 3 sigma."""
    s = result.measured.statistics(method, reference)
    return result.scale * np.stack([s.sigma_d_px, s.sigma_left_px, s.sigma_c1_px])


def over_surveys(result: Result, method: str, reference: Reference) -> tuple[FloatArray, FloatArray]:
    """RMS and scatter (3, 2) over the surveys, arcsec, 3 sigma."""
    every = result.scale * result.measured.over_surveys(method, reference)
    return np.sqrt((every**2).mean(0)), every.std(0, ddof=1)


def noise_removed_arcsec(result: Result) -> float:
    """What a polynomial removes of nothing but marking error, 3 sigma: sqrt((k - 1) / (W - 1)) of it."""
    config = result.config
    points, terms = config.target.rows * config.target.columns, (config.order + 1) * (config.order + 2) // 2
    return float(3.0 * config.target.marking_error_arcsec * np.sqrt((terms - 1) / (points - 1)))


def expected_forecast(result: Result) -> MapForecast:
    """The forecast of the configured target and order."""
    points = result.config.target.rows * result.config.target.columns
    return next(one for one in result.forecast if (one.points, one.order) == (points, result.config.order))


def criteria(result: Result) -> list[Criterion]:
    """What has to hold for the run to count as passed."""
    found = []
    for method in result.config.methods:
        for reference in REFERENCES:
            expected, spread = (
                result.scale * values[method][reference]
                for values in (result.predicted.mean_px, result.predicted.scatter_px)
            )
            pull = np.abs(one_survey(result, method, reference) - expected) / spread
            found.append(
                Criterion(
                    name=f"{method}, {reference}: found, left and removed against prediction, one survey, largest "
                    "deviation",
                    value=float(pull.max()),
                    limit=4.0,
                    unit="sigma",
                )
            )
        expected = result.scale * result.predicted.mean_px[method][result.config.reference]
        mean, _ = over_surveys(result, method, result.config.reference)
        found.append(
            Criterion(
                name=f"{method}, {result.config.reference}: RMS over surveys over prediction, off 1 by",
                value=float(np.abs(mean / expected - 1.0).max()),
                limit=0.1 + 3.0 * _sampling(result),
            )
        )
    first = result.config.methods[0]
    same = [one_survey(result, first, reference)[1] for reference in ("nominal", "aligned")]
    found.append(
        Criterion(
            name="what is left does not depend on scale, roll and shift of the coordinates",
            value=float(np.abs(same[0] - same[1]).max()),
            limit=1e-3,
            unit="arcsec",
        )
    )
    forecast, maps = expected_forecast(result), result.maps["aligned"].rms_px
    seen = np.sqrt((maps**2).mean(0))
    found.append(
        Criterion(
            name="true map error over all surveys against its forecast, off 1 by",
            value=float(np.abs(seen / forecast.rms_px - 1.0).max()),
            limit=0.1 + 3.0 * _sampling(result),
        )
    )
    return found


def _sampling(result: Result) -> float:
    """Relative uncertainty of an RMS over surveys and of one over draws, each with about nine degrees of freedom."""
    return float(np.sqrt(1.0 / (18.0 * result.config.surveys) + 1.0 / (18.0 * result.config.draws)))


def _xy(values: Any) -> dict[str, float]:
    return {"x": float(values[0]), "y": float(values[1])}


def results(result: Result) -> dict[str, Any]:
    """The ``results`` of ``summary.json``."""
    every: dict[str, Any] = {}
    for method in result.config.methods:
        every[method] = {}
        for reference in REFERENCES:
            one, (mean, spread) = one_survey(result, method, reference), over_surveys(result, method, reference)
            expected = result.scale * result.predicted.mean_px[method][reference]
            every[method][reference] = {
                name: {
                    "one_survey": _xy(one[n]),
                    "over_surveys": _xy(mean[n]),
                    "scatter_of_surveys": _xy(spread[n]),
                    "predicted": _xy(expected[n]),
                }
                for n, name in enumerate(STATISTICS)
            }
    first, forecast = result.config.methods[0], expected_forecast(result)
    return {
        "sigma_c1_arcsec_3sigma": every[first][result.config.reference]["sigma_c1"],
        "published_sigma_c1_arcsec_3sigma": _xy(PUBLISHED_ARCSEC),
        "marking_error_arcsec_3sigma": 3.0 * result.config.target.marking_error_arcsec,
        "published_marking_error_arcsec_3sigma": MARKING_ARCSEC,
        "sigma_c1_of_marking_error_alone_arcsec_3sigma": noise_removed_arcsec(result),
        "methods_arcsec_3sigma": every,
        "true_map_arcsec_3sigma": {
            reference: {
                "uncorrected": _xy(result.scale * one.first.uncorrected_rms_px),
                "one_survey": _xy(result.scale * one.first.rms_px),
                "over_surveys": _xy(result.scale * np.sqrt((one.rms_px**2).mean(0))),
            }
            for reference, one in result.maps.items()
        },
        "forecast_map_arcsec_3sigma": _xy(result.scale * forecast.rms_px),
        "forecasts": [
            {
                "points": one.points,
                "order": one.order,
                "distortion_left_arcsec_3sigma": _xy(result.scale * one.bias_px),
                "errors_carried_arcsec_3sigma": _xy(result.scale * one.noise_px),
            }
            for one in result.forecast
        ],
        "points": result.config.target.rows * result.config.target.columns,
        "frames": result.measured.frames,
        "pixel_arcsec": result.instrument.pixel_arcsec,
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }
