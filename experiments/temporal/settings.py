"""Settings and declaration of the temporal-error test."""

from __future__ import annotations

from pydantic import Field, model_validator

from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.laboratory.settings.own_frames import or_own_frames
from experiments.laboratory.settings.points import StarTargetConfig
from optics.settings import StrictModel


class BrightnessConfig(StrictModel):
    """Levels of the brightness control, evenly spaced in the logarithm."""

    lowest_e: float = Field(default=700.0, gt=0, le=1e6, description="electrons per star and frame, lowest level")
    highest_e: float = Field(default=20000.0, gt=0, le=1e6, description="electrons per star and frame, highest level")
    levels: int = Field(default=8, ge=2, le=50, description="number of levels")
    setting_error_ratio: float = Field(
        default=0.01, ge=0, lt=0.3, description="standard deviation of the level reached / level set - 1"
    )

    @model_validator(mode="after")
    def _increasing(self) -> BrightnessConfig:
        if self.lowest_e >= self.highest_e:
            raise ValueError(
                f"lowest_e = {self.lowest_e:g} e-, highest_e = {self.highest_e:g} e-: the first must be the lower one"
            )
        return self


class TemporalConfig(StarTargetConfig):
    """The published run; ACC18 states 25 stars, at least 30 frames and 5.5 arcsec per pixel."""

    frames: int = Field(default=100, ge=2, le=10000, description="frames per level (ACC18: at least 30)")
    brightness: BrightnessConfig = BrightnessConfig()
    draws: int = Field(default=100, ge=2, le=5000, description="noisy copies for the sampled prediction")


rendered = Experiment(
    name="temporal",
    config=TemporalConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    takes="30 s (--quick: 10 s)",
    examples={
        "--quick": "a small run",
        "--set source.signal_e=2000 --set centroid=gaussian": "fainter stars, another centroider",
    },
    show=("temporal_error",),
    quick={
        "frames": 30,
        "draws": 50,
        "brightness.levels": 5,
        "target.rows": 3,
        "target.columns": 3,
        "compare": ["tcog", "epsf"],
    },
)
experiment = or_own_frames(rendered)
main = command(experiment)
