"""Settings of a predicted star sensor: its file, and the light, motion and sky of the prediction."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from experiments.harness.config import StrictModel
from experiments.laboratory.settings.detector import DetectorConfig
from experiments.laboratory.settings.sensor_file import SensorConfig, SensorExperimentConfig


class StarConfig(StrictModel):
    """Stars for which numbers are quoted."""

    magnitude_mag: float = Field(
        default=6.0, ge=-2, le=20, description="magnitude of the star for which accuracy is quoted"
    )
    temperature_k: float = Field(default=5800.0, ge=1000, le=60000, description="its colour temperature (black body)")
    colours_k: tuple[Annotated[float, Field(ge=1000, le=60000)], ...] = Field(
        default=(3500.0, 5800.0, 10000.0), min_length=1, max_length=6, description="colour temperatures of the curves"
    )


class SkyConfig(StrictModel):
    """Attitudes, uniform over all rotations, for which the sky is looked up."""

    attitudes: int = Field(default=600, ge=10, le=100_000, description="number of attitudes")


class SlewConfig(StrictModel):
    """Uniform rotation of the sensor across its line of sight during every exposure, known to its processing."""

    rate_deg_per_s: float = Field(default=0.0, ge=0, le=100, description="slew rate across the line of sight")
    direction_deg: float = Field(
        default=0.0, ge=-360, le=360, description="direction of the star trails, from column towards row"
    )


class PredictedSensorConfig(SensorExperimentConfig, SensorConfig):
    """A sensor file, and further settings of `experiments.laboratory.sensor_prediction.predict_camera`."""

    detector: DetectorConfig = DetectorConfig()
    throughput_fraction: float = Field(
        default=1.0, gt=0, le=1, description="transmission of losses that lens, pass band and detector do not include"
    )
    background_e_per_s: float = Field(
        default=0.0, ge=0, le=1e6, description="uniform light per pixel, such as stray light"
    )
    false_alarms_per_frame: float | None = Field(
        default=None, gt=0, le=1e4, description="sets the detection limit in place of threshold_sigma"
    )
    dark_frames: int = Field(default=20, ge=1, le=1000, description="dark frames averaged and subtracted")
    star: StarConfig = StarConfig()
    slew: SlewConfig = SlewConfig()
    sky: SkyConfig = SkyConfig()

    @model_validator(mode="after")
    def _shutter(self) -> PredictedSensorConfig:
        rate, line = self.slew.rate_deg_per_s, self.instrument.line_time_us
        if rate and line:
            raise ValueError(
                f"slew.rate_deg_per_s = {rate:g} with instrument.line_time_us = {line:g}: trailing stars are predicted "
                "for a global shutter; set one of them to 0 (the dataset renders both)"
            )
        return self
