"""A sweep: run and declaration; `experiments.camera` hands over to it when ``sweep`` is set."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from experiments.camera.settings import Config
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress

if TYPE_CHECKING:
    from experiments.camera.sweep.study import SweepStudy

__all__ = ["experiment", "run"]


def run(config: Config, *, progress: Progress) -> SweepStudy:
    """Predict every value."""
    from experiments.camera.sweep.study import sweep_study

    with progress.stage("sweep", total=math.prod(len(one.values) for one in config.sweep_ranges)) as stage:
        return sweep_study(config, advance=stage.advance)


experiment = Experiment(
    name="camera",
    config=Config,
    run=run,
    show=("sweep",),
    renders=lambda config: config.sweep_measured,
)
