"""Distortion error (ACC18 eq. 17-30, Fig. 8): a surveyed grid, its residuals, the polynomial, and the true map.

Mean centroids of a grid target over the whole detector minus surveyed coordinates are reduced as printed. The three
numbers sigma_d (before the polynomial), sigma_Dd (after it) and sigma_C1 (removed by it) are predicted by ray trace,
and compared with the true error of the correction between the points. `wide_field` repeats the test with dominant
distortion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.accuracy.distortion import LABELS, REFERENCES, grid_residual_px
from experiments.distortion.settings import DistortionConfig
from experiments.distortion.wide_field import WIDE, run_wide_field, tabulate_wide_field
from experiments.harness.drawings import arrows
from experiments.harness.progress import Progress
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, agree, below, col, ratio_near
from experiments.harness.summary import measured
from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.point_laboratory import (
    point_laboratory,
    point_quantities,
    point_signal,
    prepared_scene,
)
from experiments.laboratory.devices.target import grid_directions
from experiments.laboratory.distortion_error import (
    DistortionMeasurement,
    dense_grid,
    grid_position,
    measure_distortion,
    traced_bundles,
)
from experiments.laboratory.distortion_model import DistortionPrediction, predict_distortion, predict_map
from experiments.laboratory.settings.published import ACC18_ARCSEC, is_published_sensor
from optics.arrays import FloatArray
from render.detector.maps import sensor_maps
from render.engine.random import Streams
from render.sensor_file.instrument import Instrument

SIGMA_C1 = 2
"""Index of sigma_C1 in sigma_d, sigma_Dd, sigma_C1."""
COEFFICIENTS_PER_AXIS = 9
"""Coefficients of the cubic per axis without the constant, which the comparison of maps ignores."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DistortionNumbers:
    """sigma_d, sigma_Dd and sigma_C1 of ACC18 by a centroider, 3 sigma, by conversion of coordinates to pixels."""

    single_survey_arcsec: FloatArray = col("One survey", "arcsec", ".3f", "reference number axis")
    # RMS over independent surveys of the same target, same frames; scatter from survey to survey
    all_surveys_arcsec: FloatArray = col("All surveys", "arcsec", ".3f", "reference number axis")
    survey_scatter_arcsec: FloatArray = col("Scatter of surveys", "arcsec", ".3f", "reference number axis")
    predicted_arcsec: Any = col("Predicted", "arcsec", dims="reference number axis")


