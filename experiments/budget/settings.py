"""Settings and declaration of the error budget."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field, model_validator

from experiments.harness.cli import command
from experiments.harness.config import OddPx
from experiments.harness.experiment import Experiment
from experiments.harness.sweeps import SweptConfig, with_what_if
from experiments.laboratory.bench.centroid_methods import CentroiderName, ProcessingName
from experiments.laboratory.settings.collimator import FilteredCollimatorConfig
from experiments.laboratory.settings.points import SourceConfig
from experiments.laboratory.settings.sensor_file import SensorExperimentConfig
from experiments.laboratory.settings.tables import (
    GridTargetConfig,
    HexapodConfig,
    StepConfig,
    TargetConfig,
    check_windows,
)
from optics.settings import StrictModel
from render.sensor_file.detector import DetectorConfig
from render.sensor_file.tables import FilterConfig, InstrumentConfig, PassbandConfig


class MovedConfig(StrictModel):
    """Displacement of an element of the lens."""

    element: str = Field(default="L45", description="name of the element")
    decentre_x_um: float = Field(default=0.0, ge=-3000, le=3000, description="decentre along increasing column")
    decentre_y_um: float = Field(default=0.0, ge=-3000, le=3000, description="decentre along increasing row")
    tilt_x_arcmin: float = Field(default=0.0, ge=-180, le=180, description="rotation about +x of the lens")
    tilt_y_arcmin: float = Field(default=0.0, ge=-180, le=180, description="rotation about +y of the lens")
    despace_um: float = Field(default=0.0, ge=-3000, le=3000, description="shift along the light")


class StepTestConfig(StepConfig):
    """The step test (ACC18 section 1.3)."""

    places: int = Field(default=6, ge=1, le=20, description="field positions of the test; the result is their RMS")


class SurveyGridConfig(GridTargetConfig):
    """The grid target (ACC18 section 1.4.2) and its reduction; three times its marking error is the term C2."""

    order: int = Field(default=3, ge=1, le=7, description="order of the polynomial (ACC18: 3)")
    reference: Literal["nominal", "aligned", "calibrated"] = Field(
        default="calibrated", description="conversion of target coordinates to pixels"
    )
    surveys: int = Field(
        default=200, ge=1, le=5000, description="surveys of the target for the same frames; the result is their RMS"
    )

    @model_validator(mode="after")
    def _enough(self) -> SurveyGridConfig:
        points, terms = self.rows * self.columns, (self.order + 1) * (self.order + 2) // 2
        if self.order >= min(self.rows, self.columns) or points <= terms:
            raise ValueError(
                f"grid.order = {self.order}: {self.rows} x {self.columns} points do not determine it; it "
                "needs more rows and columns than the order"
            )
        return self


class AttitudeConfig(StrictModel):
    """Monte Carlo of the attitude."""

    stars: int = Field(default=10, ge=2, le=1000, description="stars in the field (ACC18: 10)")
    counts: tuple[Annotated[int, Field(ge=2, le=10_000)], ...] = Field(
        default=(2, 3, 4, 5, 7, 10, 15, 20, 30, 50), min_length=1, description="star counts of the curve"
    )
    trials: int = Field(default=4000, ge=50, le=1_000_000, description="simulated fields per star count")


class ThermalStabilityConfig(StrictModel):
    """Temperature of lens and housing relative to the calibration."""

    stability_k: float = Field(
        default=1.0, ge=0, le=40, description="3 sigma (ACC18's laboratory: 20 +- 1 C); 0: no thermal term"
    )


class BudgetConfig(SweptConfig, SensorExperimentConfig):
    """Instrument and tests of the error budget."""

    NOT_SWEPT = frozenset({"attitude", "thermal"})

    instrument: InstrumentConfig = InstrumentConfig()
    detector: DetectorConfig = DetectorConfig()
    moved: MovedConfig = MovedConfig()
    target: TargetConfig = TargetConfig(pitch_px=150.4)  # not whole pixels: points at all fractions of a pixel
    passband: PassbandConfig = PassbandConfig()
    source: SourceConfig = SourceConfig()
    filters: FilterConfig = FilterConfig()
    collimator: FilteredCollimatorConfig = FilteredCollimatorConfig()
    hexapod: HexapodConfig = HexapodConfig()
    steps: StepTestConfig = StepTestConfig()
    grid: SurveyGridConfig = SurveyGridConfig()
    thermal: ThermalStabilityConfig = ThermalStabilityConfig()
    frames: int = Field(default=30, ge=2, le=10000, description="frames per position (ACC18: at least 30)")
    dark_frames: int = Field(
        default=100, ge=2, le=10000, description="dark frames per position, averaged and subtracted"
    )
    window_px: OddPx = Field(default=13, ge=7, le=63, description="side of the centroid window, odd")
    centroid: CentroiderName = Field(default="cog", description="main centroider; ACC18 uses the centre of gravity")
    compare: tuple[ProcessingName, ...] = Field(
        default=("epsf", "epsf_measured"),
        description="other centroiders for the same frames; epsf_measured: PSF built from frames",
    )
    attitude: AttitudeConfig = AttitudeConfig()
    published_within_fraction: float | None = Field(
        default=None,
        gt=0,
        le=1,
        description="required relative agreement of measured with published terms; default: not required",
    )
    predict_only: bool = Field(default=False, description="predict only, without rendered frames")

    @model_validator(mode="after")
    def _windows(self) -> BudgetConfig:
        if self.target.rows * self.target.columns < 2:
            raise ValueError("target.rows * target.columns = 1: at least 2 points are needed")
        check_windows(self.window_px, self.target)
        return self

    @property
    def methods(self) -> tuple[str, ...]:
        """All centroiders, the main one first."""
        return tuple(dict.fromkeys((self.centroid, *self.compare)))


def _instead(config: BudgetConfig) -> Experiment | None:
    if not config.predict_only:
        return None
    return replace(rendered, run="experiment:predict", report="prediction.md", instead=None)


rendered = Experiment(
    name="budget",
    config=BudgetConfig,
    run="experiment:run",
    predict="experiment:predict",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    swept=(
        "total_rms_arcsec",
        "te_rms_arcsec",
        "hsfe_rms_arcsec",
        "chromatic_rms_arcsec",
        "distortion_rms_arcsec",
    ),
    takes="100 s (--quick: 50 s)",
    examples={
        "--quick": "a small run",
        "--predict-only": "the predicted terms alone, in seconds",
        "--sweep detector.read_noise_e=2:20:10": "the predicted budget against the read noise",
        "--config acc18_tuned": "an instrument tuned to the published budget",
    },
    show=("budget",),
    options={"predict-only": ("predict_only", "Predict only, without rendered frames.")},
    instead=_instead,
    quick={
        "frames": 10,
        "dark_frames": 30,
        "target.rows": 3,
        "target.columns": 3,
        "steps.places": 1,
        "steps.positions": 6,
        "attitude.trials": 500,
        "attitude.counts": [2, 5, 10, 30],
    },
)
experiment = with_what_if(rendered, renders=True)
main = command(experiment)
