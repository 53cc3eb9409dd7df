"""Distortion error predicted without frames: traced bundles, noise, response pattern, S-curve and marking error.

The chip and the frames of a run are the same for all its surveys: the RMS over surveys keeps a *frozen* scatter (from
chip to chip and from run to run) for any number of surveys. Expected numbers: `calib.accuracy.distortion_prediction`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.distortion import REFERENCES, Reference
from calib.accuracy.distortion_prediction import (
    ExpectedMapError,
    ExpectedNumbers,
    GridErrors,
    expected_map_error,
    expected_numbers,
)
from calib.measure.centroid_error.expected_windows import (
    ExpectedWindows,
    drawn_positions,
    noiseless_positions,
    window_response,
)
from calib.measure.centroiding.registry import Centroider
from calib.measure.statistics.frame_positions import position_covariance_px2
from calib.records import NoiseModel
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.point_bench import Bench, centroiders, one_filter, session_centroiders
from experiments.laboratory.bench.ray_prediction import target_windows
from experiments.laboratory.bench.readout.frames import nominal_noise
from experiments.laboratory.devices.target import grid_directions
from experiments.laboratory.distortion_error import grid_position, traced_bundles
from experiments.laboratory.settings.tables import GridTargetConfig
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD
from render.engine.random import Streams
from render.records import EffectivePsf
from render.sensor_file.instrument import Instrument


@dataclass(frozen=True, slots=True, kw_only=True)
class DistortionPrediction:
    """Expected values of ACC18's numbers; [px], 1 sigma, by method and reference."""

    pixel_arcsec: float  # Angle of a pixel
    # (3, 2) sigma_d, sigma_Dd, sigma_C1: root mean square over chips, runs and surveys; standard deviation of the
    # numbers of one survey; standard deviation, from chip to chip and run to run, of the RMS over many surveys
    mean_px: Mapping[str, Mapping[Reference, FloatArray]]
    scatter_px: Mapping[str, Mapping[Reference, FloatArray]]
    frozen_px: Mapping[str, Mapping[Reference, FloatArray]]
    bundle_px: FloatArray  # (n, 2) Traced positions of the points
    position_px: Mapping[str, FloatArray]  # (n, 2) Expected mean centroids of the traced light, bias included
    point_px: Mapping[str, FloatArray]  # (n, 2) Predicted error of a mean centroid by noise and response pattern
    marking_px: float  # Standard deviation per axis of a surveyed coordinate

    def of_surveys_px(self, method: str, reference: Reference, surveys: int) -> FloatArray:
        """Standard deviation (3, 2) of the RMS over a number of surveys of one chip and one run."""
        total, frozen = self.scatter_px[method][reference], self.frozen_px[method][reference]
        return np.sqrt(frozen**2 + np.maximum(total**2 - frozen**2, 0.0) / surveys)


def marking_errors(target: GridTargetConfig, instrument: Instrument, direction: FloatArray) -> GridErrors:
    """Residuals of a target (n, 3) through a perfect camera without noise: marking errors alone."""
    _, position = grid_position(instrument, direction)
    # errors of surveyed tangents, of one size over the field, are errors of nominal coordinates
    scale_px = instrument.focal_length_mm / instrument.camera.pixel_pitch_mm
    zero = np.zeros((len(position), 2, 2))
    return GridErrors(
        position=position,
        offset_px=np.zeros_like(position),
        chip_px2=zero,
        session_px2=zero,
        mean_px2=zero,
        marking_px=target.marking_error_arcsec * ARCSEC_RAD * scale_px,
    )


