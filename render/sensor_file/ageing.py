"""The sensor at an age: transmission of glass and films, dark current and damage of the detector."""

from __future__ import annotations

from dataclasses import replace

from render.detector.displacement_damage import aged
from render.detector.spec import Detector
from render.sensor_file.file import LifeConfig


def aged_transmission(life: LifeConfig, fraction: float) -> float:
    """Transmission of darkened glass and films at a fraction of the life: both losses grow linearly."""
    return (1.0 - fraction * life.darkened_glass) * (1.0 - fraction * life.contamination)


def aged_detector(detector: Detector, life: LifeConfig, fraction: float, *, temperature_c: float) -> Detector:
    """The detector at a fraction of the life, with its displacement damage as read out at a temperature."""
    dark_e_per_s = detector.dark_current_e_per_s + fraction * life.ionising_dark_e_per_s
    detector = replace(detector, dark_current_e_per_s=dark_e_per_s)
    dose = fraction * life.displacement_dose_tev_per_g
    if not dose or life.depleted_volume_um3 is None:
        return detector
    return aged(
        detector,
        displacement_dose_tev_per_g=dose,
        depleted_volume_um3=life.depleted_volume_um3,
        temperature_c=temperature_c,
    )
