"""Changes of a detector from its data file: the table ``[detector]`` of a configuration."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

from pydantic import Field

from optics.settings import StrictModel
from optics.units import UM_MM
from render.detector.spec import RANGES, Detector, DetectorFile

_IN_UM = {"diffusion_sigma_um": "diffusion_sigma_mm"}


def _changed(name: str) -> Any:
    """A key of the detector file that may be left out, with its range and description."""
    low, high, _ = RANGES[name]
    description = str(DetectorFile.model_fields[name].description).partition(" [")[0]
    return Field(default=None, ge=low, le=high, description=description)


class DetectorConfig(StrictModel):
    """Changes to the detector file (`render.detector.spec`); missing keys keep its values."""

    dimensionless: ClassVar[frozenset[str]] = frozenset(
        {"prnu", "crosstalk_horizontal", "crosstalk_vertical", "crosstalk_diagonal", "read_noise_spread"}
    )

    diffusion_sigma_um: float | None = _changed("diffusion_sigma_um")
    prnu: float | None = _changed("prnu")
    dark_current_e_per_s: float | None = _changed("dark_current_e_per_s")
    dark_spread_e_per_s: float | None = _changed("dark_spread_e_per_s")
    hot_fraction: float | None = _changed("hot_fraction")
    hot_dark_e_per_s: float | None = _changed("hot_dark_e_per_s")
    dead_fraction: float | None = _changed("dead_fraction")
    full_well_e: float | None = _changed("full_well_e")
    crosstalk_horizontal: float | None = _changed("crosstalk_horizontal")
    crosstalk_vertical: float | None = _changed("crosstalk_vertical")
    crosstalk_diagonal: float | None = _changed("crosstalk_diagonal")
    read_noise_e: float | None = _changed("read_noise_e")
    read_noise_spread: float | None = _changed("read_noise_spread")
    dsnu_e: float | None = _changed("dsnu_e")
    column_pattern_e: float | None = _changed("column_pattern_e")
    damage_centres_per_px: float | None = _changed("damage_centres_per_px")
    damage_dark_e_per_s: float | None = _changed("damage_dark_e_per_s")
    adc_bits: int | None = _changed("adc_bits")
    sensor_seed: int | None = _changed("sensor_seed")


def overridden(detector: Detector, changes: DetectorConfig) -> Detector:
    """The detector with the changes of the configuration."""
    given = {name: value for name, value in changes.model_dump().items() if value is not None}
    scaled = {_IN_UM.get(name, name): value * UM_MM if name in _IN_UM else value for name, value in given.items()}
    return replace(detector, **scaled) if scaled else detector
