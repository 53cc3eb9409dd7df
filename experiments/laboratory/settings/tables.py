"""Configuration tables that experiments share: signal, targets, platform, stars. Light to import."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from optics.settings import StarK, StrictModel


class SignalConfig(StrictModel):
    """Brightness of a target point: electrons, or the V magnitude of a star of the same signal."""

    default_signal_e: ClassVar[float] = 6000.0

    signal_e: float | None = Field(
        default=None, gt=0, le=1e7, description="electrons per point and frame; both left out: 6000"
    )
    magnitude_mag: float | None = Field(
        default=None,
        ge=-10,
        le=25,
        description="in place of signal_e: V magnitude of a star of the same signal",
    )

    @model_validator(mode="after")
    def _either(self) -> Self:
        if self.signal_e is not None and self.magnitude_mag is not None:
            raise ValueError(
                f"signal_e = {self.signal_e:g} e- and magnitude_mag = {self.magnitude_mag:g}: give one of them, the "
                "other follows from aperture, pass band and exposure"
            )
        return self


class TargetConfig(StrictModel):
    """A rows x columns grid in the focal plane of the collimator."""

    rows: int = Field(default=5, ge=1, le=50, description="points along a column")
    columns: int = Field(default=5, ge=1, le=50, description="points along a row")
    pitch_px: float = Field(default=150.0, gt=0, le=1e5, description="spacing of the points as the camera sees it")
    edge_px: float = Field(
        default=150.0, ge=0, le=1e5, description="distance of the outermost points from the detector's edge"
    )


class GridTargetConfig(StrictModel):
    """The surveyed target: 32 points, measured to 0.5 arcsec (3 sigma)."""

    rows: int = Field(default=4, ge=2, le=60, description="points along a column of the detector")
    columns: int = Field(default=8, ge=2, le=60, description="points along a row of the detector")
    edge_px: float = Field(
        default=60.0, ge=0, le=1e5, description="distance of the outermost points from the detector's edge"
    )
    jitter_px: float = Field(default=5.0, ge=0, le=100, description="spread of the points about the regular grid")
    marking_error_arcsec: float = Field(
        default=0.5 / 3.0, ge=0, le=60, description="survey error of a point per axis, 1 sigma"
    )
    roll_arcmin: float = Field(
        default=3.0, ge=-600, le=600, description="rotation of the target relative to the detector"
    )


class HexapodConfig(StrictModel):
    """Standard deviations of the hexapod's errors; ACC18 states none, the defaults are typical of its PI H-840."""

    step_error_arcsec: float = Field(default=0.4, ge=0, le=60, description="pitch and yaw, reached minus commanded")
    roll_error_arcsec: float = Field(default=1.0, ge=0, le=60, description="roll, reached minus commanded")
    reading_error_arcsec: float = Field(default=0.2, ge=0, le=60, description="pose, reported minus reached")


class StepConfig(StrictModel):
    """Positions along a line over the detector."""

    positions: int = Field(
        default=12, ge=2, le=200, description="number M; ACC18 states 12 for 0, 0.2 ... 2.0 px, which are 11"
    )
    step_px: float = Field(default=0.2, gt=0, le=1e5, description="length of a step of the image")
    direction_deg: float = Field(
        default=45.0, ge=-360, le=360, description="direction of the motion, from column towards row"
    )


class StarsConfig(StrictModel):
    """Stars as black bodies, on a grid over the detector."""

    temperatures_k: tuple[StarK, ...] = Field(
        default=(3000.0, 3500.0, 4000.0, 4500.0, 5000.0, 5800.0, 6500.0, 7500.0, 9000.0, 12000.0, 18000.0, 30000.0),
        min_length=2,
        description="effective temperatures",
    )
    reference_k: float = Field(default=5800.0, ge=1000, le=1e5, description="temperature of the reference star")
    grid: int = Field(default=5, ge=2, le=20, description="field points along each side")


def check_windows(size_px: int, target: TargetConfig) -> None:
    """Refuse windows with two points in one of them, or over the edge of the detector."""
    if target.rows * target.columns > 1 and target.pitch_px < size_px:
        raise ValueError(
            f"target.pitch_px = {target.pitch_px:g} px: at least window_px = {size_px} px is needed, or one window "
            "holds two points"
        )
    if target.edge_px < size_px // 2 + 1:
        raise ValueError(
            f"target.edge_px = {target.edge_px:g} px: at least {size_px // 2 + 1} px is needed, or windows of "
            f"window_px = {size_px} px leave the detector"
        )
