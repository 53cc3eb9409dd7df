"""High spatial frequency error (ACC18 eq. 3-12): small steps of a hexapod, split by cause, predicted without frames.

A 5 x 5 point target is stepped over the pixels by 0.2 px at a time; thirty frames at every position are rendered, read
out, detected and centroided, and reduced as the document does. Response and offset patterns and bad pixels are switched
off one by one on the same random streams; the S-curve is what is left of an image without noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.hsfe.settings import Config
from experiments.laboratory.own_frames import or_own_frames

if TYPE_CHECKING:
    from experiments.hsfe.result import Result

__all__ = ["Config", "experiment", "main", "run"]


def run(config: Config, *, progress: Progress) -> Result:
    """Step, read out, reduce, predict."""
    from experiments.hsfe.result import Result, geometry_study, s_curves
    from experiments.laboratory.collimator_effects import line_of_sight
    from experiments.laboratory.hexapod import Hexapod, turned
    from experiments.laboratory.high_frequency import StepPlan, measure_high_frequency
    from experiments.laboratory.high_frequency_model import predict_high_frequency
    from experiments.laboratory.known_motion import measure_walking
    from experiments.laboratory.point_scene import point_laboratory, prepared_scene
    from experiments.laboratory.readout.centroids import motion_method
    from experiments.laboratory.temporal_error import target_place
    from render.detector.maps import sensor_maps
    from render.engine.random import Streams

    bench, instrument = point_laboratory(config, config.target)
    plan, hexapod = StepPlan(**config.steps.model_dump()), Hexapod(**config.hexapod.model_dump())
    plan.check(bench)
    rest = target_place(bench, instrument, config.place_px)
    streams = Streams(config.seed).child("hsfe")
    path = plan.path(instrument, hexapod, streams.generator("hexapod"))
    scene = prepared_scene(bench, instrument, turned(rest, path.true_rad), progress)
    with progress.stage("before the test"):
        psf, defect = scene.psfs(rest), sensor_maps(instrument.detector).defect
        before = predict_high_frequency(
            bench,
            instrument,
            plan,
            psf=psf,
            hexapod=hexapod,
            place_px=config.place_px,
            subtraction=config.subtraction,
            defect=defect,
            draws=config.draws,
            seed=config.seed,
        )
    with progress.stage("steps", total=plan.positions) as stage:
        measured = measure_high_frequency(
            bench,
            instrument,
            hexapod,
            plan,
            place_px=config.place_px,
            subtraction=config.subtraction,
            streams=streams,
            scene=scene,
            advance=stage.advance,
        )
    with progress.stage("walking points"):
        walking = measure_walking(
            scene,
            hexapod,
            plan,
            rest,
            streams.child("walking"),
            place_px=config.place_px,
            subtraction=config.subtraction,
        )
    with progress.stage("after the test"):
        # where the image stood is best read with the method that has no S-curve of its own
        after = predict_high_frequency(
            bench,
            instrument,
            plan,
            psf=psf,
            hexapod=hexapod,
            shift_px=measured.common_shift_px(motion_method(bench.methods), before.place_px),
            place_px=config.place_px,
            subtraction=config.subtraction,
            defect=defect,
            draws=config.draws,
            seed=config.seed,
        )
        curves = s_curves(bench, instrument, psf, rest)
        geometry = geometry_study(bench, instrument, plan, hexapod, rest, streams)
    return Result(
        config=config,
        instrument=instrument,
        measured=measured,
        before=before,
        after=after,
        walking=walking,
        curves=curves,
        geometry=geometry,
        sight=line_of_sight(bench, instrument, measured.motion_px2, bench.frames),
    )


rendered = Experiment(
    name="hsfe",
    config=Config,
    run=run,
    takes="1 min (--quick: 15 s)",
    examples={
        "--quick": "a small run",
        "--set steps.step_px=0.5 --set subtraction=raw": "longer steps, fixed patterns left in",
    },
    show=("hsfe",),
    quick={
        "steps.positions": 6,
        "target.rows": 3,
        "target.columns": 3,
        "compare": ["gaussian", "epsf"],
    },
)
experiment = or_own_frames(rendered)
main = command(experiment)
