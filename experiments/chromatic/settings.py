"""Settings and declaration of the chromatic test."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from experiments.harness.cli import command
from experiments.harness.config import OddPx
from experiments.harness.experiment import Experiment
from experiments.laboratory.bench.centroid_methods import MethodName
from experiments.laboratory.settings.collimator import FilteredCollimatorConfig
from experiments.laboratory.settings.own_frames import OwnFramesConfig, or_own_frames
from experiments.laboratory.settings.tables import SignalConfig, StarsConfig, TargetConfig, check_windows
from optics.settings import StrictModel
from render.sensor_file.tables import FilterConfig, InstrumentConfig, PassbandConfig


class DecentreConfig(StrictModel):
    """Entry of ACC18 Table 1 that a decentred or tilted element has to reproduce."""

    wanted_px: float = Field(
        default=0.12, ge=-100, le=100, description="required entry of ACC18 Table 1 (half the mean shift); 0: no search"
    )
    pair: str = Field(
        default="auto", description="pair of bands, such as 800-600; auto: the reference and the longest of the others"
    )
    axis: Literal["x", "y"] = Field(default="x", description="axis of Table 1")
    element: str = Field(
        default="auto",
        description="element moved in the rendered check; auto: the one that needs the smallest movement of this kind",
    )
    kind: Literal["decentre", "tilt"] = Field(default="decentre", description="movement in the rendered check")


class ChromaticConfig(OwnFramesConfig, SignalConfig):
    """Defaults: the test of ACC18, which states neither signal nor pass band of the stars nor lens."""

    instrument: InstrumentConfig = InstrumentConfig()
    target: TargetConfig = TargetConfig()
    passband: PassbandConfig = PassbandConfig()
    filters: FilterConfig = FilterConfig()
    collimator: FilteredCollimatorConfig = FilteredCollimatorConfig()
    lamp_k: float = Field(default=3000.0, ge=1000, le=20000, description="colour temperature of the lamp")
    signal_e: float | None = Field(
        default=None,
        gt=0,
        le=1e7,
        description="electrons per point and frame in every filter; default, without a magnitude: 6000",
    )
    frames: int = Field(default=30, ge=2, le=10000, description="frames per position and filter")
    dark_frames: int = Field(
        default=100, ge=2, le=10000, description="dark frames per position, averaged and subtracted"
    )
    window_px: OddPx = Field(default=13, ge=7, le=63, description="side of the centroid window, odd")
    centroid: MethodName = Field(default="epsf", description="main centroider")
    compare: tuple[MethodName, ...] = Field(
        default=("epsf_reference", "gaussian", "windowed", "tcog", "cog"),
        description="other centroiders for the same frames",
    )
    decentre: DecentreConfig = DecentreConfig()
    stars: StarsConfig = StarsConfig()

    @property
    def methods(self) -> tuple[MethodName, ...]:
        """All centroiders, the main one first."""
        return tuple(dict.fromkeys((self.centroid, *self.compare)))

    @property
    def pair(self) -> str:
        """Pair of bands of the required shift, as in `band_pairs`."""
        if self.decentre.pair != "auto":
            return self.decentre.pair
        reference = self.filters.reference_nm
        other = max(centre for centre in self.filters.centres_nm if centre != reference)
        return f"{max(other, reference):g}-{min(other, reference):g}"

    @model_validator(mode="after")
    def _windows(self) -> ChromaticConfig:
        check_windows(self.window_px, self.target)
        return self


rendered = Experiment(
    name="chromatic",
    config=ChromaticConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    files="experiment:files",
    takes="45 s (--quick: 20 s)",
    examples={
        "--quick": "a small run",
        "--set decentre.element=L3 --set decentre.kind=tilt": "another element of the lens moved",
        "--set centroid=cog --set instrument.defocus_mm=0.03": "another centroider, out of focus",
    },
    show=("table1",),
    quick={"frames": 6, "dark_frames": 20, "stars.grid": 3, "target.rows": 3, "target.columns": 3, "compare": ["cog"]},
)
experiment = or_own_frames(rendered)
main = command(experiment)
