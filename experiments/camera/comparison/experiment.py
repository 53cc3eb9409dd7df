"""Sensors side by side: run and declaration; what several ``--sensor`` of `experiments.camera` run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field, field_validator

from experiments.camera.settings import Config
from experiments.harness.config import ExperimentConfig
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress

if TYPE_CHECKING:
    from experiments.camera.comparison.study import SideBySide

__all__ = ["ComparisonConfig", "experiment", "run"]


class ComparisonConfig(ExperimentConfig):
    """One configuration of the camera report per sensor."""

    sensors: tuple[Config, ...] = Field(default=(Config(),), min_length=1, max_length=7, description="side by side")

    @field_validator("sensors")
    @classmethod
    def _no_sweep(cls, sensors: tuple[Config, ...]) -> tuple[Config, ...]:
        if any(one.sweep for one in sensors):
            raise ValueError("a sweep is of one sensor: give one --sensor, or no --sweep")
        return sensors


def run(config: ComparisonConfig, *, progress: Progress) -> SideBySide:
    """Predict every sensor."""
    from experiments.camera.comparison.study import side_by_side

    with progress.stage("sensors", total=len(config.sensors)) as stage:
        return side_by_side(config.sensors, advance=stage.advance)


experiment = Experiment(
    name="camera",
    config=ComparisonConfig,
    run=run,
    show=("sensors", "requirements"),
    criteria=lambda _: [],  # no frames, nothing that could be confirmed
    renders=lambda _: False,
)
