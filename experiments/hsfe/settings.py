"""Configuration of the step test."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from experiments.laboratory.point_settings import StarTargetConfig
from experiments.laboratory.settings import HexapodConfig, StepConfig

__all__ = ["Config"]


class Config(StarTargetConfig):
    """The published run: ACC18 gives 12 positions of 0.2 px along 45 deg, 25 stars, at least 30 frames."""

    steps: StepConfig = StepConfig()
    hexapod: HexapodConfig = HexapodConfig()
    subtraction: Literal["dark", "raw"] = Field(
        default="dark", description="dark: minus the mean dark frame; raw: the fixed pattern stays"
    )
    draws: int = Field(default=100, ge=10, le=5000, description="drawn chips behind the prediction")
