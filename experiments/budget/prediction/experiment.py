"""The budget by prediction alone: run and declaration; what ``--predict-only`` of `experiments.budget` runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from experiments.budget.settings import Config
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress

if TYPE_CHECKING:
    from experiments.budget.laboratory import Laboratory
    from experiments.budget.sweep import Sweep
    from experiments.budget.terms import PredictedTerms

__all__ = ["Prediction", "experiment", "run"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """What is known without frames."""

    config: Config  # Settings
    lab: Laboratory  # The laboratory
    predicted: PredictedTerms  # Of the centroider that counts
    sweep: Sweep | None  # The budget against a parameter


def run(config: Config, *, progress: Progress) -> Prediction:
    """Predict every term for the centroider that counts, and the sweep; pixel term at one place, few draws."""
    from experiments.budget.laboratory import build_laboratory
    from experiments.budget.predict import predict_terms
    from experiments.budget.sweep import DRAWS, check_full_well, counting, predict_sweep
    from experiments.budget.terms import Psfs
    from experiments.laboratory.checks import check_light
    from experiments.laboratory.target import corner_directions

    lab = build_laboratory(counting(config))
    check_light(lab.filtered, lab.instrument, corner_directions(config.target, lab.instrument))
    check_full_well(lab)
    psfs, sweep_range, sweep = Psfs(), config.sweep_range(), None
    with progress.stage("predict"):
        predicted = predict_terms(lab, psfs=psfs, draws=DRAWS, step_draws=DRAWS, coarse=True)[config.centroid]
    if sweep_range is not None:
        with progress.stage("sweep", total=len(sweep_range.values)) as stage:
            sweep = predict_sweep(config, sweep_range, psfs, advance=stage.advance)
    return Prediction(config=config, lab=lab, predicted=predicted, sweep=sweep)


experiment = Experiment(
    name="budget",
    config=Config,
    run=run,
    criteria=lambda _: [],  # all of them compare with frames
    show=("budget",),
)
