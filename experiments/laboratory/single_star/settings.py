"""Configuration of a bench with a single-star simulator and a turntable that carries the camera."""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from experiments.harness.config import AngleDeg, OddPx, PositionPx
from experiments.laboratory.settings.own_frames import OwnFramesConfig
from experiments.laboratory.settings.tables import SignalConfig
from optics.settings import StrictModel
from render.sensor_file.tables import InstrumentConfig, PassbandConfig

LARGEST_STAR_ANGLE_DEG = 60.0
LARGEST_INSTALLATION_DEG = 30.0


ReadingArcsec = Annotated[float, Field(ge=-1e5, le=1e5)]
"""Type of an error of a turntable in a list of them."""


class StarSimulatorConfig(SignalConfig):
    """Single-star simulator; its direction is an unknown of the calibration."""

    default_signal_e: ClassVar[float] = 12000.0

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
    signal_e: float | None = Field(
        default=None,
        gt=0,
        le=1e7,
        description="electrons per exposure on the axis; default, without a magnitude: 12000",
    )


class TurntableConfig(StrictModel):
    """A turntable; one number for all axes, or one per axis, outermost first."""

    axes: str = Field(description="axes, outermost first, as letters of the laboratory frame, minus for left turns")
    reading_noise_arcsec: tuple[Annotated[float, Field(ge=0, le=1e5)], ...] = Field(
        description="standard deviation of a reading, per axis; one reading per frame"
    )
    non_orthogonality_arcsec: tuple[ReadingArcsec, ...] = Field(
        description="90 deg minus the angle of neighbouring axes"
    )
    setting_noise_arcsec: float = Field(
        default=5.0, ge=0, le=1e4, description="standard deviation of the angle reached minus the commanded angle"
    )
    encoder_amplitude_arcsec: float = Field(default=0.0, ge=0, le=1e3, description="sinusoidal error of the readings")
    encoder_cycles: int = Field(default=2, ge=1, le=100000, description="periods of that error per turn")
    rolls_deg: tuple[AngleDeg, ...] = Field(default=(0.0,), min_length=1, description="angles of a third, inner axis")


class GridConfig(StrictModel):
    """Grid of image positions of the star on the detector."""

    columns: int = Field(default=15, ge=1, le=200, description="positions along a row")
    rows: int = Field(default=9, ge=1, le=200, description="positions along a column")
    edge_px: float = Field(default=60.0, ge=0, le=1e5, description="distance of the outermost positions from the edge")


class SingleStarConfig(OwnFramesConfig):
    """Camera, star simulator and centroiding; the turntable is set by the experiment."""

    instrument: InstrumentConfig = InstrumentConfig()
    passband: PassbandConfig = PassbandConfig()
    principal_point_px: tuple[PositionPx, PositionPx] = Field(
        default=(12.0, -8.0), description="principal point, from the detector's centre"
    )
    installation_deg: tuple[AngleDeg, AngleDeg, AngleDeg] = Field(
        default=(0.4, -0.7, 1.2), description="true installation (cam from table top), rotation vector"
    )
    star: StarSimulatorConfig = StarSimulatorConfig()
    grid: GridConfig = GridConfig()
    frames: int = Field(default=10, ge=2, le=10000, description="frames per position, each with a reading of the table")
    dark_frames: int = Field(default=30, ge=2, le=10000, description="dark frames per position")
    window_px: OddPx = Field(default=13, ge=7, le=41, description="side of the centroid window, odd")

    @model_validator(mode="after")
    def _windows(self) -> Self:
        self.check_edge("grid.edge_px", self.grid.edge_px)
        if max(abs(value) for value in self.installation_deg) > LARGEST_INSTALLATION_DEG:
            raise ValueError(
                f"installation_deg = {list(self.installation_deg)}: at most {LARGEST_INSTALLATION_DEG:g} deg about "
                "each axis"
            )
        return self

    def check_edge(self, key: str, edge_px: float) -> None:
        """Refuse places so near to the edge that windows leave the detector."""
        if edge_px < self.window_px:
            raise ValueError(
                f"{key} = {edge_px:g} px: at least window_px = {self.window_px} px is needed, or windows leave the "
                "detector"
            )
