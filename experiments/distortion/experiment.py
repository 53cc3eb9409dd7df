"""Distortion error (ACC18 eq. 17-30, Fig. 8): a surveyed grid, its residuals, the polynomial, and the true map.

Mean centroids of a grid target over the whole detector minus surveyed coordinates are reduced as printed. The three
numbers are labelled by their meaning (before, after, removed), predicted by ray trace, and compared with the true error
of the correction between the points. `wide_field` repeats the test with dominant distortion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.accuracy.distortion import LABELS, REFERENCES, grid_residual_px
from experiments.distortion.settings import Config
from experiments.distortion.wide_field import WIDE, wide_field, wide_run
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
from experiments.laboratory.devices.targets import grid_directions
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Numbers:
    """The document's numbers by one centroider, 3 sigma, by the way that coordinates become pixels."""

    one_survey_arcsec: FloatArray = col("One survey", "arcsec", ".3f", "reference number axis")
    # RMS over independent surveys of the same target, same frames; scatter from survey to survey
    all_surveys_arcsec: FloatArray = col("All surveys", "arcsec", ".3f", "reference number axis")
    survey_scatter_arcsec: FloatArray = col("Scatter of surveys", "arcsec", ".3f", "reference number axis")
    predicted_arcsec: Any = col(
        "Predicted",
        "arcsec",
        dims="reference number axis",
    )


