"""High spatial frequency error of the bench, predicted without frames (`calib.accuracy.step_prediction`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.step_prediction import StepModel, StepPrediction
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.point_bench import Bench, centroiders, one_filter, session_centroiders
from experiments.laboratory.bench.points import Subtraction
from experiments.laboratory.bench.ray_prediction import bundle_prediction, target_windows
from experiments.laboratory.bench.readout.frames import nominal_noise
from experiments.laboratory.devices.hexapod import step_path, turned
from experiments.laboratory.settings.tables import HexapodConfig, StepConfig
from experiments.laboratory.temporal_error import star_target_directions
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
from render.records import EffectivePsf
from render.sensor_file.instrument import Instrument

PATHS = 24
"""Drawn paths of a hexapod with errors; roll changes S-curve and pattern negligibly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HighFrequencyPrediction:
    """Predictions by centroider."""

    pixel_arcsec: float  # Angle of a pixel
    position_px: FloatArray  # (m, j, 2) Traced positions for an ideal hexapod, plus ``shift_px``
    method: Mapping[str, StepPrediction]  # By name


def predict_high_frequency(
    bench: Bench,
    instrument: Instrument,
    steps: StepConfig,
    *,
    psf: Sequence[EffectivePsf],
    hexapod: HexapodConfig | None = None,
    shift_px: FloatArray | None = None,
    corner_px: NDArray[np.int64] | None = None,
    place_px: Sequence[float] | None = None,
    subtraction: Subtraction = "dark",
    defect: NDArray[np.bool_] | None = None,
    draws: int = 200,
    noise_draws: int = 0,
    seed: int = 0,
) -> HighFrequencyPrediction:
    """Prediction for every centroider.

    ``shift_px`` (m, 2): measured common shift of the image at each position; ``corner_px`` (m, j, 2): first pixels of
    the windows of the test. Without them paths of the hexapod are drawn.
    """
    bench = one_filter(bench)
    rng = Streams(seed).generator("high-frequency prediction")
    ideal = HexapodConfig(step_error_arcsec=0.0, roll_error_arcsec=0.0, reading_error_arcsec=0.0)
    path = step_path(ideal, steps, instrument.pixel_arcsec, rng)
    direction = turned(star_target_directions(bench, instrument, place_px), path.commanded_rad)
    shift = np.zeros((steps.positions, 2)) if shift_px is None else np.asarray(shift_px, float)
    position = bundle_prediction(bench, instrument, direction)[:, :, bench.reference]
    windows = target_windows(bench, instrument, direction, psf, position + shift[:, None], corner_px=corner_px)
    error_px = hexapod.step_error_arcsec / instrument.pixel_arcsec if hexapod is not None and shift_px is None else 0.0
    drawn = [error_px * rng.standard_normal(shift.shape) for _ in range(PATHS if error_px > 0 else 0)]
    model = StepModel(
        windows=windows,
        positions=steps.positions,
        noise=nominal_noise(instrument),
        pixel=instrument.pixel_noise(),
        frames=bench.frames,
        dark_frames=bench.dark_frames,
        offsets_px=drawn,
        drawn_windows=[
            target_windows(bench, instrument, direction, psf, position + offset[:, None]) for offset in drawn
        ],
        roll_rad=0.0 if hexapod is None else hexapod.roll_error_arcsec * ARCSEC_RAD,
        dark_subtracted=subtraction == "dark",
        defect=defect,
        draws=draws,
        bias_rng=lambda: Streams(seed).generator("high-frequency bias"),
    )
    methods = {}
    for name, centroider in centroiders(bench, psf).items():
        fit = needs_epsf(name)
        methods[name] = model.predict(
            centroider,
            rng,
            sessions=session_centroiders(bench, psf, name),
            noise_draws=0 if fit else noise_draws,
            fit_draws=noise_draws if fit else 0,
        )
    return HighFrequencyPrediction(
        pixel_arcsec=instrument.pixel_arcsec,
        position_px=windows.position_px.reshape(steps.positions, -1, 2),
        method=methods,
    )
