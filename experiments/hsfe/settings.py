"""Settings and declaration of the step test."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.laboratory.settings.own_frames import or_own_frames
from experiments.laboratory.settings.points import StarTargetConfig
from experiments.laboratory.settings.tables import HexapodConfig, StepConfig


class HsfeConfig(StarTargetConfig):
    """The published run; ACC18 states 12 positions of 0.2 px along 45 deg, 25 stars, at least 30 frames."""

    steps: StepConfig = StepConfig()
    hexapod: HexapodConfig = HexapodConfig()
    subtraction: Literal["dark", "raw"] = Field(
        default="dark", description="dark: the mean dark frame is subtracted; raw: nothing, fixed patterns remain"
    )
    draws: int = Field(default=100, ge=10, le=5000, description="random chips for the prediction")


rendered = Experiment(
    name="hsfe",
    config=HsfeConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    takes="1 min (--quick: 15 s)",
    examples={
        "--quick": "a small run",
        "--set steps.step_px=0.5 --set subtraction=raw": "longer steps, fixed patterns left in",
    },
    show=("hsfe",),
    quick={"steps.positions": 6, "target.rows": 3, "target.columns": 3, "compare": ["gaussian", "epsf"]},
)
experiment = or_own_frames(rendered)
main = command(experiment)