def tabulate_numbers(frames: DistortionMeasurement, predicted: DistortionPrediction, method: str) -> DistortionNumbers:
    """Eq. 19-30 with the first survey and with all of them, and the prediction."""
    scale = frames.arcsec_3sigma
    surveys = len(frames.surveyed)
    # (reference, survey, number, axis)
    sigma = scale * np.array([frames.over_surveys(method, reference) for reference in REFERENCES])
    expected = scale * np.array([predicted.mean_px[method][reference] for reference in REFERENCES])
    scatter = scale * np.array([predicted.of_surveys_px(method, reference, surveys) for reference in REFERENCES])
    return DistortionNumbers(
        single_survey_arcsec=sigma[:, 0],
        all_surveys_arcsec=np.sqrt((sigma**2).mean(1)),
        survey_scatter_arcsec=sigma.std(1, ddof=1),
        predicted_arcsec=measured(expected, scatter),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RemovedPart:
    """The published number, sigma_C1 (3 sigma), by main centroider and configured reference."""

    single_survey_arcsec: FloatArray = col("σC1", "arcsec", ".3f", "axis")
    all_surveys_arcsec: Any = col("σC1", "arcsec", dims="axis")
    predicted_arcsec: Any = col("σC1", "arcsec", dims="axis")
    above_published_percent: FloatArray | None = col(
        "Surveys that reach the published value", "percent", ".0f", "axis", default=None
    )


def tabulate_removed(
    numbers: DistortionNumbers, frames: DistortionMeasurement, config: DistortionConfig, *, published: bool
) -> RemovedPart:
    """sigma_C1 of the main centroider, and the fraction of the surveys that exceed the published value."""
    row = list(REFERENCES).index(config.reference)
    sigma_c1 = frames.arcsec_3sigma * frames.over_surveys(config.methods[0], config.reference)[:, SIGMA_C1]
    above = 100.0 * (sigma_c1 >= np.array(ACC18_ARCSEC["LSFE-C1"])).mean(0)
    return RemovedPart(
        single_survey_arcsec=numbers.single_survey_arcsec[row, SIGMA_C1],
        all_surveys_arcsec=measured(
            numbers.all_surveys_arcsec[row, SIGMA_C1], numbers.survey_scatter_arcsec[row, SIGMA_C1]
        ),
        predicted_arcsec=numbers.predicted_arcsec[row, SIGMA_C1],
        above_published_percent=above if published else None,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetConditions:
    """Camera of the measurement, and its published values."""

    signal_e: float = col("Signal", "e-", ".0f")
    signal_star: str = col("Star")
    points: int = col("Points")
    terms: int = col("Terms of the polynomial, per axis")
    frames: int = col("Frames")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec")
    size_px: FloatArray = col("Detector", "px", dims="axis")
    marking_error_arcsec: float = col("Marking error", "arcsec", ".2f")
    marking_removed_arcsec: float = col("Marking error alone", "arcsec", ".2f")
    published_arcsec: Any = col("Published σC1", "arcsec", dims="axis", default=None)
    published_marking_error_arcsec: float | None = col("Published marking error", "arcsec", ".2f", default=None)


def describe_target(config: DistortionConfig, instrument: Instrument, *, published: bool) -> TargetConditions:
    """Closed form: k terms remove sqrt((k - 1) / (W - 1)) of pure noise at W points."""
    star = point_signal(config, instrument)
    points = config.target.rows * config.target.columns
    terms = (config.order + 1) * (config.order + 2) // 2
    marking = 3.0 * config.target.marking_error_arcsec
    return TargetConditions(
        signal_e=star.signal_e,
        signal_star=star.star,
        points=points,
        terms=terms,
        frames=config.frames,
        pixel_arcsec=instrument.pixel_arcsec,
        size_px=np.array([instrument.camera.width_px, instrument.camera.height_px]),
        marking_error_arcsec=marking,
        marking_removed_arcsec=marking * float(np.sqrt((terms - 1) / (points - 1))),
        published_arcsec=ACC18_ARCSEC["LSFE-C1"] if published else None,
        published_marking_error_arcsec=ACC18_ARCSEC["LSFE-C2"][0] if published else None,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class GridPoints:
    """Every target point, by main centroider and configured reference."""

    nominal_px: FloatArray = col("Nominal", "px", dims="point axis")
    measured_px: FloatArray = col("Measured", "px", dims="point axis")
    light_px: FloatArray = col("Centroid of the light", "px", dims="point axis")
    ray_trace_px: FloatArray = col("Ray trace", "px", dims="point axis")
    residual_before_px: FloatArray = col("Before", "px", dims="point axis")
    residual_after_px: FloatArray = col("After", "px", dims="point axis")


def tabulate_points(
    frames: DistortionMeasurement, predicted: DistortionPrediction, config: DistortionConfig
) -> GridPoints:
    """Residuals of the first survey."""
    method = config.methods[0]
    light = frames.light
    statistics = frames.statistics(method, config.reference)
    return GridPoints(
        nominal_px=light.nominal_px,
        measured_px=frames.session_px[method][1],
        light_px=light.photon_px,
        ray_trace_px=predicted.bundle_px,
        residual_before_px=statistics.d_px,
        residual_after_px=statistics.residual_px,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueMap:
    """Errors over the detector (3 times their RMS, without shift and roll), main centroider."""

    uncorrected_arcsec: FloatArray = col("Distortion", "arcsec", ".3f", "reference axis")
    single_survey_arcsec: FloatArray = col("One survey", "arcsec", ".3f", "reference axis")
    all_surveys_arcsec: FloatArray = col("All surveys", "arcsec", ".3f", "reference axis")
    # Errors at points deleted from the fit of the first survey; NaN where the others do not determine the polynomial
    point_deleted_arcsec: FloatArray = col("A point left out", "arcsec", ".3f", "reference axis")
    row_deleted_arcsec: FloatArray = col("A row or column left out", "arcsec", ".3f", "reference axis")
    # Prediction, and its parts: distortion that camera and polynomial do not describe, propagated point errors
    predicted_arcsec: FloatArray = col("Predicted", "arcsec", ".3f", "reference axis")
    bias_arcsec: FloatArray = col("Distortion after the correction", "arcsec", ".3f", "reference axis")
    propagated_arcsec: FloatArray = col("Propagated point errors", "arcsec", ".3f", "reference axis")
    ratio: Any = col("After correction, all surveys / predicted", dims="reference axis")
    over_deleted: FloatArray = col("One survey / left out", format=".2f", dims="reference axis")
    position_px: FloatArray = col("Position", "px", dims="cell axis")
    distortion_px: FloatArray = col("Distortion", "px", dims="cell axis")
    residual_px: FloatArray = col("After the correction", "px", dims="cell axis")


def evaluate_map(
    bench: Bench, instrument: Instrument, frames: DistortionMeasurement, config: DistortionConfig, point_error_px: float
) -> TrueMap:
    """Distortion of traced bundles on a dense grid minus the correction by camera and polynomial of every survey."""
    method = config.methods[0]
    grid = (config.map_rows, 2 * config.map_rows - 1)
    direction = dense_grid(instrument, *grid)
    nominal, position = grid_position(instrument, direction)
    traced = traced_bundles(bench, instrument, direction)
    errors = {reference: frames.map_error_px(method, reference, position, traced - nominal) for reference in REFERENCES}
    distortion, _ = grid_residual_px(nominal, position, traced, traced, "aligned")
    expected = [
        predict_map(
            bench,
            instrument,
            config.target,
            order=config.order,
            reference=reference,
            point_error_px=point_error_px,
            field_position=position,
            field_offset_px=traced - nominal,
        )
        for reference in REFERENCES
    ]
    deleted = np.array([frames.deleted_rms_px(method, reference) for reference in REFERENCES])
    single_survey = np.array([rms(error[0]) for error in errors.values()])
    surveys = np.array([rms(error, (0, 1)) for error in errors.values()])
    ratio = surveys / np.array([error.rms_px for error in expected])
    step = max(1, grid[0] // 8)
    cells = np.arange(len(direction)).reshape(grid)[::step, ::step].ravel()
    by_reference_px = {
        "uncorrected": np.tile(rms(distortion), (len(REFERENCES), 1)),
        "single_survey": single_survey,
        "all_surveys": surveys,
        "point_deleted": deleted[:, 0],
        "row_deleted": deleted[:, 1],
        "predicted": np.array([error.rms_px for error in expected]),
        "bias": np.array([error.bias_px for error in expected]),
        "propagated": np.array([error.noise_px for error in expected]),
    }
    return TrueMap(
        **{f"{name}_arcsec": frames.arcsec_3sigma * value for name, value in by_reference_px.items()},
        ratio=measured(ratio, ratio / np.sqrt(2.0 * COEFFICIENTS_PER_AXIS * config.surveys)),
        over_deleted=single_survey / np.fmax(deleted[:, 0], deleted[:, 1]),
        position_px=nominal[cells],
        distortion_px=distortion[cells],
        residual_px=errors[config.reference][0, cells],
    )


def rms(error_px: FloatArray, axes: int | tuple[int, int] = 0) -> FloatArray:
    """Root mean square over axes."""
    return np.sqrt((error_px**2).mean(axes))


def axes(config: DistortionConfig) -> Quantities:
    """Dimensions that all sections share."""
    quantities = point_quantities(config.methods)
    quantities.axis("reference", list(REFERENCES), "Coordinates")
    quantities.axis("number", ["sigma_d", "sigma_dd", "sigma_c1"], "Number", names=LABELS)
    quantities.axis("point", np.arange(config.target.rows * config.target.columns) + 1, "Point")
    return quantities


def run(config: DistortionConfig, *, progress: Progress) -> dict[str, Any]:
    """Render, read out, reduce, predict, compare with the true map."""
    bench, instrument = point_laboratory(config)
    streams = Streams(config.seed).child("distortion")
    direction = grid_directions(config.target, instrument, streams)
    scene = prepared_scene(bench, instrument, direction[None], progress)
    with progress.stage("frames", total=2) as stage:
        frames = measure_distortion(
            bench,
            instrument,
            config.target,
            order=config.order,
            surveys=config.surveys,
            streams=streams,
            scene=scene,
            advance=stage.advance,
        )
    with progress.stage("prediction"):
        predicted = predict_distortion(
            bench,
            instrument,
            config.target,
            direction,
            psf=frames.light.psf,
            order=config.order,
            noise_draws=config.draws,
            defect=sensor_maps(instrument.detector).defect,
            seed=config.seed,
        )
    with progress.stage("map"):
        point_error = float((predicted.point_px[config.methods[0]] ** 2).mean() ** 0.5)
        field_map = evaluate_map(bench, instrument, frames, config, point_error)
    published = is_published_sensor(config)
    by_method = [tabulate_numbers(frames, predicted, method) for method in config.methods]
    return {
        "target": describe_target(config, instrument, published=published),
        "numbers": by_method[0],
        "centroiders": by_method,
        "removed": tabulate_removed(by_method[0], frames, config, published=published),
        "points": tabulate_points(frames, predicted, config),
        "map": field_map,
        "wide": tabulate_wide_field(run_wide_field(config, streams.child("wide field"), progress=progress)),
    }


COORDINATES = "; ".join(f"*{name}*: {text}" for name, text in REFERENCES.items())
SECTIONS = {
    "target": Section(record=TargetConditions),
    "numbers": Section(
        record=DistortionNumbers,
        table="distortion",
        caption="ACC18's three numbers (3 σ), first centroider.",
        note=f"Conversion of surveyed positions to pixels: {COORDINATES}. *All surveys*: RMS over independent surveys "
        "of the same target, same frames.",
    ),
    "centroiders": Section(
        record=DistortionNumbers,
        dim="method",
        caption="ACC18's three numbers (3 σ) by every centroider.",
        verdicts=[
            agree(
                "all_surveys_arcsec",
                "predicted_arcsec",
                each="method",
                false_alarm=1e-3,
                title="Before, after and removed, over all surveys, against prediction",
                advice="centroids, noise or the response pattern differ from the prediction's",
            )
        ],
    ),
    "removed": Section(record=RemovedPart),
    "points": Section(
        record=GridPoints,
        rows="point",
        across="axis",
        caption="All points.",
        figures={
            "point_residuals": arrows(
                "nominal_px", "residual_before_px", "residual_after_px", frame="size_px", aspect_ratio=0.36
            )
        },
    ),
    "map": Section(
        record=TrueMap,
        rows="reference axis",
        columns="uncorrected_arcsec single_survey_arcsec point_deleted_arcsec row_deleted_arcsec all_surveys_arcsec "
        "predicted_arcsec",
        caption="True error of the map (3 times its RMS over the detector) before and after the "
        "correction, and the error at points left out of the fit of a single survey (marking and "
        "centroid errors included).",
        note="–: with a row or a column left out, the others do not determine the polynomial; no "
        "residual tests the map between them.",
        figures={"true_map": arrows("position_px", "distortion_px", "residual_px", frame="size_px", aspect_ratio=0.36)},
        verdicts=[
            ratio_near(
                "ratio",
                within=0.1,
                title="True map error of all surveys over its prediction",
                advice="the prediction does not know the lens, or the errors of the points",
            ),
            below(
                "over_deleted",
                1.0,
                title="True map error of a survey over its error at points left out",
                advice="points left out do not show the error of the map: the grid is too coarse for the order, or "
                "ends too far from the edge of the detector (target.rows, target.columns, target.edge_px, order)",
            ),
        ],
    ),
    "wide": WIDE,
}
