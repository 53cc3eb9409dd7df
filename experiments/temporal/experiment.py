"""Temporal error (ACC18 eq. 1-2, Fig. 5): at the signal of the source, against signal, and star by star."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.accuracy.error_budget import ErrorTerm
from calib.accuracy.temporal import relative_scatter, small_sample_factor
from experiments.harness.drawings import cloud, curves
from experiments.harness.progress import Progress
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, agree, col, ratio_near
from experiments.harness.summary import Measured
from experiments.harness.summary import measured as with_error
from experiments.laboratory.bench.point_laboratory import (
    point_laboratory,
    point_quantities,
    point_signal,
    prepared_scene,
)
from experiments.laboratory.bench.signal import Signal
from experiments.laboratory.devices.collimator_effects import LINE_OF_SIGHT, line_of_sight
from experiments.laboratory.settings.published import ACC18_ARCSEC, is_published_sensor
from experiments.laboratory.temporal_error import (
    TemporalMeasurement,
    TemporalPrediction,
    measure_temporal,
    predict_temporal,
    star_target_directions,
)
from experiments.temporal.settings import TemporalConfig
from optics.arrays import FloatArray
from render.engine.random import Streams

Errors = Sequence[Sequence[Measured]]


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelScatter:
    """Temporal error (3 sigma) at one signal, measured and predicted without frames."""

    signal_e: float = col("Signal", "e-", ".0f", shown=False)
    magnitude_mag: float = col("V", "mag", ".2f", shown=False)
    measured_arcsec: Errors = col("Measured", "arcsec", dims="method axis")
    predicted_arcsec: FloatArray = col("Predicted", "arcsec", ".4f", "method axis")
    predicted_linear_arcsec: FloatArray = col("Predicted, linear", "arcsec", ".4f", "method axis", shown=False)
    cramer_rao_arcsec: FloatArray = col("Cramér-Rao", "arcsec", ".4f", "axis")
    ratio: Errors = col("Measured / predicted", dims="method axis")
    over_cramer_rao: Errors = col("Measured / Cramér-Rao", dims="method axis", shown=False)
    published_arcsec: Sequence[float] | None = col("Published", "arcsec", dims="axis", shown=False, default=None)


def tabulate_level(
    measured: TemporalMeasurement, predicted: TemporalPrediction, methods: Sequence[str], star: Signal, level: int = 0
) -> LevelScatter:
    """Eq. 1-2 of the frames at one level.

    E[s] = c4(N) sigma for the standard deviation s of N frames: the ratios divide the measured values by c4.
    """
    signal_e = float(measured.levels_e[level])
    c4 = small_sample_factor(measured.frames)
    terms = [measured.temporal_error(method, level) for method in methods]
    value, sigma = _stack_terms(terms)
    expected, expected_sigma = _stack_terms([predicted.sampled_error(method, level) for method in methods])
    bound = predicted.arcsec(predicted.bound_px[level])
    ratio = value / (c4 * expected)
    over_cramer_rao = value / (c4 * bound)
    count = terms[0].n
    return LevelScatter(
        signal_e=signal_e,
        magnitude_mag=star.magnitude_of(signal_e),
        measured_arcsec=with_error(value, sigma, n=count, unit="arcsec"),
        predicted_arcsec=expected,
        predicted_linear_arcsec=np.array([predicted.arcsec(predicted.linear_px[method][level]) for method in methods]),
        cramer_rao_arcsec=bound,
        ratio=with_error(ratio, ratio * np.hypot(sigma / value, expected_sigma / expected), n=count),
        over_cramer_rao=with_error(over_cramer_rao, over_cramer_rao * sigma / value, n=count),
    )


def _stack_terms(terms: Sequence[ErrorTerm]) -> tuple[FloatArray, FloatArray]:
    """Values and standard deviations (term, axis)."""
    return np.array([term.arcsec for term in terms]), np.array([term.uncertainty_arcsec for term in terms])


@dataclass(frozen=True, slots=True, kw_only=True)
class StarScatter:
    """Standard deviation of a star's centroid at the signal of the source, first centroider, per axis."""

    light_px: FloatArray = col("Centroid of the light", "px", dims="axis")
    sigma_px: Sequence[Measured] = col("Measured σ", "px", dims="axis")
    predicted_px: FloatArray = col("Predicted σ", "px", dims="axis")
    cramer_rao_px: FloatArray = col("Cramér-Rao σ", "px", dims="axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """Test conditions, and the frames at the signal of the source."""

    frames: int = col("Frames")
    stars: int = col("Stars")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec")
    signal_star: str = col("Star")
    deviation_arcsec: FloatArray = col("Centroids about their mean", "arcsec", dims="frame star axis")


def tabulate_stars(measured: TemporalMeasurement, predicted: TemporalPrediction, method: str) -> list[StarScatter]:
    """Every star at the first level."""
    expected_px = predicted.sampled_px[method][0]
    uncertainty_px = expected_px * small_sample_factor(measured.frames) * relative_scatter(measured.frames)
    sigma_px = with_error(measured.sigma_px[method][0], uncertainty_px)
    rows = zip(measured.light.photon_px, sigma_px, expected_px, predicted.bound_px[0], strict=True)
    return [
        StarScatter(light_px=light, sigma_px=sigma, predicted_px=expected, cramer_rao_px=bound)
        for light, sigma, expected, bound in rows
    ]


def axes(config: TemporalConfig) -> Quantities:
    """Dimensions that all sections share."""
    return point_quantities(config.methods)


def _true_levels_e(config: TemporalConfig, streams: Streams) -> FloatArray:
    """Commanded signals, each with a log-normal setting error of the source."""
    brightness = config.brightness
    commanded_e = np.geomspace(brightness.lowest_e, brightness.highest_e, brightness.levels)
    normal_deviates = streams.generator("brightness").standard_normal(len(commanded_e))
    return commanded_e * np.exp(brightness.setting_error_ratio * normal_deviates)


def run(config: TemporalConfig, *, progress: Progress) -> dict[str, Any]:
    """Measure and predict the temporal error against signal and at the signal of the source."""
    bench, instrument = point_laboratory(config, config.target)
    streams = Streams(config.seed).child("temporal")
    methods = config.methods
    levels_e = _true_levels_e(config, streams)
    scene = prepared_scene(
        bench, instrument, star_target_directions(bench, instrument, config.place_px)[None], progress
    )
    with progress.stage("frames", total=len(levels_e) + 1) as stage:
        test: dict[str, Any] = {"scene": scene, "place_px": config.place_px, "advance": stage.advance}
        measured = measure_temporal(bench, instrument, levels_e=levels_e, streams=streams, **test)
        nominal = measure_temporal(bench, instrument, streams=streams.child("nominal"), **test)
    with progress.stage("prediction"):
        model: dict[str, Any] = {"psf": nominal.light.psf, "draws": config.draws, "place_px": config.place_px}
        predicted = predict_temporal(bench, instrument, levels_e=levels_e, seed=config.seed, **model)
        at_nominal = predict_temporal(bench, instrument, seed=config.seed + 1, **model)
    star = point_signal(config, instrument)
    centroids_px = nominal.position_px[methods[0]][0]
    motion_px2 = np.concatenate([measured.motion_px2, nominal.motion_px2])
    published: dict[str, Any] = {"published_arcsec": ACC18_ARCSEC["TE"]} if is_published_sensor(config) else {}
    return {
        "test": Conditions(
            frames=nominal.frames,
            stars=len(nominal.light),
            pixel_arcsec=instrument.pixel_arcsec,
            signal_star=star.star,
            deviation_arcsec=instrument.pixel_arcsec * (centroids_px - np.nanmean(centroids_px, axis=0)),
        ),
        "nominal": replace(tabulate_level(nominal, at_nominal, methods, star), **published),
        "levels": [tabulate_level(measured, predicted, methods, star, level) for level in range(len(levels_e))],
        "stars": tabulate_stars(nominal, at_nominal, methods[0]),
        "line_of_sight": line_of_sight(bench, instrument, motion_px2),
    }


NOTE = (
    "Standard deviations of N frames are low by the factor c4(N); ratios are corrected for it, measured values are "
    "not (as in ACC18)."
)
SECTIONS = {
    "test": Section(
        record=Conditions,
        figures={
            "frame_cloud": cloud(
                "deviation_arcsec", ellipses="nominal.predicted_arcsec nominal.cramer_rao_arcsec", at={"method": 0}
            ),
        },
    ),
    "nominal": Section(
        record=LevelScatter,
        table="temporal_error",
        caption="Temporal error (3 σ) of one star at the signal of the source.",
        note=NOTE,
        verdicts=[
            ratio_near(
                "ratio",
                within=0.05,
                at={"method": 0},
                title="temporal error at the signal of the source over prediction",
            ),
        ],
    ),
    "levels": Section(
        record=LevelScatter,
        dim="level",
        along="signal_e",
        caption="Temporal error (3 σ) against signal.",
        note=NOTE,
        figures={
            "level_curves": curves(
                "level",
                points="measured_arcsec",
                lines="predicted_arcsec",
                by="method",
                panels="axis",
                floor="cramer_rao_arcsec",
                dashes="nominal.published_arcsec",
                log="xy",
                y="Temporal error, 3 σ",
            ),
            "ratio_plot": curves(
                "level",
                points="ratio",
                by="method",
                panels="axis",
                level=1.0,
                band=0.1,
                log="x",
                aspect_ratio=0.36,
            ),
        },
        verdicts=[
            agree("ratio", 1.0, each="method", title="temporal error over all levels against prediction"),
            ratio_near(
                "over_cramer_rao",
                within=0.02,
                at={"method": "epsf"},
                mean=True,
                title="temporal error over the Cramér-Rao bound",
            ),
        ],
    ),
    "stars": Section(
        record=StarScatter,
        dim="star",
        across="axis",
        caption="Standard deviation of each star at the signal of the source, first centroider.",
    ),
    "line_of_sight": LINE_OF_SIGHT,
}
