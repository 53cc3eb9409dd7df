"""Configuration of the turntable calibration."""

from __future__ import annotations

from pydantic import Field, field_validator, model_validator

from experiments.harness.config import ExperimentConfig, StrictModel
from experiments.laboratory.settings import InstrumentConfig

__all__ = ["Config", "GridConfig", "ReductionConfig", "StarConfig", "StudyConfig", "TableConfig"]

LARGEST_STAR_ANGLE_DEG = 60.0


class StarConfig(StrictModel):
    """Single-star simulator; its direction is an unknown of the calibration."""

    azimuth_deg: float = Field(
        default=0.35,
        ge=-LARGEST_STAR_ANGLE_DEG,
        le=LARGEST_STAR_ANGLE_DEG,
        description="true direction, from +Z towards +X",
    )
    elevation_deg: float = Field(
        default=-0.25, ge=-LARGEST_STAR_ANGLE_DEG, le=LARGEST_STAR_ANGLE_DEG, description="true direction, towards +Y"
    )
    temperature_k: float = Field(default=5800.0, ge=1000, le=1e5, description="colour temperature")
    passband_nm: tuple[float, float] = Field(default=(450.0, 900.0), description="pass band of the simulator")
    edge_nm: float = Field(default=20.0, ge=0, le=400, description="length of the pass band's edges")
    signal_e: float = Field(default=12000.0, gt=0, le=1e7, description="electrons per exposure on the axis")

    @field_validator("passband_nm")
    @classmethod
    def _increasing(cls, values: tuple[float, float]) -> tuple[float, float]:
        if not 0.0 < values[0] < values[1]:
            raise ValueError("two increasing wavelengths are needed")
        return values


class TableConfig(StrictModel):
    """A turntable; one number for all axes, or one per axis, outermost first."""

    axes: str = Field(description="axes, outermost first, as letters of the laboratory frame, minus for left turns")
    reading_noise_arcsec: tuple[float, ...] = Field(
        description="standard deviation of a reading, per axis; one per frame"
    )
    non_orthogonality_arcsec: tuple[float, ...] = Field(description="90 deg minus the angle of neighbouring axes")
    setting_noise_arcsec: float = Field(default=5.0, ge=0, le=1e4, description="how far from the commanded angle")
    encoder_amplitude_arcsec: float = Field(default=0.0, ge=0, le=1e3, description="sinusoidal error of the readings")
    encoder_cycles: int = Field(default=2, ge=1, le=100000, description="periods of that error per turn")
    rolls_deg: tuple[float, ...] = Field(default=(0.0,), min_length=1, description="angles of a third, inner axis")

    @field_validator("reading_noise_arcsec")
    @classmethod
    def _not_negative(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if any(value < 0 for value in values):
            raise ValueError(f"{list(values)} arcsec; a reading error cannot be negative")
        return values


def _two_axes() -> TableConfig:
    # 0.3 and 0.4 arcsec: the table of CUBE09. FISHER23 does not give its table's errors.
    return TableConfig(axes="xy", reading_noise_arcsec=(0.3, 0.4), non_orthogonality_arcsec=(5.0,))


def _three_axes() -> TableConfig:
    return TableConfig(
        axes="xyz",
        reading_noise_arcsec=(0.3, 0.4, 0.4),
        non_orthogonality_arcsec=(5.0, -4.0),
        rolls_deg=(0.0, 90.0, 180.0, 270.0),
    )


class GridConfig(StrictModel):
    """Places of the detector that the star's image visits."""

    columns: int = Field(default=15, ge=1, le=200, description="places along a row")
    rows: int = Field(default=9, ge=1, le=200, description="places along a column")
    edge_px: float = Field(default=60.0, ge=0, description="distance of the outermost places from the edge")


class ReductionConfig(StrictModel):
    """What the person who reduces the data believes before."""

    focal_length_mm: float | None = Field(
        default=None, gt=0, le=1e5, description="start value; left out, the lens's paraxial one rounded to 5 %"
    )
    axes: str | None = Field(
        default=None, description="axes of the two-axis table as believed; left out, the real ones"
    )
    star_deg: tuple[float, float] = Field(default=(0.0, 0.0), description="start of the star, azimuth and elevation")

    @field_validator("star_deg")
    @classmethod
    def _in_front(cls, values: tuple[float, float]) -> tuple[float, float]:
        if max(abs(value) for value in values) > LARGEST_STAR_ANGLE_DEG:
            raise ValueError(f"{list(values)} deg; at most {LARGEST_STAR_ANGLE_DEG:g} deg each")
        return values


class StudyConfig(StrictModel):
    """Monte-Carlo runs and sweeps on coordinates."""

    runs: int = Field(default=400, ge=20, le=100000, description="runs of the Monte-Carlo, each table")
    sweep_runs: int = Field(default=50, ge=5, le=10000, description="runs per point of a sweep")
    reading_noise_arcsec: tuple[float, ...] = Field(
        default=(0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0),
        min_length=2,
        description="errors of the mean reading of a place to sweep",
    )
    non_orthogonality_arcsec: tuple[float, ...] = Field(
        default=(0.0, 2.0, 5.0, 10.0, 20.0, 40.0), min_length=2, description="non-orthogonalities to sweep"
    )
    field_deg: tuple[float, ...] = Field(
        default=(3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 20.0, 28.0, 40.0), min_length=2, description="full fields to sweep"
    )

    @field_validator("reading_noise_arcsec", "non_orthogonality_arcsec")
    @classmethod
    def _not_negative(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if any(value < 0 for value in values):
            raise ValueError(f"{list(values)} arcsec; none may be negative")
        return tuple(sorted(set(values)))

    @field_validator("field_deg")
    @classmethod
    def _fields(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if not all(0.5 <= value <= 100 for value in values):
            raise ValueError(f"{list(values)} deg; 0.5 ... 100 deg are meant")
        return tuple(sorted(set(values)))


class Config(ExperimentConfig):
    """FISHER23 gives the bench and the unknowns but no numbers: here are the camera of ACC18, the table of CUBE09."""

    instrument: InstrumentConfig = InstrumentConfig()
    principal_point_px: tuple[float, float] = Field(
        default=(12.0, -8.0), description="where the axis of the lens meets the detector, from its centre"
    )
    installation_deg: tuple[float, float, float] = Field(
        default=(0.4, -0.7, 1.2), description="true installation (cam from table top), rotation vector"
    )
    star: StarConfig = StarConfig()
    two_axis: TableConfig = Field(default_factory=_two_axes)
    three_axis: TableConfig = Field(default_factory=_three_axes)
    grid: GridConfig = GridConfig()
    frames: int = Field(default=10, ge=2, le=10000, description="frames per place, each with a reading of the table")
    dark_frames: int = Field(default=30, ge=2, le=10000, description="frames with the star off, per place")
    window_px: int = Field(default=13, ge=7, le=41, description="window around the star, odd")
    reduction: ReductionConfig = ReductionConfig()
    study: StudyConfig = StudyConfig()

    @model_validator(mode="after")
    def _windows(self) -> Config:
        if self.window_px % 2 == 0:
            raise ValueError(f"window_px = {self.window_px}: an odd number is needed")
        if self.grid.edge_px < self.window_px:
            raise ValueError(
                f"grid.edge_px = {self.grid.edge_px:g} px: at least window_px = {self.window_px} px is needed, or "
                "windows leave the detector"
            )
        if max(abs(value) for value in self.installation_deg) > 30:
            raise ValueError(f"installation_deg = {list(self.installation_deg)}: at most 30 deg about each axis")
        return self
