"""Settings and declaration of the distortion test."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.laboratory.bench.centroid_methods import MethodName
from experiments.laboratory.settings.own_frames import or_own_frames
from experiments.laboratory.settings.points import PointConfig
from experiments.laboratory.settings.tables import GridTargetConfig
from optics.settings import StrictModel
from render.sensor_file.tables import InstrumentConfig


class WideConfig(StrictModel):
    """A wide camera, for which distortion exceeds the marking error, and its target."""

    # its few points are summed one by one in a fifth of the time that a grid of images over so wide a field takes
    instrument: InstrumentConfig = InstrumentConfig(
        lens="star_tracker_26mm", detector="cmv4000", defocus_mm=0.0, diffraction="exact_waves"
    )
    target: GridTargetConfig = GridTargetConfig(edge_px=350.0)
    order: int = Field(
        default=3, ge=3, le=5, description="order of the polynomial, at least the order of the distortion"
    )


class DistortionConfig(PointConfig):
    """The published run; ACC18 states 32 points, their marking error, a cubic polynomial and N >= 30."""

    target: GridTargetConfig = GridTargetConfig()
    order: int = Field(default=3, ge=1, le=9, description="order of the polynomial")
    reference: Literal["nominal", "aligned", "calibrated"] = Field(
        default="calibrated", description="conversion of target coordinates to pixels for the main result"
    )
    window_px: int = Field(default=15, ge=7, le=63, description="side of the centroid window, odd")
    centroid: MethodName = Field(default="epsf", description="main centroider")
    compare: tuple[MethodName, ...] = Field(
        default=("cog", "gaussian"), description="other centroiders for the same frames"
    )
    surveys: int = Field(
        default=200, ge=2, le=5000, description="independent surveys of the target for the same frames"
    )
    draws: int = Field(default=200, ge=10, le=5000, description="noisy copies of a window for the prediction")
    map_rows: int = Field(default=17, ge=5, le=101, description="rows of the dense map; twice as many columns")
    wide: WideConfig = WideConfig()

    @model_validator(mode="after")
    def _enough(self) -> DistortionConfig:
        if self.own_frames is not None:
            return self  # the target is another
        points, terms = self.target.rows * self.target.columns, (self.order + 1) * (self.order + 2) // 2
        if self.order >= min(self.target.rows, self.target.columns) or points <= terms:
            raise ValueError(
                f"order = {self.order}: a grid of {self.target.rows} x {self.target.columns} points does not determine "
                "such a polynomial; it needs more rows and columns than the order"
            )
        return self


rendered = Experiment(
    name="distortion",
    config=DistortionConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    takes="50 s (--quick: 23 s)",
    examples={
        "--quick": "a small run",
        "--set target.rows=8 --set target.columns=16 --set order=5": "more points, a higher order",
    },
    show=("distortion",),
    quick={"compare": ["cog"], "surveys": 50, "draws": 60, "map_rows": 9, "dark_frames": 50},
)
experiment = or_own_frames(rendered)
main = command(experiment)
