"""High-spatial-frequency error, HSFE (ACC18 eq. 3-12): by centroider, by cause, along the path of the hexapod."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.accuracy.high_frequency import (
    independent_position_rms_px,
    position_rms_scatter_px,
    step_residual_px,
    step_rms_px,
)
from calib.accuracy.step_prediction import CAUSES, StepPrediction
from calib.measure.centroid_error.expected_windows import expected_windows, noiseless_positions
from experiments.harness.drawings import bars, cloud, curves
from experiments.harness.progress import Progress
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, agree, col
from experiments.harness.summary import Measured, measured
from experiments.hsfe.settings import HsfeConfig
from experiments.laboratory.bench.point_bench import Bench, centroiders, motion_method
from experiments.laboratory.bench.point_laboratory import (
    point_laboratory,
    point_quantities,
    point_signal,
    prepared_scene,
)
from experiments.laboratory.bench.readout.frames import nominal_noise
from experiments.laboratory.devices.collimator_effects import LINE_OF_SIGHT, line_of_sight
from experiments.laboratory.devices.hexapod import step_path, turned
from experiments.laboratory.high_frequency import HighFrequencyMeasurement, check_steps, measure_high_frequency
from experiments.laboratory.high_frequency_model import HighFrequencyPrediction, predict_high_frequency
from experiments.laboratory.settings.published import ACC18_ARCSEC, is_published_sensor
from experiments.laboratory.temporal_error import star_target_directions
from optics.arrays import FloatArray
from render.detector.maps import sensor_maps
from render.engine.random import Streams
from render.records import EffectivePsf
from render.sensor_file.instrument import Instrument

AxisValues = Sequence[Measured]
MODEL_SLACK = 0.03
"""Largest relative error of the linear model: noise smooths the S-curve of a thresholding centroider by 3 %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TestConditions:
    """Test conditions, and the number of ACC18 by the main centroider."""

    frames: int = col("Frames")
    stars: int = col("Stars")
    positions: int = col("Positions")
    subtraction: str = col("Subtraction")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec")
    signal_e: float = col("Signal", "e-", ".0f")
    magnitude_mag: float = col("V magnitude of the signal", "mag", ".2f")
    signal_star: str = col("Star")
    hsfe_arcsec: AxisValues = col("HSFE as printed", "arcsec", dims="axis")
    published_arcsec: Sequence[float] | None = col("Published", "arcsec", ".2f", "axis", default=None)
    # RMS of the true steps minus their mean over the stars: roll of the hexapod and distortion of the lens
    residual_motion_px: FloatArray = col("Residual motion", "px", ".5f", "axis")
    residual_arcsec: FloatArray = col("Residuals of the steps", "arcsec", ".3f", "step star axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class StepErrors:
    """High spatial frequency error (3 sigma) of a centroider."""

    measured_arcsec: AxisValues = col("HSFE of ACC18", "arcsec", ".3f", "axis")
    predicted_arcsec: AxisValues = col("HSFE predicted", "arcsec", ".3f", "axis")
    ratio: AxisValues = col("Measured / predicted", "", ".3f", "axis")
    independent_position_arcsec: FloatArray = col("HSFE / √2", "arcsec", ".3f", "axis")
    single_position_arcsec: FloatArray = col("Single position", "arcsec", ".3f", "axis")
    single_position_predicted_arcsec: FloatArray = col("Single position, predicted", "arcsec", ".3f", "axis")
    single_position_ratio: AxisValues = col("One position, ratio", "", ".3f", "axis", shown=False)
    prior_predicted_arcsec: AxisValues = col("Predicted before the test", "arcsec", ".3f", "axis", shown=False)
    # Not judged: with a large step error of the hexapod its distribution is not normal
    prior_ratio: AxisValues = col("Ratio to the prediction before the test", "", ".3f", "axis", shown=False)
    dark_frames_arcsec: FloatArray = col("Noise of the dark frames", "arcsec", ".3f", "axis", shown=False)
    roll_arcsec: FloatArray = col("Roll of the hexapod", "arcsec", ".3f", "axis", shown=False)
    quadrature_arcsec: FloatArray = col("Parts in quadrature", "arcsec", ".3f", "axis", shown=False)


def tabulate_steps(
    frames: HighFrequencyMeasurement, prior: StepPrediction, posterior: StepPrediction, method: str
) -> StepErrors:
    """HSFE measured, predicted for sampled paths of the hexapod (prior) and for the measured path (posterior)."""
    scale = 3.0 * frames.pixel_arcsec
    hsfe = frames.high_frequency_error(method)
    sigma_px = frames.sigma_px(method)
    step_rms = step_rms_px(frames.mean_px(method))
    single = frames.single_px(method)
    noise_scatter = position_rms_scatter_px(single, sigma_px, frames.frames)
    single_scatter = np.hypot(posterior.position_rms_scatter_px, noise_scatter)
    rms_px = {
        "independent_position": independent_position_rms_px(step_rms, sigma_px, frames.frames),
        "single_position": single,
        "single_position_predicted": posterior.position_rms_px,
        "dark_frames": posterior.dark_px,
        "roll": posterior.roll_px,
        "quadrature": frames.quadrature_px(method),
    }
    return StepErrors(
        measured_arcsec=measured(hsfe.arcsec, hsfe.uncertainty_arcsec, n=hsfe.n, unit="arcsec"),
        predicted_arcsec=measured(scale * posterior.step_rms_px, scale * posterior.step_rms_scatter_px),
        prior_predicted_arcsec=measured(scale * prior.step_rms_px, scale * prior.step_rms_scatter_px),
        ratio=measured_over_predicted(step_rms, posterior.step_rms_px, posterior.step_rms_scatter_px),
        prior_ratio=measured_over_predicted(step_rms, prior.step_rms_px, prior.step_rms_scatter_px),
        single_position_ratio=measured_over_predicted(single, posterior.position_rms_px, single_scatter),
        **{f"{name}_arcsec": scale * rms for name, rms in rms_px.items()},
    )


def measured_over_predicted(value: FloatArray, expected: FloatArray, scatter: FloatArray) -> AxisValues:
    """Measured over predicted; its uncertainty is the scatter of the prediction over detectors, paths and noise."""
    ratios: AxisValues = measured(value / expected, scatter / expected)
    return ratios


CAUSE_NAMES = {
    "s_curve": "S-curve",
    "prnu": "response (PRNU)",
    "pattern": "offset pattern (DSNU)",
    "defects": "masked defects",
    "temporal": "temporal noise / √N",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseErrors:
    """Contribution of a cause (3 sigma): to the HSFE of ACC18, and to the error of a single position."""

    alone_arcsec: FloatArray = col("Alone", "arcsec", ".4f", "method axis")
    switched_off_arcsec: FloatArray = col("Switched off", "arcsec", ".4f", "method axis")
    predicted_arcsec: FloatArray = col("Predicted", "arcsec", ".4f", "method axis")
    single_position_alone_arcsec: FloatArray = col("Alone, one position", "arcsec", ".4f", "method axis")
    single_position_predicted_arcsec: FloatArray = col("Predicted", "arcsec", ".4f", "method axis")


def tabulate_causes(
    frames: HighFrequencyMeasurement, prediction: HighFrequencyPrediction, methods: Sequence[str]
) -> list[CauseErrors]:
    """`CAUSES`, and averaged temporal noise, which cannot be switched off."""
    scale = 3.0 * frames.pixel_arcsec
    models = [prediction.method[method] for method in methods]
    switched = [
        CauseErrors(
            alone_arcsec=scale * np.array([frames.cause_px(m, cause) for m in methods]),
            switched_off_arcsec=scale * np.array([frames.cause_px(m, cause, alone=False) for m in methods]),
            predicted_arcsec=scale * np.array([model.cause_px[cause] for model in models]),
            single_position_alone_arcsec=scale * np.array([frames.cause_single_px(m, cause) for m in methods]),
            single_position_predicted_arcsec=scale * np.array([model.cause_position_px[cause] for model in models]),
        )
        for cause in CAUSES
    ]
    undefined = np.full((len(methods), 2), np.nan)
    temporal = CauseErrors(
        alone_arcsec=scale * np.array([frames.temporal_px(m) for m in methods]),
        switched_off_arcsec=undefined,
        predicted_arcsec=scale * np.array([model.temporal_px for model in models]),
        single_position_alone_arcsec=undefined,
        single_position_predicted_arcsec=undefined,
    )
    return [*switched, temporal]


@dataclass(frozen=True, slots=True, kw_only=True)
class SCurves:
    """S-curves: error of noiseless centroids of the central star along x over a pixel, mean over phases in y."""

    phase_px: FloatArray = col("Position of the star in its pixel", "px", dims="phase")
    s_curve_px: FloatArray = col("Centroid − truth", "px", "", "method phase")


@dataclass(frozen=True, slots=True, kw_only=True)
class StepResiduals:
    """Residuals of eq. 7-8, first centroider, and of the light itself."""

    residual_px: FloatArray = col("Residual", "px", "", "star axis")
    light_px: FloatArray = col("True", "px", "", "star axis")


PHASES = 101
"""Pixel phases along a row."""
ROW_PHASES = (-0.4, -0.2, 0.0, 0.2, 0.4)
"""Pixel phases across the row over which an S-curve is averaged."""


def compute_s_curves(bench: Bench, instrument: Instrument, psf: EffectivePsf) -> SCurves:
    """S-curves of a star from its PSF."""
    size = bench.window_px
    phase_px = np.linspace(-0.5, 0.5, PHASES)
    position_px = np.stack(np.meshgrid(phase_px, ROW_PHASES), axis=-1).reshape(-1, 2) + size // 2
    corner_px = np.zeros(position_px.shape, np.int64)
    windows = expected_windows([psf], position_px, bench.signal_e, window_px=size, corner_px=corner_px)
    noise_model = nominal_noise(instrument)
    errors_px = [
        (noiseless_positions(centroider, windows, noise_model) - position_px)[:, 0]
        for centroider in centroiders(bench, [psf]).values()
    ]
    return SCurves(phase_px=phase_px, s_curve_px=np.reshape(errors_px, (len(errors_px), len(ROW_PHASES), -1)).mean(1))


def axes(config: HsfeConfig) -> Quantities:
    """Dimensions that all sections share."""
    return point_quantities(config.methods)


def run(config: HsfeConfig, *, progress: Progress) -> dict[str, Any]:
    """Predict the test, step and read out, predict again for the measured path."""
    bench, instrument = point_laboratory(config, config.target)
    check_steps(config.steps, bench)
    rest = star_target_directions(bench, instrument, config.place_px)
    streams = Streams(config.seed).child("hsfe")
    path = step_path(config.hexapod, config.steps, instrument.pixel_arcsec, streams.generator("hexapod"))
    scene = prepared_scene(bench, instrument, turned(rest, path.true_rad), progress)
    test: dict[str, Any] = {"place_px": config.place_px, "subtraction": config.subtraction}
    with progress.stage("before the test"):
        model: dict[str, Any] = {
            "psf": scene.psfs(rest),
            "hexapod": config.hexapod,
            "defect": sensor_maps(instrument.detector).defect,
            "draws": config.draws,
            "seed": config.seed,
            **test,
        }
        prior = predict_high_frequency(bench, instrument, config.steps, **model)
    with progress.stage("steps", total=config.steps.positions) as stage:
        frames = measure_high_frequency(
            bench,
            instrument,
            config.hexapod,
            config.steps,
            streams=streams,
            scene=scene,
            advance=stage.advance,
            **test,
        )
    with progress.stage("after the test"):
        # common shift of the image at each position, by a centroider without S-curve (`motion_method`)
        shift_px = (frames.mean_px(motion_method(bench.methods)) - prior.position_px).mean(1)
        posterior = predict_high_frequency(
            bench, instrument, config.steps, shift_px=shift_px, corner_px=frames.corner_px, **model
        )
        s_curves = compute_s_curves(bench, instrument, model["psf"][len(rest) // 2])
    star = point_signal(config, instrument)
    residual_px = step_residual_px(frames.mean_px(config.methods[0]))
    by_method = [
        tabulate_steps(frames, prior.method[method], posterior.method[method], method) for method in config.methods
    ]
    return {
        "test": TestConditions(
            frames=frames.frames,
            stars=len(rest),
            positions=config.steps.positions,
            subtraction=config.subtraction,
            pixel_arcsec=frames.pixel_arcsec,
            signal_e=star.signal_e,
            magnitude_mag=star.magnitude_mag,
            signal_star=star.star,
            hsfe_arcsec=by_method[0].measured_arcsec,
            published_arcsec=ACC18_ARCSEC["HSFE"] if is_published_sensor(config) else None,
            residual_motion_px=frames.motion_px,
            residual_arcsec=frames.pixel_arcsec * residual_px,
        ),
        "steps": by_method,
        "causes": tabulate_causes(frames, posterior, config.methods),
        "s_curves": s_curves,
        "residuals": [
            StepResiduals(residual_px=measured_px, light_px=light_px)
            for measured_px, light_px in zip(residual_px, step_residual_px(frames.photon_px), strict=True)
        ],
        "line_of_sight": line_of_sight(bench, instrument, frames.motion_px2),
    }


SECTIONS = {
    "test": Section(
        record=TestConditions,
        figures={"step_residuals": cloud("residual_arcsec", ellipses="hsfe_arcsec published_arcsec")},
    ),
    "steps": Section(
        record=StepErrors,
        dim="method",
        table="hsfe",
        rows="method axis",
        caption="HSFE (3 σ) of one star.",
        note="*HSFE of ACC18*: eq. 9-12, the RMS difference of neighbouring positions, "
        "temporal noise included. *HSFE / √2*: without temporal noise, divided by √2, as for "
        "independent errors. *Single position*: mean centroid minus truth, common motion and temporal "
        "noise removed. Predicted ±: from detector to detector.",
        verdicts=[
            agree(name, 1.0, each="method", slack=MODEL_SLACK, title=title)
            for name, title in (
                ("ratio", "HSFE of ACC18 over its prediction for the measured path"),
                ("single_position_ratio", "error of a single position over its prediction"),
            )
        ],
    ),
    "causes": Section(
        record=CauseErrors,
        dim="cause",
        axes=lambda q, _: q.axis("cause", list(CAUSE_NAMES), "Cause", names=CAUSE_NAMES),
        rows="method cause",
        across="axis",
        columns="alone_arcsec switched_off_arcsec predicted_arcsec",
        caption="Contribution of each cause to HSFE (3 σ).",
        note="*Alone*: a detector with only this cause compared with a detector without any. *Switched "
        "off*: all causes compared with all but this. All runs use the same random streams; their "
        "residual noise is subtracted.",
        figures={
            "cause_bars": bars("cause", bars="alone_arcsec", points="predicted_arcsec", by="axis", panels="method")
        },
    ),
    "s_curves": Section(
        record=SCurves,
        figures={
            "s_curves": curves("phase_px", lines="s_curve_px", by="method", level=0.0, width="half", aspect_ratio=1.0)
        },
    ),
    "residuals": Section(record=StepResiduals, dim="step", across="axis", caption="Residuals."),
    "line_of_sight": LINE_OF_SIGHT,
}
