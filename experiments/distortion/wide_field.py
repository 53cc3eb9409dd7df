"""A lens whose distortion decides C1: the grid test on a wide field, against the prescription.

With the camera of the document the polynomial takes little but marking errors, and frames that showed another
distortion would pass. Here the distortion is hundreds of times the marking error: with shift, roll and scale fitted,
what is found, left and removed is that of the traced lens, and the comparison is one of the rendered distortion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.distortion.settings import Config
from experiments.harness.progress import Progress
from experiments.laboratory.distortion_error import DistortionMeasurement, measure_distortion, residual_px
from experiments.laboratory.distortion_model import (
    DistortionPrediction,
    marking_errors,
    predict_distortion,
    predicted_numbers,
)
from experiments.laboratory.distortion_statistics import Reference
from experiments.laboratory.point_scene import point_laboratory, prepared_scene
from experiments.laboratory.settings import PassbandConfig
from experiments.laboratory.targets import GridTarget, grid_directions
from optics.arrays import FloatArray
from render.detector.maps import sensor_maps
from render.engine.random import Streams

__all__ = ["WIDE_REFERENCE", "WideField", "wide_field"]

WIDE_REFERENCE: Reference = "aligned"
"""Shift, roll and scale fitted: the residual is the distortion."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WideField:
    """The test on a wide field, one centroider, one survey."""

    method: str  # The centroider
    measured: DistortionMeasurement  # The test, and what it should give
    predicted: DistortionPrediction  # The test, and what it should give
    marking_px: FloatArray  # (3, 2) What marking errors alone give: found, left, removed

    @property
    def numbers_px(self) -> FloatArray:
        """sigma_d, sigma_Dd, sigma_C1 (3, 2) of the first survey."""
        s = self.measured.statistics(self.method, WIDE_REFERENCE)
        return np.stack([s.sigma_d_px, s.sigma_left_px, s.sigma_c1_px])

    @property
    def expected_px(self) -> FloatArray:
        """What they should be (3, 2)."""
        return self.predicted.mean_px[self.method][WIDE_REFERENCE]

    @property
    def scatter_px(self) -> FloatArray:
        """Their standard deviation (3, 2), from chip to chip and survey to survey."""
        return self.predicted.scatter_px[self.method][WIDE_REFERENCE]

    @property
    def points_px(self) -> tuple[FloatArray, FloatArray]:
        """Residuals (n, 2) minus those of the prescription, and standard deviation (n, 2) of that."""
        measured, predicted = self.measured, self.predicted
        instrument, place_px = measured.instrument, predicted.position_px[self.method]
        _, expected, _ = residual_px(instrument, measured.direction, place_px, place_px, WIDE_REFERENCE)
        apart = measured.statistics(self.method, WIDE_REFERENCE).d_px - expected
        return apart, np.hypot(predicted.point_px[self.method], predicted.marking_px)


def wide_field(config: Config, streams: Streams, *, progress: Progress) -> WideField:
    """Render, read out, reduce and predict the test on the wide field."""
    wide = config.wide
    own = {"instrument": wide.instrument, "passband": PassbandConfig(), "compare": ()}
    bench, instrument = point_laboratory(config.model_copy(update=own))
    target = GridTarget(**wide.target.model_dump())
    direction = grid_directions(target, instrument, streams.generator("target"))
    scene = prepared_scene(bench, instrument, direction[None], progress)
    with progress.stage("wide field", total=2) as stage:
        measured = measure_distortion(
            bench, instrument, target, order=wide.order, streams=streams, scene=scene, advance=stage.advance
        )
    predicted = predict_distortion(
        bench,
        instrument,
        target,
        direction,
        psf=measured.light.psf,
        order=wide.order,
        references=(WIDE_REFERENCE,),
        noise_draws=config.draws,
        defect=sensor_maps(instrument.detector).defect,
        seed=config.seed,
    )
    alone = predicted_numbers(marking_errors(target, instrument, direction), wide.order, WIDE_REFERENCE)
    return WideField(method=config.methods[0], measured=measured, predicted=predicted, marking_px=alone.rms_px)
