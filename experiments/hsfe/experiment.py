"""High spatial frequency error (ACC18 eq. 3-12): by centroider, by cause, along the path."""

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
from experiments.hsfe.settings import Config
from experiments.laboratory.bench.point_bench import Bench, centroiders, motion_method
from experiments.laboratory.bench.point_laboratory import (
    point_laboratory,
    point_quantities,
    point_signal,
    prepared_scene,
)
from experiments.laboratory.bench.readout.frames import nominal_noise
from experiments.laboratory.devices.collimator_effects import SIGHT, sight_of
from experiments.laboratory.devices.hexapod import step_path, turned
from experiments.laboratory.high_frequency import HighFrequencyMeasurement, check_steps, measure_high_frequency
from experiments.laboratory.high_frequency_model import HighFrequencyPrediction, predict_high_frequency
from experiments.laboratory.settings.published import ACC18_ARCSEC, is_published_sensor
from experiments.laboratory.temporal_error import target_place
from optics.arrays import FloatArray
from render.detector.maps import sensor_maps
from render.engine.random import Streams
from render.records import EffectivePsf
from render.sensor_file.instrument import Instrument

Axes = Sequence[Measured]
MODEL_SLACK = 0.03
"""Largest error of the linear model: a threshold smooths the S-curve under noise by about this much."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Test:
    """Test conditions, and the number of ACC18 by the main centroider."""

    frames: int = col("Frames")
    stars: int = col("Stars")
    positions: int = col("Positions")
    subtraction: str = col("Subtraction")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec")
    signal_e: float = col("Signal", "e-", ".0f")
    magnitude_mag: float = col("V magnitude of the signal", "mag", ".2f")
    signal_star: str = col("Star")
    hsfe_arcsec: Axes = col("HSFE as printed", "arcsec", dims="axis")
    published_arcsec: Sequence[float] | None = col("Published", "arcsec", ".2f", "axis", default=None)
    # True motion of the light in the steps without the mean over the stars: roll and distortion
    motion_px: FloatArray = col("Residual motion", "px", ".5f", "axis")
    residual_arcsec: FloatArray = col("Residuals of the steps", "arcsec", ".3f", "step star axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class Steps:
    """High spatial frequency error (3 sigma) of a centroider."""

    document_arcsec: Axes = col("HSFE of ACC18", "arcsec", ".3f", "axis")
    predicted_arcsec: Axes = col("HSFE predicted", "arcsec", ".3f", "axis")
    ratio: Axes = col("Measured / predicted", "", ".3f", "axis")
    halved_arcsec: FloatArray = col("HSFE / √2", "arcsec", ".3f", "axis")
    one_position_arcsec: FloatArray = col("Single position", "arcsec", ".3f", "axis")
    one_position_predicted_arcsec: FloatArray = col("Single position, predicted", "arcsec", ".3f", "axis")
    one_position_ratio: Axes = col("One position, ratio", "", ".3f", "axis", shown=False)
    predicted_before_arcsec: Axes = col(
        "Predicted before the test",
        "arcsec",
        ".3f",
        "axis",
        shown=False,
    )
    # Shown, not judged: one large step error of the hexapod moves it further than any normal deviate would
    ratio_before: Axes = col("Ratio to the prediction before the test", "", ".3f", "axis", shown=False)
    dark_arcsec: FloatArray = col("Noise of the dark frames", "arcsec", ".3f", "axis", shown=False)
    roll_arcsec: FloatArray = col("Roll of the hexapod", "arcsec", ".3f", "axis", shown=False)
    quadrature_arcsec: FloatArray = col("Parts in quadrature", "arcsec", ".3f", "axis", shown=False)


def steps(seen: HighFrequencyMeasurement, before: StepPrediction, after: StepPrediction, method: str) -> Steps:
    """Measured, predicted for drawn paths of the hexapod, and predicted for the path that was seen."""
    scale, printed = 3.0 * seen.pixel_arcsec, seen.high_frequency_error(method)
    mean, sigma = seen.mean_px(method), seen.sigma_px(method)
    document, single = step_rms_px(mean), seen.single_px(method)
    single_scatter = np.hypot(after.position_rms_scatter_px, position_rms_scatter_px(single, sigma, seen.frames))
    parts_px = {
        "halved": independent_position_rms_px(document, sigma, seen.frames),
        "one_position": single,
        "one_position_predicted": after.position_rms_px,
        "dark": after.dark_px,
        "roll": after.roll_px,
        "quadrature": seen.quadrature_px(method),
    }
    return Steps(
        document_arcsec=measured(printed.arcsec, printed.uncertainty_arcsec, n=printed.n, unit="arcsec"),
        predicted_arcsec=measured(scale * after.step_rms_px, scale * after.step_rms_scatter_px),
        predicted_before_arcsec=measured(scale * before.step_rms_px, scale * before.step_rms_scatter_px),
        ratio=over(document, after.step_rms_px, after.step_rms_scatter_px),
        ratio_before=over(document, before.step_rms_px, before.step_rms_scatter_px),
        one_position_ratio=over(single, after.position_rms_px, single_scatter),
        **{f"{name}_arcsec": scale * part for name, part in parts_px.items()},
    )


def over(value: FloatArray, expected: FloatArray, scatter: FloatArray) -> Axes:
    """Measured over predicted; the uncertainty is the scatter of the prediction over chips, paths and noise."""
    ratios: Axes = measured(value / expected, scatter / expected)
    return ratios


CAUSE_NAMES = {
    "s_curve": "S-curve",
    "prnu": "response (PRNU)",
    "pattern": "offset pattern (DSNU)",
    "defects": "masked defects",
    "temporal": "temporal noise / √N",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """Part of a cause (3 sigma): in the number of ACC18, and in the error of one position."""

    alone_arcsec: FloatArray = col("Alone", "arcsec", ".4f", "method axis")
    off_arcsec: FloatArray = col("Switched off", "arcsec", ".4f", "method axis")
    cause_predicted_arcsec: FloatArray = col("Predicted", "arcsec", ".4f", "method axis")
    alone_position_arcsec: FloatArray = col(
        "Alone, one position",
        "arcsec",
        ".4f",
        "method axis",
    )
    position_predicted_arcsec: FloatArray = col(
        "Predicted",
        "arcsec",
        ".4f",
        "method axis",
    )


def causes(seen: HighFrequencyMeasurement, after: HighFrequencyPrediction, methods: Sequence[str]) -> list[Cause]:
    """Causes, and averaged temporal noise, which cannot be switched off."""
    scale, model = 3.0 * seen.pixel_arcsec, [after.method[m] for m in methods]
    parts = [
        Cause(
            alone_arcsec=scale * np.array([seen.cause_px(m, cause) for m in methods]),
            off_arcsec=scale * np.array([seen.cause_px(m, cause, alone=False) for m in methods]),
            cause_predicted_arcsec=scale * np.array([one.cause_px[cause] for one in model]),
            alone_position_arcsec=scale * np.array([seen.cause_single_px(m, cause) for m in methods]),
            position_predicted_arcsec=scale * np.array([one.cause_position_px[cause] for one in model]),
        )
        for cause in CAUSES
    ]
    none = np.full((len(methods), 2), np.nan)
    temporal = Cause(
        alone_arcsec=scale * np.array([seen.temporal_px(m) for m in methods]),
        off_arcsec=none,
        cause_predicted_arcsec=scale * np.array([one.temporal_px for one in model]),
        alone_position_arcsec=none,
        position_predicted_arcsec=none,
    )
    return [*parts, temporal]


@dataclass(frozen=True, slots=True, kw_only=True)
class Curves:
    """S-curves: error of noiseless centroids of the middle star across a pixel, mean over the phase along rows."""

    phase_px: FloatArray = col("Position of the star in its pixel", "px", dims="phase")
    s_curve_px: FloatArray = col("Centroid − truth", "px", "", "method phase")


@dataclass(frozen=True, slots=True, kw_only=True)
class Residuals:
    """Residuals of eq. 7-8, first centroider, and of the light itself."""

    residual_px: FloatArray = col("Residual", "px", "", "star axis")
    true_px: FloatArray = col("True", "px", "", "star axis")


PHASES = 101
ACROSS = (-0.4, -0.2, 0.0, 0.2, 0.4)


def s_curves(bench: Bench, instrument: Instrument, psf: EffectivePsf) -> Curves:
    """S-curves of a star from its PSF."""
    size, along = bench.window_px, np.linspace(-0.5, 0.5, PHASES)
    x, y = (v.ravel() for v in np.meshgrid(along, ACROSS))
    place, corner = np.column_stack([x, y]) + size // 2, np.zeros((len(x), 2), np.int64)
    windows = expected_windows([psf], place, bench.signal_e, window_px=size, corner_px=corner)
    told = nominal_noise(instrument)
    errors = [noiseless_positions(one, windows, told)[:, 0] - place[:, 0] for one in centroiders(bench, [psf]).values()]
    return Curves(phase_px=along, s_curve_px=np.array(errors).reshape(len(errors), len(ACROSS), -1).mean(1))


def axes(config: Config) -> Quantities:
    """Dimensions that all sections share."""
    return point_quantities(config.methods)


def run(config: Config, *, progress: Progress) -> dict[str, Any]:
    """Step, read out, reduce, predict."""
    bench, instrument = point_laboratory(config, config.target)
    check_steps(config.steps, bench)
    rest = target_place(bench, instrument, config.place_px)
    streams = Streams(config.seed).child("hsfe")
    path = step_path(config.hexapod, config.steps, instrument.pixel_arcsec, streams.generator("hexapod"))
    scene = prepared_scene(bench, instrument, turned(rest, path.true_rad), progress)
    place: dict[str, Any] = {"place_px": config.place_px, "subtraction": config.subtraction}
    with progress.stage("before the test"):
        model: dict[str, Any] = {
            "psf": scene.psfs(rest),
            "hexapod": config.hexapod,
            "defect": sensor_maps(instrument.detector).defect,
            "draws": config.draws,
            "seed": config.seed,
            **place,
        }
        before = predict_high_frequency(bench, instrument, config.steps, **model)
    with progress.stage("steps", total=config.steps.positions) as stage:
        here: dict[str, Any] = {"streams": streams, "scene": scene, "advance": stage.advance, **place}
        seen = measure_high_frequency(bench, instrument, config.hexapod, config.steps, **here)
    with progress.stage("after the test"):
        # where the image stood is best read with the method that has no S-curve of its own
        shift_px = (seen.mean_px(motion_method(bench.methods)) - before.place_px).mean(1)
        reached: dict[str, Any] = {"shift_px": shift_px, "corner_px": seen.corner_px}
        after = predict_high_frequency(bench, instrument, config.steps, **reached, **model)
        shapes = s_curves(bench, instrument, model["psf"][len(rest) // 2])
    first, star = config.methods[0], point_signal(config, instrument)
    left = step_residual_px(seen.mean_px(first))
    every = [steps(seen, before.method[m], after.method[m], m) for m in config.methods]
    return {
        "test": Test(
            frames=seen.frames,
            stars=len(rest),
            positions=config.steps.positions,
            subtraction=config.subtraction,
            pixel_arcsec=seen.pixel_arcsec,
            signal_e=star.signal_e,
            magnitude_mag=star.magnitude_mag,
            signal_star=star.star,
            hsfe_arcsec=every[0].document_arcsec,
            published_arcsec=ACC18_ARCSEC["HSFE"] if is_published_sensor(config) else None,
            motion_px=seen.motion_px,
            residual_arcsec=seen.pixel_arcsec * left,
        ),
        "steps": every,
        "causes": causes(seen, after, config.methods),
        "curves": shapes,
        "residuals": [
            Residuals(residual_px=one, true_px=true)
            for one, true in zip(left, step_residual_px(seen.photon_px), strict=True)
        ],
        "sight": sight_of(bench, instrument, seen.motion_px2),
    }


SECTIONS = {
    "test": Section(
        record=Test,
        figures={
            "step_residuals": cloud("residual_arcsec", ellipses="hsfe_arcsec published_arcsec"),
        },
    ),
    "steps": Section(
        record=Steps,
        dim="method",
        table="hsfe",
        rows="method axis",
        caption="HSFE (3 σ) of one star.",
        note="*HSFE of ACC18*: eq. 9-12, the RMS difference of neighbouring positions, "
        "temporal noise included. *HSFE / √2*: without temporal noise, divided by √2, as for "
        "independent errors. *Single position*: mean centroid minus truth, common motion and temporal "
        "noise removed. Predicted ±: from chip to chip.",
        verdicts=[
            agree(name, 1.0, each="method", slack=MODEL_SLACK, title=title)
            for name, title in (
                ("ratio", "HSFE of ACC18 over its prediction for the measured path"),
                ("one_position_ratio", "error of a single position over its prediction"),
            )
        ],
    ),
    "causes": Section(
        record=Cause,
        dim="cause",
        axes=lambda q, _: q.axis("cause", list(CAUSE_NAMES), "Cause", names=CAUSE_NAMES),
        rows="method cause",
        across="axis",
        columns="alone_arcsec off_arcsec cause_predicted_arcsec",
        caption="Contribution of each cause to HSFE (3 σ).",
        note="*Alone*: a detector with only this cause compared with a detector without any. *Switched "
        "off*: all causes compared with all but this. All runs use the same random streams; their "
        "residual noise is subtracted.",
        figures={
            "cause_bars": bars(
                "cause", bars="alone_arcsec", points="cause_predicted_arcsec", by="axis", panels="method"
            )
        },
    ),
    "curves": Section(
        record=Curves,
        figures={
            "s_curves": curves("phase_px", lines="s_curve_px", by="method", level=0.0, width="half", aspect_ratio=1.0)
        },
    ),
    "residuals": Section(record=Residuals, dim="step", across="axis", caption="Residuals."),
    "sight": SIGHT,
}
