"""Configuration that the tests with point targets share (temporal, hsfe, distortion), and the bench it describes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field, field_validator, model_validator

from experiments.harness.config import ExperimentConfig, StrictModel
from experiments.laboratory.centroid_methods import MethodLabels, MethodName
from experiments.laboratory.settings import InstrumentConfig, TargetConfig

if TYPE_CHECKING:
    from experiments.laboratory.bench import Bench
    from experiments.laboratory.instrument import Instrument

__all__ = ["FRAMES_OPTION", "METHOD_NAMES", "PointConfig", "SourceConfig", "check_bench", "make_bench"]

FRAMES_OPTION = {"frames": ("frames_folder", "Reduce the FITS frames of a folder that holds frames.toml.")}
"""Command-line option of the three tests (`experiments.harness.cli.command`)."""

METHOD_NAMES = MethodLabels()


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


def make_bench(config: PointConfig, target: TargetConfig) -> Bench:
    """The laboratory of a configuration."""
    from experiments.laboratory.bench import Bench
    from experiments.laboratory.filter_wheel import open_wheel
    from optics.light.spectrum import Blackbody

    source = config.source
    wheel = open_wheel(*source.passband_nm, source.edge_nm)
    return Bench(
        target=target,
        lamp=Blackbody(temperature_k=source.lamp_k),
        filters=[wheel.select("open")],
        reference=0,
        signal_e=source.signal_e,
        frames=config.frames,
        dark_frames=config.dark_frames,
        window_px=config.window_px,
        methods=config.methods,
    )


def check_bench(bench: Bench, instrument: Instrument, direction: object) -> None:
    """Refuse light that no data cover, spots too wide for the window, points beside the detector.

    Parameters
    ----------
    bench, instrument
        The laboratory.
    direction : (m, j, 3)
        Target points.

    Raises
    ------
    DomainError
        One line: what, and what to change.
    """
    import numpy as np

    from experiments.laboratory.checks import check_light, check_wavelengths
    from experiments.laboratory.points import nominal_px
    from optics.errors import DomainError

    points = np.asarray(direction, float)
    check_wavelengths(instrument, [("source.passband_nm", band) for band in bench.filters])
    nominal = nominal_px(instrument, points.reshape(-1, 3))
    camera, half = instrument.camera, bench.window_px // 2 + 1
    off = np.any((nominal < half) | (nominal > np.array([camera.width_px, camera.height_px]) - 1 - half), axis=1)
    if off.any():
        at = nominal[int(np.argmax(off))]
        raise DomainError(
            f"{int(off.sum())} of {len(nominal)} target points lie off the detector or within {half} px of its edge, "
            f"e.g. at column {at[0]:.0f}, row {at[1]:.0f} of {camera.width_px} x {camera.height_px} px; move the "
            "target, or make it smaller"
        )
    check_light(bench, instrument, points)