def numbers(frames: DistortionMeasurement, predicted: DistortionPrediction, method: str) -> Numbers:
    """Eq. 19-30 with the first survey and with all of them, and the prediction."""
    scale, surveys = frames.arcsec_3sigma, len(frames.surveyed)
    every = scale * np.array([frames.over_surveys(method, r) for r in REFERENCES])  # (reference, survey, number, axis)
    expected = scale * np.array([predicted.mean_px[method][r] for r in REFERENCES])
    spread = scale * np.array([predicted.of_surveys_px(method, r, surveys) for r in REFERENCES])
    return Numbers(
        one_survey_arcsec=every[:, 0],
        all_surveys_arcsec=np.sqrt((every**2).mean(1)),
        survey_scatter_arcsec=every.std(1, ddof=1),
        predicted_arcsec=measured(expected, spread),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Removed:
    """The number that is published, sigma_C1 (3 sigma), by the centroider and the coordinates that count."""

    one_survey_arcsec: FloatArray = col("σC1", "arcsec", ".3f", "axis")
    all_surveys_arcsec: Any = col("σC1", "arcsec", dims="axis")
    predicted_arcsec: Any = col("σC1", "arcsec", dims="axis")
    above_published: FloatArray | None = col("Surveys that reach the published value", "%", ".0f", "axis", default=None)


def removed(of: Numbers, frames: DistortionMeasurement, config: Config, *, published: bool) -> Removed:
    """The part of the first centroider's numbers that the document publishes, and every survey's."""
    here = list(REFERENCES).index(config.reference)
    every = frames.arcsec_3sigma * frames.over_surveys(config.methods[0], config.reference)[:, 2]
    above = 100.0 * (every >= np.array(ACC18_ARCSEC["LSFE-C1"])).mean(0)
    return Removed(
        one_survey_arcsec=of.one_survey_arcsec[here, 2],
        all_surveys_arcsec=measured(of.all_surveys_arcsec[here, 2], of.survey_scatter_arcsec[here, 2]),
        predicted_arcsec=of.predicted_arcsec[here, 2],
        above_published=above if published else None,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """Camera of the measurement, and its published values."""

    signal_e: float = col("Signal", "e-", ".0f")
    signal_star: str = col("Star")
    points: int = col("Points")
    terms: int = col("Terms of the polynomial, per axis")
    frames: int = col("Frames")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec")
    size_px: FloatArray = col("Detector", "px", dims="axis")
    marking_arcsec: float = col("Marking error", "arcsec", ".2f")
    noise_removed_arcsec: float = col("Marking error alone", "arcsec", ".2f")
    published_arcsec: Any = col("Published σC1", "arcsec", dims="axis", default=None)
    published_marking_arcsec: float | None = col("Published marking error", "arcsec", ".2f", default=None)


def target_record(config: Config, instrument: Instrument, *, published: bool) -> Target:
    """Closed form: k terms remove sqrt((k - 1) / (W - 1)) of pure noise at W points."""
    star, points = point_signal(config, instrument), config.target.rows * config.target.columns
    terms, marking = (config.order + 1) * (config.order + 2) // 2, 3.0 * config.target.marking_error_arcsec
    return Target(
        signal_e=star.signal_e,
        signal_star=star.star,
        points=points,
        terms=terms,
        frames=config.frames,
        pixel_arcsec=instrument.pixel_arcsec,
        size_px=np.array([instrument.camera.width_px, instrument.camera.height_px]),
        marking_arcsec=marking,
        noise_removed_arcsec=marking * float(np.sqrt((terms - 1) / (points - 1))),
        published_arcsec=ACC18_ARCSEC["LSFE-C1"] if published else None,
        published_marking_arcsec=ACC18_ARCSEC["LSFE-C2"][0] if published else None,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Points:
    """Every target point, by the centroider and the coordinates that count."""

    nominal_px: FloatArray = col("Nominal", "px", dims="point axis")
    measured_px: FloatArray = col("Measured", "px", dims="point axis")
    light_px: FloatArray = col("Centroid of the light", "px", dims="point axis")
    ray_trace_px: FloatArray = col("Ray trace", "px", dims="point axis")
    d_px: FloatArray = col("Before", "px", dims="point axis")
    left_px: FloatArray = col("After", "px", dims="point axis")


def points(frames: DistortionMeasurement, predicted: DistortionPrediction, config: Config) -> Points:
    """Residuals of the first survey."""
    first, light = config.methods[0], frames.light
    found = frames.statistics(first, config.reference)
    return Points(
        nominal_px=light.nominal_px,
        measured_px=frames.session_px[first][1],
        light_px=light.photon_px,
        ray_trace_px=predicted.bundle_px,
        d_px=found.d_px,
        left_px=found.residual_px,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueMap:
    """Errors over the whole detector (3 sigma of their RMS, shift and roll taken out), first centroider."""

    uncorrected_arcsec: FloatArray = col("Distortion", "arcsec", ".3f", "reference axis")
    one_survey_arcsec: FloatArray = col("One survey", "arcsec", ".3f", "reference axis")
    all_surveys_arcsec: FloatArray = col("All surveys", "arcsec", ".3f", "reference axis")
    # What the one survey's points say of it themselves (`cross_validated`); NaN where they do not
    point_out_arcsec: FloatArray = col("A point left out", "arcsec", ".3f", "reference axis")
    row_out_arcsec: FloatArray = col(
        "A row or column left out",
        "arcsec",
        ".3f",
        "reference axis",
    )
    # Of the same reference; its parts: distortion that camera and polynomial cannot follow, errors of the points
    # carried into the map
    forecast_arcsec: FloatArray = col("Predicted", "arcsec", ".3f", "reference axis")
    bias_arcsec: FloatArray = col("Distortion after the correction", "arcsec", ".3f", "reference axis")
    carried_arcsec: FloatArray = col("Propagated point errors", "arcsec", ".3f", "reference axis")
    ratio: Any = col("After correction, all surveys / predicted", dims="reference axis")
    over_left_out: FloatArray = col("One survey / left out", format=".2f", dims="reference axis")
    place_px: FloatArray = col("Place", "px", dims="cell axis")
    distortion_px: FloatArray = col("Distortion", "px", dims="cell axis")
    left_px: FloatArray = col("After the correction", "px", dims="cell axis")


def true_map(
    bench: Bench, instrument: Instrument, frames: DistortionMeasurement, config: Config, point_error_px: float
) -> TrueMap:
    """Traced bundles on a dense grid, against camera and polynomial of every survey."""
    grid, method = (config.map_rows, 2 * config.map_rows - 1), config.methods[0]
    direction = dense_grid(instrument, *grid)
    nominal, position = grid_position(instrument, direction)
    traced = traced_bundles(bench, instrument, direction)
    errors = {of: frames.map_error_px(method, of, position, traced - nominal) for of in REFERENCES}
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
    missed = np.array([frames.left_out_px(method, reference) for reference in REFERENCES])
    one_survey = np.array([rms(error[0]) for error in errors.values()])
    surveys = np.array([rms(error, (0, 1)) for error in errors.values()])
    ratio = surveys / np.array([one.rms_px for one in expected])
    step = max(1, grid[0] // 8)
    cells = np.arange(len(direction)).reshape(grid)[::step, ::step].ravel()
    by_reference_px = {
        "uncorrected": np.tile(rms(distortion), (len(REFERENCES), 1)),
        "one_survey": one_survey,
        "all_surveys": surveys,
        "point_out": missed[:, 0],
        "row_out": missed[:, 1],
        "forecast": np.array([one.rms_px for one in expected]),
        "bias": np.array([one.bias_px for one in expected]),
        "carried": np.array([one.noise_px for one in expected]),
    }
    return TrueMap(
        **{f"{name}_arcsec": frames.arcsec_3sigma * value for name, value in by_reference_px.items()},
        ratio=measured(ratio, ratio / np.sqrt(18.0 * config.surveys)),  # each map is of about nine coefficients
        over_left_out=one_survey / np.fmax(missed[:, 0], missed[:, 1]),
        place_px=nominal[cells],
        distortion_px=distortion[cells],
        left_px=errors[config.reference][0, cells],
    )


def rms(error_px: FloatArray, axes: int | tuple[int, int] = 0) -> FloatArray:
    """Root mean square over axes."""
    return np.sqrt((error_px**2).mean(axes))


def axes(config: Config) -> Quantities:
    """Dimensions that all sections share."""
    q = point_quantities(config.methods)
    q.axis("reference", list(REFERENCES), "Coordinates")
    q.axis("number", ["sigma_d", "sigma_left", "sigma_c1"], "Number", names=LABELS)
    q.axis("point", np.arange(config.target.rows * config.target.columns) + 1, "Point")
    return q


def run(config: Config, *, progress: Progress) -> dict[str, Any]:
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
        checked = true_map(bench, instrument, frames, config, point_error)
    published = is_published_sensor(config)
    every = [numbers(frames, predicted, method) for method in config.methods]
    return {
        "target": target_record(config, instrument, published=published),
        "numbers": every[0],
        "centroiders": every,
        "removed": removed(every[0], frames, config, published=published),
        "points": points(frames, predicted, config),
        "map": checked,
        "wide": wide_field(wide_run(config, streams.child("wide field"), progress=progress)),
    }


COORDINATES = "; ".join(f"*{name}*: {text}" for name, text in REFERENCES.items())
SECTIONS = {
    "target": Section(record=Target),
    "numbers": Section(
        record=Numbers,
        table="distortion",
        caption="ACC18's three numbers (3 σ), first centroider.",
        note=f"Conversion of surveyed places to pixels: {COORDINATES}. *All surveys*: RMS over independent surveys of "
        "the same target, same frames.",
    ),
    "centroiders": Section(
        record=Numbers,
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
    "removed": Section(
        record=Removed,
    ),
    "points": Section(
        record=Points,
        rows="point",
        across="axis",
        caption="All points.",
        figures={"point_residuals": arrows("nominal_px", "d_px", "left_px", frame="size_px", aspect_ratio=0.36)},
    ),
    "map": Section(
        record=TrueMap,
        rows="reference axis",
        columns="uncorrected_arcsec one_survey_arcsec point_out_arcsec row_out_arcsec all_surveys_arcsec "
        "forecast_arcsec",
        caption="True error of the map (3 times its RMS over the detector) before and after the "
        "correction, and the error at points left out of the fit of a single survey (marking and "
        "centroid errors included).",
        note="–: with a row or a column left out, the others do not determine the polynomial; no "
        "residual tests the map between them.",
        figures={"true_map": arrows("place_px", "distortion_px", "left_px", frame="size_px", aspect_ratio=0.36)},
        verdicts=[
            ratio_near(
                "ratio",
                within=0.1,
                title="True map error of all surveys over its prediction",
                advice="the prediction does not know the lens, or the errors of the points",
            ),
            below(
                "over_left_out",
                1.0,
                title="True map error of a survey over its error at points left out",
                advice="points left out do not show the error of the map: the grid is too coarse for the order, or "
                "ends too far from the edge of the detector (target.rows, target.columns, target.edge_px, order)",
            ),
        ],
    ),
    "wide": WIDE,
}
