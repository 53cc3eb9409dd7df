"""Temporal error of a star camera (ACC18 eq. 1-2, Fig. 5): frames of a static target, scatter against signal.

A 5 x 5 point target stands still; frames are rendered, read out with noise and rounding, detected and centroided at
several signal levels. The scatter of every star's centroid stands beside the Cramer-Rao bound and two predictions that
use no frames: the noise model carried through each centroider's influence function, and noise drawn on PSF windows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.laboratory.own_frames.experiment import or_own_frames
from experiments.temporal.settings import Config

if TYPE_CHECKING:
    from experiments.temporal.result import Result

__all__ = ["Config", "experiment", "main", "run"]


def run(config: Config, *, progress: Progress) -> Result:
    """Render, read out, reduce, predict."""
    import numpy as np

    from experiments.laboratory.brightness import BrightnessControl
    from experiments.laboratory.collimator_effects import line_of_sight
    from experiments.laboratory.known_motion import measure_shaken
    from experiments.laboratory.point_scene import point_laboratory, prepared_scene
    from experiments.laboratory.published import is_published_sensor
    from experiments.laboratory.temporal_error import measure_temporal, predict_temporal, target_place
    from experiments.temporal.result import Result, published_levels
    from render.engine.random import Streams

    bench, instrument = point_laboratory(config, config.target)
    streams = Streams(config.seed).child("temporal")
    brightness = config.brightness
    control = BrightnessControl(
        lowest_e=brightness.lowest_e,
        highest_e=brightness.highest_e,
        setting_error_ratio=brightness.setting_error_ratio,
    )
    wanted = control.levels_e(brightness.levels)
    reached = control.reached_e(wanted, streams.generator("brightness"))
    scene = prepared_scene(bench, instrument, target_place(bench, instrument, config.place_px)[None], progress)
    with progress.stage("frames", total=len(reached) + 1) as stage:
        measured, nominal = (
            measure_temporal(
                bench,
                instrument,
                levels_e=levels_e,
                place_px=config.place_px,
                subtractions=("dark", "raw"),
                streams=root,
                scene=scene,
                advance=stage.advance,
            )
            for levels_e, root in ((reached, streams), (None, streams.child("nominal")))
        )
    light = nominal.light
    with progress.stage("shaken target"):
        shaken = measure_shaken(scene, light.direction, light.psf, streams.child("shaken"))
    with progress.stage("prediction"):
        psf = light.psf
        predicted = predict_temporal(
            bench, instrument, psf=psf, levels_e=reached, place_px=config.place_px, draws=config.draws, seed=config.seed
        )
        at_nominal = predict_temporal(
            bench, instrument, psf=psf, place_px=config.place_px, draws=config.draws, seed=config.seed + 1
        )
        known = is_published_sensor(config)
        levels = published_levels(bench, instrument, psf, config.place_px) if known else {}
    motion_px2 = np.concatenate([measured.motion_px2, nominal.motion_px2])
    return Result(
        config=config,
        instrument=instrument,
        measured=measured,
        nominal=nominal,
        predicted=predicted,
        predicted_nominal=at_nominal,
        shaken=shaken,
        sight=line_of_sight(bench, instrument, motion_px2, bench.frames),
        published_level_e=levels,
    )


rendered = Experiment(
    name="temporal",
    config=Config,
    run=run,
    takes="30 s (--quick: 10 s)",
    examples={
        "--quick": "a small run",
        "--set source.signal_e=2000 --set centroid=gaussian": "fainter stars, another centroider",
    },
    show=("temporal_error",),
    quick={
        "frames": 30,
        "draws": 30,
        "brightness.levels": 5,
        "target.rows": 3,
        "target.columns": 3,
        "compare": ["tcog", "epsf"],
    },
)
experiment = or_own_frames(rendered, "experiments.temporal.own_frames")
main = command(experiment)
