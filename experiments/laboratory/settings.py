"""Configuration tables that experiments share: the instrument, the target, the stars. Light to import."""

from __future__ import annotations

from pydantic import Field, field_validator

from experiments.harness.config import StrictModel

__all__ = ["InstrumentConfig", "StarsConfig", "TargetConfig"]


class InstrumentConfig(StrictModel):
    """Lens, detector and how they are operated."""

    lens: str = Field(default="star_camera_206mm", description="built-in lens or TOML file")
    detector: str = Field(default="acc18_mosaic", description="built-in detector or TOML file")
    defocus_mm: float = Field(default=0.010, ge=-1, le=1, description="detector shift away from the lens")
    exposure_s: float = Field(default=0.1, gt=0, le=1e4, description="exposure time")
    chip_temperature_c: float = Field(default=0.0, ge=-100, le=80, description="temperature of the detector")
    absorption: bool = Field(
        default=True, description="count absorption in the glass; needs the internal transmittance of every glass"
    )
    coating_nm: float = Field(
        default=550.0, ge=0, le=2000, description="design wavelength of the MgF2 quarter-wave coatings; 0: bare glass"
    )


class TargetConfig(StrictModel):
    """A rows x columns grid; the collimator is taken as free of colour (an off-axis paraboloid)."""

    rows: int = Field(default=5, ge=1, le=50, description="points along a column")
    columns: int = Field(default=5, ge=1, le=50, description="points along a row")
    pitch_px: float = Field(default=150.0, gt=0, description="spacing of the points as the camera sees it")
    edge_px: float = Field(default=150.0, ge=0, description="distance of the outermost points from the detector's edge")


class StarsConfig(StrictModel):
    """Stars as black bodies, on a grid over the detector."""

    temperatures_k: tuple[float, ...] = Field(
        default=(3000.0, 3500.0, 4000.0, 4500.0, 5000.0, 5800.0, 6500.0, 7500.0, 9000.0, 12000.0, 18000.0, 30000.0),
        min_length=2,
        description="effective temperatures",
    )
    reference_k: float = Field(default=5800.0, ge=1000, le=1e5, description="star that the others are compared with")
    grid: int = Field(default=5, ge=2, le=20, description="field points along each side")
    passband_nm: tuple[float, float] = Field(default=(450.0, 900.0), description="pass band of the camera")
    edge_nm: float = Field(default=20.0, ge=0, description="length of the pass band's edges")

    @field_validator("temperatures_k")
    @classmethod
    def _temperatures(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        for temperature in values:
            if not 1000.0 <= temperature <= 1e5:
                raise ValueError(f"{temperature:g} K is outside 1000 ... 100000 K")
        return values

    @field_validator("passband_nm")
    @classmethod
    def _increasing(cls, values: tuple[float, float]) -> tuple[float, float]:
        if not 0.0 < values[0] < values[1]:
            raise ValueError("two increasing wavelengths are needed")
        return values
