"""Configuration that the tests with point targets share (temporal, hsfe, distortion). Light to import."""

from __future__ import annotations

from pydantic import Field

from experiments.harness.config import OddPx
from experiments.laboratory.bench.centroid_methods import MethodName
from experiments.laboratory.settings.collimator import CollimatorConfig
from experiments.laboratory.settings.own_frames import OwnFramesConfig
from experiments.laboratory.settings.tables import SignalConfig, TargetConfig
from render.sensor_file.tables import InstrumentConfig, PassbandConfig


class SourceConfig(SignalConfig):
    """Lamp and brightness; the light reaches the camera through its pass band."""

    lamp_k: float = Field(default=3000.0, ge=1000, le=20000, description="colour temperature of the lamp")
    star_k: float = Field(
        default=5800.0, ge=1000, le=1e5, description="temperature of the star whose magnitude replaces signal_e"
    )


class PointConfig(OwnFramesConfig):
    """Settings common to the point-target tests."""

    instrument: InstrumentConfig = InstrumentConfig()
    passband: PassbandConfig = PassbandConfig()
    source: SourceConfig = SourceConfig()
    collimator: CollimatorConfig = CollimatorConfig()
    frames: int = Field(default=30, ge=2, le=10000, description="frames per position and level (ACC18: at least 30)")
    dark_frames: int = Field(default=100, ge=2, le=10000, description="dark frames, averaged and subtracted")
    window_px: OddPx = Field(default=13, ge=7, le=63, description="side of the centroid window, odd")
    centroid: MethodName = Field(default="cog", description="main centroider; ACC18 uses the centre of gravity")
    compare: tuple[MethodName, ...] = Field(
        default=("tcog", "windowed", "gaussian", "epsf"), description="other centroiders for the same frames"
    )

    @property
    def methods(self) -> tuple[MethodName, ...]:
        """All centroiders, the main one first."""
        return tuple(dict.fromkeys((self.centroid, *self.compare)))


class StarTargetConfig(PointConfig):
    """Settings of tests with the multi-star target."""

    target: TargetConfig = TargetConfig(pitch_px=150.4)
    place_px: tuple[float, float] | None = Field(
        default=None, description="centre of the target on the detector; default: centre of the first chip"
    )
