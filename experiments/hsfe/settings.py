"""Configuration of the step test."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from experiments.harness.config import StrictModel
from experiments.laboratory.point_settings import PointConfig
from experiments.laboratory.settings import TargetConfig

__all__ = ["Config", "HexapodConfig", "StepConfig"]


class HexapodConfig(StrictModel):
    """Errors of the hexapod, standard deviations; ACC18 names a PI H-840 but no figures, these are of its class."""

    step_error_arcsec: float = Field(default=0.4, ge=0, le=60, description="pitch and yaw reached against commanded")
    roll_error_arcsec: float = Field(default=1.0, ge=0, le=60, description="roll reached against commanded")
    reading_error_arcsec: float = Field(default=0.2, ge=0, le=60, description="pose reported against reached")


class StepConfig(StrictModel):
    """Positions along a line over the detector."""

    positions: int = Field(default=12, ge=2, le=200, description="M; ACC18 counts 0, 0.2 ... 2.0 px as 12, which is 11")
    step_px: float = Field(default=0.2, gt=0, description="length of a step of the image")
    direction_deg: float = Field(default=45.0, ge=-360, le=360, description="of the motion, from column towards row")


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
