"""Configuration that the tests with point targets share (temporal, hsfe, distortion). Light to import."""

from __future__ import annotations

from pydantic import Field, field_validator, model_validator

from experiments.harness.config import ExperimentConfig, StrictModel
from experiments.laboratory.centroid_methods import MethodName
from experiments.laboratory.settings import InstrumentConfig, TargetConfig

__all__ = ["PointConfig", "SourceConfig", "StarTargetConfig"]


class SourceConfig(StrictModel):
    """Lamp, pass band and brightness; the open place of the filter wheel passes what the camera sees."""

    lamp_k: float = Field(default=3000.0, ge=1000, le=20000, description="colour temperature of the lamp")
    passband_nm: tuple[float, float] = Field(default=(450.0, 900.0), description="pass band of the camera")
    edge_nm: float = Field(default=20.0, ge=0, le=200, description="length of the pass band's edges")
    signal_e: float = Field(
        default=6000.0, gt=0, le=1e6, description="electrons per point and frame; about a star of V = 7.5 in 0.1 s"
    )

    @field_validator("passband_nm")
    @classmethod
    def _increasing(cls, values: tuple[float, float]) -> tuple[float, float]:
        if not 0.0 < values[0] < values[1]:
            raise ValueError("two increasing wavelengths are needed")
        return values


class PointConfig(ExperimentConfig):
    """What the three tests have in common."""

    instrument: InstrumentConfig = InstrumentConfig()
    source: SourceConfig = SourceConfig()
    frames_folder: str | None = Field(
        default=None, description="reduce the FITS frames of this folder (frames.toml says which is which), render none"
    )
    frames: int = Field(default=30, ge=2, le=10000, description="frames per position and level (ACC18: at least 30)")
    dark_frames: int = Field(default=100, ge=2, le=10000, description="frames with the lamp off")
    window_px: int = Field(default=13, ge=7, le=63, description="window around a point, odd")
    centroid: MethodName = Field(default="cog", description="centroider that counts; ACC18 names the centre of gravity")
    compare: tuple[MethodName, ...] = Field(
        default=("tcog", "windowed", "gaussian", "epsf"), description="others on the same frames"
    )

    @property
    def methods(self) -> tuple[MethodName, ...]:
        """All centroiders, the one that counts first."""
        return tuple(dict.fromkeys((self.centroid, *self.compare)))

    @model_validator(mode="after")
    def _odd(self) -> PointConfig:
        if self.window_px % 2 == 0:
            raise ValueError(f"window_px = {self.window_px}: an odd number is needed")
        return self


class StarTargetConfig(PointConfig):
    """Of the tests with the multi-star target, which stands somewhere on the detector."""

    target: TargetConfig = TargetConfig(pitch_px=150.4)
    place_px: tuple[float, float] | None = Field(
        default=None, description="middle of the target on the detector; the middle of the first chip if left out"
    )
