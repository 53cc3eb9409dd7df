"""The error budget: run and declaration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.budget.prediction.experiment import experiment as prediction
from experiments.budget.settings import Config
from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress

if TYPE_CHECKING:
    from experiments.budget.result import Result

__all__ = ["Config", "experiment", "main", "run"]


def run(config: Config, *, progress: Progress) -> Result:
    """Predict, measure, vary."""

    from experiments.budget.attitude import StarErrors, attitude_study
    from experiments.budget.combine import published
    from experiments.budget.laboratory import build_laboratory
    from experiments.budget.measure import measure_terms, steps_of
    from experiments.budget.predict import predict_terms
    from experiments.budget.result import Result
    from experiments.budget.sweep import check_full_well, predict_sweep, predict_tornado, tornado_size
    from experiments.budget.terms import Psfs
    from experiments.budget.thermal import thermal_term
    from experiments.budget.tolerances import tolerance_study
    from experiments.budget.tune import differences
    from experiments.laboratory.checks import check_light
    from experiments.laboratory.collimator_effects import chromatic_effect
    from experiments.laboratory.published import is_published_sensor
    from experiments.laboratory.readout.centroids import motion_method
    from experiments.laboratory.target import corner_directions
    from render.engine.random import Streams

    lab = build_laboratory(config)
    check_light(lab.filtered, lab.instrument, corner_directions(config.target, lab.instrument))
    check_full_well(lab)
    psfs, streams, sweep_range = Psfs(), Streams(config.seed).child("budget"), config.sweep_range()
    with progress.stage("predict"):
        predicted = predict_terms(lab, psfs=psfs)
    with progress.stage("measure", total=steps_of(lab)) as stage:
        measured = measure_terms(lab, advance=stage.advance)
    with progress.stage("temperature"):
        thermal = thermal_term(lab, streams.child("temperature"))
    sweep, tornado = None, None
    if sweep_range is not None:
        with progress.stage("sweep", total=len(sweep_range.values)) as stage:
            sweep = predict_sweep(config, sweep_range, psfs, advance=stage.advance)
    if config.tornado.parameters:
        with progress.stage("tornado", total=tornado_size(config)) as stage:
            tornado = predict_tornado(config, psfs, advance=stage.advance)
    with progress.stage("built lenses", total=config.tolerances.draws) as stage:
        tolerances = tolerance_study(lab, streams.child("tolerances"), advance=stage.advance)
    with progress.stage("attitude", total=len(config.attitude.counts)) as stage:
        errors = StarErrors.of(measured[config.centroid].budget)
        attitude = attitude_study(
            lab.instrument, errors, config.attitude, streams.child("attitude"), advance=stage.advance
        )
    # a fit of the true PSF follows all the light, whatever counts
    seen = measured[motion_method(config.methods)].chromatic
    corners = corner_directions(config.target, lab.instrument)
    collimator = chromatic_effect(lab.filtered, lab.instrument, corners, seen.table1_px, seen.sigma_px)
    known = is_published_sensor(config) or config.published_within_fraction is not None
    return Result(
        config=config,
        lab=lab,
        predicted=predicted,
        measured=measured,
        published=published() if known else None,
        sweep=sweep,
        tornado=tornado,
        tolerances=tolerances,
        attitude=attitude,
        thermal=thermal,
        collimator=collimator,
        changed=differences(config),
    )


def _instead(config: Config) -> Experiment | None:
    return prediction if config.predict_only else None


experiment = Experiment(
    name="budget",
    config=Config,
    run=run,
    takes="7 min (--quick: 45 s)",
    examples={
        "--quick": "a small run",
        "--sweep detector.read_noise_e=2:20:10": "the budget against the read noise",
        "--predict-only --set sweep=": "the predicted terms alone, in seconds",
        "--config acc18_tuned": "an instrument with the published budget",
    },
    extra="quantities:extra",
    show=("budget",),
    options={
        "sweep": ("sweep", "The budget against a parameter: KEY=LOW:HIGH:POINTS[:log] or KEY=A,B,C."),
        "predict-only": ("predict_only", "No rendered frames: the predicted terms and sums alone."),
    },
    instead=_instead,
    quick={
        "frames": 10,
        "dark_frames": 30,
        "target.rows": 3,
        "target.columns": 3,
        "steps.places": 1,
        "steps.positions": 6,
        "sweep": "",
        "tornado.parameters": ["source.signal_e"],
        "tolerances.draws": 30,
        "attitude.trials": 500,
        "attitude.counts": [2, 5, 10, 30],
    },
)
main = command(experiment)
