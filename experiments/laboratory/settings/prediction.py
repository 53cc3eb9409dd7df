"""Settings of a predicted star sensor: its file, and the light, motion and sky of the prediction."""

from __future__ import annotations

from typing import Annotated, TypeVar

from pydantic import Field, model_validator

from experiments.laboratory.settings.sensor_file import SensorConfig, SensorExperimentConfig
from optics.settings import StrictModel
from render.sensor_file.detector import DetectorConfig, overridden


class StarConfig(StrictModel):
    """Stars for which numbers are quoted."""

    magnitude_mag: float = Field(
        default=6.0, ge=-2, le=20, description="magnitude of the star for which accuracy is quoted"
    )
    temperature_k: float = Field(default=5800.0, ge=1000, le=60000, description="its colour temperature (black body)")
    colours_k: tuple[Annotated[float, Field(ge=1000, le=60000)], ...] = Field(
        default=(3500.0, 5800.0, 10000.0), min_length=1, max_length=6, description="colour temperatures of the curves"
    )


class SkySampleConfig(StrictModel):
    """Attitudes, uniform over all rotations, at which the sky is sampled."""

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
    sky: SkySampleConfig = SkySampleConfig()

    @model_validator(mode="after")
    def _shutter(self) -> PredictedSensorConfig:
        rate, line = self.slew.rate_deg_per_s, self.instrument.line_time_us
        if rate and line:
            raise ValueError(
                f"slew.rate_deg_per_s = {rate:g} with instrument.line_time_us = {line:g}: trailing stars are predicted "
                "for a global shutter; set one of them to 0 (the dataset renders both)"
            )
        return self


Sensor = TypeVar("Sensor", bound=PredictedSensorConfig)


def aged_config(config: Sensor, fraction: float) -> Sensor:
    """The sensor at a fraction of its life."""
    from render.sensor_file.ageing import aged_detector, aged_transmission
    from render.sensor_file.instrument import configured_detector

    setting = config.instrument
    detector = overridden(configured_detector(setting), config.detector)
    detector = aged_detector(detector, config.life, fraction, temperature_c=setting.chip_temperature_c)
    names = ("dark_current_e_per_s", "damage_centres_per_px", "damage_dark_e_per_s")
    aged = {name: getattr(detector, name) for name in names}
    return config.model_copy(
        update={
            "detector": config.detector.model_copy(update=aged),
            "throughput_fraction": config.throughput_fraction * aged_transmission(config.life, fraction),
        }
    )
