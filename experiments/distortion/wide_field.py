"""The grid test on a wide field, where distortion dominates C1, against the prescription.

With ACC18's camera the polynomial removes little but marking errors, and frames with a wrong distortion would
pass. Here the distortion is hundreds of times the marking error: with shift, roll and scale fitted, the numbers before,
after and removed are the distortion of the traced lens, and the comparison tests the rendered distortion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.accuracy.distortion import Reference, grid_residual_px, misfit_ratio
from calib.accuracy.distortion_prediction import expected_numbers
from experiments.distortion.settings import DistortionConfig
from experiments.harness.progress import Progress
from experiments.harness.sections import Section, agree, col, ratio_near
from experiments.harness.summary import measured
from experiments.laboratory.bench.point_laboratory import point_laboratory, prepared_scene
from experiments.laboratory.devices.target import grid_directions
from experiments.laboratory.distortion_error import DistortionMeasurement, grid_position, measure_distortion
from experiments.laboratory.distortion_model import DistortionPrediction, marking_errors, predict_distortion
from optics.arrays import FloatArray
from render.detector.maps import sensor_maps
from render.engine.random import Streams
from render.sensor_file.tables import PassbandConfig

REFERENCE: Reference = "aligned"
"""Shift, roll and scale fitted: the residual is the distortion."""
ALIGNED_PARAMETERS = 4
"""Shift in x and y, roll, scale."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WideField:
    """Distortion before the polynomial, after it and removed by it, of a single survey, 3 sigma."""

    measured_arcsec: FloatArray = col("Measured", "arcsec", ".3f", "number axis")
    predicted_arcsec: Any = col("Prescription", "arcsec", dims="number axis")
    marking_error_arcsec: FloatArray = col("Marking errors alone", "arcsec", ".3f", "number axis")
    residual_ratio: Any = col("Residuals minus prescription, over expectation from noise and marking")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec", ".1f")


WIDE = Section(
    record=WideField,
    table="wide_field",
    rows="number axis",
    columns="measured_arcsec predicted_arcsec marking_error_arcsec",
    caption="A lens whose distortion exceeds the marking error (3 σ): a single survey, shift, roll and scale fitted.",
    verdicts=[
        agree(
            "measured_arcsec",
            "predicted_arcsec",
            false_alarm=4e-4,  # 4 sigma: squares of few residuals have long tails
            title="Wide field: distortion before, after and removed, against the prescription",
        ),
        ratio_near(
            "residual_ratio",
            within=0.0,
            false_alarm=1e-4,
            title="Wide field: residuals minus prescription, RMS over its expectation",
        ),
    ],
)


@dataclass(frozen=True, slots=True, kw_only=True)
class WideRun:
    """The test on a wide field by one centroider and one survey."""

    method: str
    frames: DistortionMeasurement
    predicted: DistortionPrediction
    marking_px: FloatArray  # (3, 2) Numbers of marking errors alone


def run_wide_field(config: DistortionConfig, streams: Streams, *, progress: Progress) -> WideRun:
    """Render, read out, reduce and predict the test on the wide field."""
    wide = config.wide
    changes = {"instrument": wide.instrument, "passband": PassbandConfig(), "compare": ()}
    bench, instrument = point_laboratory(config.model_copy(update=changes))
    direction = grid_directions(wide.target, instrument, streams)
    scene = prepared_scene(bench, instrument, direction[None], progress)
    with progress.stage("wide field", total=2) as stage:
        frames = measure_distortion(
            bench, instrument, wide.target, order=wide.order, streams=streams, scene=scene, advance=stage.advance
        )
    predicted = predict_distortion(
        bench,
        instrument,
        wide.target,
        direction,
        psf=frames.light.psf,
        order=wide.order,
        references=(REFERENCE,),
        noise_draws=config.draws,
        defect=sensor_maps(instrument.detector).defect,
        seed=config.seed,
    )
    marking = expected_numbers(marking_errors(wide.target, instrument, direction), wide.order, REFERENCE)
    return WideRun(method=config.methods[0], frames=frames, predicted=predicted, marking_px=marking.rms_px)


def tabulate_wide_field(run: WideRun) -> WideField:
    """Numbers of the first survey and of the prescription, and its residuals point by point."""
    frames = run.frames
    predicted = run.predicted
    scale = frames.arcsec_3sigma
    statistics = frames.statistics(run.method, REFERENCE)
    expected_px = predicted.position_px[run.method]
    nominal, position = grid_position(frames.instrument, frames.direction)
    distortion, _ = grid_residual_px(nominal, position, expected_px, expected_px, REFERENCE)
    error_px = np.hypot(predicted.point_px[run.method], predicted.marking_px)
    ratio, scatter = misfit_ratio(statistics.d_px - distortion, error_px, parameters=ALIGNED_PARAMETERS)
    return WideField(
        measured_arcsec=scale * statistics.sigma_px,
        predicted_arcsec=measured(
            scale * predicted.mean_px[run.method][REFERENCE], scale * predicted.scatter_px[run.method][REFERENCE]
        ),
        marking_error_arcsec=scale * run.marking_px,
        residual_ratio=measured(ratio, scatter),
        pixel_arcsec=frames.instrument.pixel_arcsec,
    )
