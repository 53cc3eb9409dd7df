"""Changes of a detector from its data file: the table ``[detector]`` of a configuration."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from pydantic import Field

from optics.settings import StrictModel
from optics.units import UM_MM
from render.detector.spec import Detector

_HIGHEST = 1e7
_IN_UM = {"diffusion_sigma_um": "diffusion_sigma_mm"}


class DetectorConfig(StrictModel):
    """Changes to the detector file (`render.detector.spec`); missing keys keep its values."""

    dimensionless: ClassVar[frozenset[str]] = frozenset(
        {"prnu", "crosstalk_horizontal", "crosstalk_vertical", "crosstalk_diagonal", "read_noise_spread"}
    )

    diffusion_sigma_um: float | None = Field(default=None, ge=0, le=100, description="charge diffusion")
    prnu: float | None = Field(default=None, ge=0, le=0.5, description="response non-uniformity")
    dark_current_e_per_s: float | None = Field(default=None, ge=0, le=_HIGHEST, description="mean dark current")
    dark_spread_e_per_s: float | None = Field(
        default=None, ge=0, le=_HIGHEST, description="standard deviation of the dark current over the pixels"
    )
    hot_fraction: float | None = Field(default=None, ge=0, le=1, description="fraction of hot pixels")
    hot_dark_e_per_s: float | None = Field(
        default=None, ge=0, le=_HIGHEST, description="mean extra dark current of hot pixels"
    )
    dead_fraction: float | None = Field(default=None, ge=0, le=1, description="fraction of dead pixels")
    full_well_e: float | None = Field(default=None, ge=1, le=_HIGHEST, description="saturation capacity")
    crosstalk_horizontal: float | None = Field(
        default=None, ge=0, le=0.2, description="charge share of a left or right neighbour"
    )
    crosstalk_vertical: float | None = Field(
        default=None, ge=0, le=0.2, description="charge share of an upper or lower neighbour"
    )
    crosstalk_diagonal: float | None = Field(
        default=None, ge=0, le=0.1, description="charge share of a diagonal neighbour"
    )
    read_noise_e: float | None = Field(default=None, ge=0, le=1e5, description="median temporal dark noise")
    read_noise_spread: float | None = Field(
        default=None, ge=0, le=2, description="standard deviation over the pixels of the logarithm of the read noise"
    )
    dsnu_e: float | None = Field(
        default=None, ge=0, le=1e5, description="standard deviation of the offset over the pixels"
    )
    column_pattern_e: float | None = Field(
        default=None, ge=0, le=1e5, description="standard deviation of the offset over the columns"
    )
    damage_centres_per_px: float | None = Field(
        default=None, ge=0, le=1000, description="radiation damage: mean number of damage centres per pixel"
    )
    damage_dark_e_per_s: float | None = Field(
        default=None, ge=0, le=_HIGHEST, description="mean dark current of a damage centre"
    )
    adc_bits: int | None = Field(default=None, ge=1, le=16, description="resolution of the converter")
    sensor_seed: int | None = Field(
        default=None, ge=0, le=2**63, description="seed of the individual detector's fixed patterns and defects"
    )


def overridden(detector: Detector, changes: DetectorConfig) -> Detector:
    """The detector with the changes of the configuration."""
    given = {name: value for name, value in changes.model_dump().items() if value is not None}
    scaled = {_IN_UM.get(name, name): value * UM_MM if name in _IN_UM else value for name, value in given.items()}
    return replace(detector, **scaled) if scaled else detector
