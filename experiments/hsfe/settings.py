"""Configuration of the step test."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from experiments.laboratory.point_settings import PointConfig
from experiments.laboratory.settings import HexapodConfig, StepConfig, TargetConfig

__all__ = ["Config"]


class Config(PointConfig):
    """The published run: ACC18 gives 12 positions of 0.2 px along 45 deg, 25 stars, at least 30 frames."""

    target: TargetConfig = TargetConfig(pitch_px=150.4)
    place_px: tuple[float, float] | None = Field(
        default=None, description="middle of the target on the detector; the middle of the first chip if left out"
    )
    steps: StepConfig = StepConfig()
    hexapod: HexapodConfig = HexapodConfig()
    subtraction: Literal["dark", "raw"] = Field(
        default="dark", description="dark: minus the mean dark frame; raw: the fixed pattern stays"
    )
    draws: int = Field(default=100, ge=10, le=5000, description="drawn chips behind the prediction")
