"""The sensor at an age: transmission of glass and films, dark current and damage of the detector."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from experiments.laboratory.devices.instrument import configured_detector
from experiments.laboratory.settings.detector import overridden
from experiments.laboratory.settings.prediction import PredictedSensorConfig
from render.detector.radiation import aged
from render.detector.spec import Detector

Sensor = TypeVar("Sensor", bound=PredictedSensorConfig)


def light_left(config: PredictedSensorConfig, part: float) -> float:
    """Share of the light that reaches the detector at a part of the life."""
    return (1.0 - part * config.life.darkened_glass) * (1.0 - part * config.life.contamination)


def aged_detector(config: PredictedSensorConfig, part: float) -> Detector:
    """The detector at a part of the life, with the changes of the configuration."""
    life, chip = config.life, overridden(configured_detector(config.instrument), config.detector)
    chip = replace(chip, dark_current_e_per_s=chip.dark_current_e_per_s + part * life.ionising_dark_e_per_s)
    if not part * life.displacement_dose_tev_per_g or life.depleted_volume_um3 is None:
        return chip
    return aged(
        chip,
        displacement_dose_tev_per_g=part * life.displacement_dose_tev_per_g,
        depleted_volume_um3=life.depleted_volume_um3,
        temperature_c=config.instrument.chip_temperature_c,
    )


def aged_config(config: Sensor, part: float) -> Sensor:
    """The sensor at a part of its life."""
    chip = aged_detector(config, part)
    grown = {
        name: getattr(chip, name) for name in ("dark_current_e_per_s", "damage_centres_per_px", "damage_dark_e_per_s")
    }
    return config.model_copy(
        update={
            "detector": config.detector.model_copy(update=grown),
            "throughput_fraction": config.throughput_fraction * light_left(config, part),
        }
    )
