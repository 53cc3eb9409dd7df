"""My camera: run and declaration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.camera.comparison.experiment import experiment as comparison
from experiments.camera.settings import Config
from experiments.camera.sweep.experiment import experiment as sweep
from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress

if TYPE_CHECKING:
    from experiments.camera.result import Result
    from experiments.camera.tornado import Swing

__all__ = ["Config", "experiment", "main", "run"]


def run(config: Config, *, progress: Progress) -> Result:
    """Predict, warm and cool, vary, render."""
    from experiments.camera.prediction import predict_camera
    from experiments.camera.result import Result
    from experiments.camera.thermal import thermal_study
    from experiments.camera.tornado import predict_tornado, tornado_size
    from experiments.laboratory.checks import focus_remark

    with progress.stage("predict"):
        prediction = predict_camera(config)
    state = prediction.state
    if remark := focus_remark(state.instrument.camera, state.light.wavelength_nm.ravel()):
        progress.note(remark)
    with progress.stage("temperature"):
        thermal = thermal_study(config)
    swings: tuple[Swing, ...] = ()
    if config.tornado.parameters:
        with progress.stage("what to change", total=tornado_size(config, prediction)) as stage:
            swings = predict_tornado(config, prediction, advance=stage.advance)
    rendered = None
    if not config.predict_only:
        from experiments.camera.rendered import render_frames

        with progress.stage("frames", total=config.frames.readouts + config.frames.sky) as stage:
            rendered = render_frames(prediction, advance=stage.advance)
    return Result(config=config, prediction=prediction, thermal=thermal, swings=swings, rendered=rendered)


def _instead(config: Config) -> Experiment | None:
    return sweep if config.sweep else None


experiment = Experiment(
    name="camera",
    config=Config,
    run=run,
    takes="1 min (--quick: 40 s)",
    examples={
        "--sensor my.toml": "your own sensor",
        "--sensor my.toml --predict-only": "the answer without frames, in 17 s",
        "--sensor my.toml --set instrument.exposure_s=0.2": "the same with another exposure",
        "--sensor my.toml --sweep instrument.exposure_s=0.05:0.4:8": "what if: curves over the exposure, in seconds",
        "--sensor my.toml --sweep exposure_s=0.01:1:9:log": "spaced in the logarithm; exposure_s=0.05,0.1,0.4: a list",
        "--sensor my.toml --sweep exposure_s=0.05:0.4:8 --sweep f_number=3:5:5": "a map over two keys",
        "--sensor a.toml --sensor b.toml": "sensors side by side, by prediction",
    },
    show=("requirements",),
    options={
        "predict-only": ("predict_only", "No rendered frames: an answer in seconds."),
        "sweep": (
            "sweep",
            "KEY=LOW:HIGH:POINTS[:log] or KEY=A,B,C: predict a range of any number of the sensor; two make a map.",
        ),
    },
    instead=_instead,
    comparison=comparison,
    renders=lambda config: not config.predict_only,
    quick={
        "sky.attitudes": 200,
        "thermal.points": 3,
        "frames.sky": 4,
        "frames.chart_stars": 200,
        "frames.readouts": 5,
        "dark_frames": 8,
    },
)
main = command(experiment)