def predict_distortion(
    bench: Bench,
    instrument: Instrument,
    target: GridTargetConfig,
    direction: FloatArray,
    *,
    psf: Sequence[EffectivePsf],
    order: int = 3,
    references: Sequence[Reference] = tuple(REFERENCES),
    noise_draws: int = 0,
    defect: NDArray[np.bool_] | None = None,
    seed: int = 0,
) -> DistortionPrediction:
    """Prediction for every centroider of the bench."""
    bench = one_filter(bench)
    pixel, noise_model = instrument.pixel_noise(), nominal_noise(instrument)
    windows = target_windows(bench, instrument, direction[None], psf, defect=defect)
    nominal, _ = grid_position(instrument, direction)
    marking = marking_errors(target, instrument, direction)
    dark_e2 = np.full_like(windows.light_e, pixel.floor_e2 / bench.dark_frames)
    numbers: dict[str, dict[Reference, ExpectedNumbers]] = {}
    position_px: dict[str, FloatArray] = {}
    point_px: dict[str, FloatArray] = {}
    for method, centroider in centroiders(bench, psf).items():
        response = window_response(centroider, windows, noise_model)
        chip = response.covariance_px2(pixel.response_e2(windows.light_e))
        position, frame = response.position_px, response.covariance_px2(pixel.temporal_e2(windows.light_e))
        of_draws = np.zeros_like(chip)  # covariance of the predicted mean itself
        if noise_draws and not needs_epsf(method):
            rng = Streams(seed).generator("distortion noise")
            drawn = drawn_positions(centroider, windows, noise_model, pixel, draws=noise_draws, rng=rng)
            position, frame = np.nanmean(drawn, axis=0), position_covariance_px2(drawn)
            of_draws = frame / noise_draws
        if sessions := session_centroiders(bench, psf, method):
            position, of_psf = _over_sessions(sessions, windows, noise_model)
            chip, of_draws = chip + of_psf, of_draws + of_psf / len(sessions)
        session = frame / bench.frames + response.covariance_px2(dark_e2)
        position_px[method] = position
        point_px[method] = np.sqrt(np.diagonal(chip + session, axis1=1, axis2=2))
        errors = replace(marking, offset_px=position - nominal, chip_px2=chip, session_px2=session, mean_px2=of_draws)
        numbers[method] = {reference: expected_numbers(errors, order, reference) for reference in references}
    return DistortionPrediction(
        pixel_arcsec=instrument.pixel_arcsec,
        mean_px={m: {r: v.rms_px for r, v in by_reference.items()} for m, by_reference in numbers.items()},
        scatter_px={m: {r: v.scatter_px for r, v in by_reference.items()} for m, by_reference in numbers.items()},
        frozen_px={m: {r: v.frozen_px for r, v in by_reference.items()} for m, by_reference in numbers.items()},
        bundle_px=windows.position_px,
        position_px=position_px,
        point_px=point_px,
        marking_px=marking.marking_px,
    )


def _over_sessions(
    sessions: Sequence[Centroider], windows: ExpectedWindows, noise_model: NoiseModel
) -> tuple[FloatArray, FloatArray]:
    """Mean position (n, 2) over PSFs of drawn sessions, and covariance (n, 2, 2) of their differences from point to
    point; a shift common to all points is one of the camera."""
    position = np.stack([noiseless_positions(centroider, windows, noise_model) for centroider in sessions])
    return position.mean(0), position_covariance_px2(position - position.mean(1, keepdims=True))


def predict_map(
    bench: Bench,
    instrument: Instrument,
    target: GridTargetConfig,
    *,
    order: int,
    reference: Reference,
    point_error_px: float,
    field_position: FloatArray,
    field_offset_px: FloatArray,
) -> ExpectedMapError:
    """Expected error over the field of the map that a target of this kind gives."""
    direction = grid_directions(target, instrument, Streams(0), part="forecast")
    nominal, position = grid_position(instrument, direction)
    return expected_map_error(
        position,
        traced_bundles(bench, instrument, direction) - nominal,
        field_position,
        field_offset_px,
        order=order,
        reference=reference,
        point_error_px=float(np.hypot(point_error_px, target.marking_error_arcsec / instrument.pixel_arcsec)),
    )
