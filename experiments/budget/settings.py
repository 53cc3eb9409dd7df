"""Settings and declaration of the error budget: one instrument, how it is measured, and what is asked of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field, model_validator

from experiments.harness.cli import command
from experiments.harness.config import OddPx, StrictModel
from experiments.harness.experiment import Experiment
from experiments.harness.sweeps import SweptConfig, with_what_if
from experiments.laboratory import settings as laboratory_settings
from experiments.laboratory.centroid_methods import CentroiderName, ProcessingName
from experiments.laboratory.collimator_settings import FilteredCollimatorConfig
from experiments.laboratory.detector_changes import DetectorConfig
from experiments.laboratory.point_settings import SourceConfig
from experiments.laboratory.sensor_file import SensorExperimentConfig
from experiments.laboratory.settings import (
    FilterConfig,
    GridTargetConfig,
    HexapodConfig,
    InstrumentConfig,
    PassbandConfig,
    TargetConfig,
    check_windows,
)


class MovedConfig(StrictModel):
    """One element of the lens that is not where the design has it."""

    element: str = Field(default="L45", description="which")
    decentre_x_um: float = Field(default=0.0, ge=-3000, le=3000, description="along increasing column")
    decentre_y_um: float = Field(default=0.0, ge=-3000, le=3000, description="along increasing row")
    tilt_x_arcmin: float = Field(default=0.0, ge=-180, le=180, description="rotation vector along +x of the lens")
    tilt_y_arcmin: float = Field(default=0.0, ge=-180, le=180, description="rotation vector along +y of the lens")
    despace_um: float = Field(default=0.0, ge=-3000, le=3000, description="along the light")


class StepConfig(laboratory_settings.StepConfig):
    """The step test (ACC18 section 1.3)."""

    places: int = Field(default=6, ge=1, le=20, description="places of the field where the test is made; RMS of them")


class GridConfig(GridTargetConfig):
    """The grid target (ACC18 section 1.4.2) and its reduction; three times its marking error is the term C2."""

    order: int = Field(default=3, ge=1, le=7, description="of the polynomial (ACC18: 3)")
    reference: Literal["nominal", "aligned", "calibrated"] = Field(
        default="calibrated", description="how target coordinates become pixels"
    )
    surveys: int = Field(default=200, ge=1, le=5000, description="surveys of the target, same frames; RMS of them")

    @model_validator(mode="after")
    def _enough(self) -> GridConfig:
        points, terms = self.rows * self.columns, (self.order + 1) * (self.order + 2) // 2
        if self.order >= min(self.rows, self.columns) or points <= terms:
            raise ValueError(
                f"grid.order = {self.order}: {self.rows} x {self.columns} points do not determine it; it "
                "needs more rows and columns than the order"
            )
        return self


class AttitudeConfig(StrictModel):
    """Monte-Carlo of the attitude."""

    stars: int = Field(default=10, ge=2, le=1000, description="stars in the field (ACC18: 10)")
    counts: tuple[Annotated[int, Field(ge=2, le=10_000)], ...] = Field(
        default=(2, 3, 4, 5, 7, 10, 15, 20, 30, 50), min_length=1, description="numbers of stars of the curve"
    )
    trials: int = Field(default=4000, ge=50, le=1_000_000, description="fields of stars per number")


class ThermalConfig(StrictModel):
    """Temperature of lens and housing in use, about that of the calibration."""

    stability_k: float = Field(
        default=1.0, ge=0, le=40, description="3 sigma; ACC18 holds its laboratory to 20 +- 1 C; 0: no thermal term"
    )


class ToleranceConfig(StrictModel):
    """Monte-Carlo of the lens as built: standard deviations, every element, both axes."""

    decentre_um: float = Field(default=10.0, ge=0, le=1000, description="decentre per axis")
    tilt_arcmin: float = Field(default=0.5, ge=0, le=60, description="tilt per axis, about the first vertex")
    despace_um: float = Field(default=10.0, ge=0, le=1000, description="shift along the axis")
    draws: int = Field(default=200, ge=2, le=100_000, description="lenses built")
    limit_px: float = Field(
        default=80.0, gt=0, le=1e5, description="boresight motion beyond which a lens counts as not built"
    )


class Config(SweptConfig, SensorExperimentConfig):
    """One instrument and what is asked of it."""

    NOT_SWEPT = frozenset({"attitude", "thermal", "tolerances"})

    instrument: InstrumentConfig = InstrumentConfig()
    detector: DetectorConfig = DetectorConfig()
    moved: MovedConfig = MovedConfig()
    target: TargetConfig = TargetConfig(pitch_px=150.4)  # not whole pixels: points at all fractions of a pixel
    passband: PassbandConfig = PassbandConfig()
    source: SourceConfig = SourceConfig()
    filters: FilterConfig = FilterConfig()
    collimator: FilteredCollimatorConfig = FilteredCollimatorConfig()
    hexapod: HexapodConfig = HexapodConfig()
    steps: StepConfig = StepConfig()
    grid: GridConfig = GridConfig()
    thermal: ThermalConfig = ThermalConfig()
    frames: int = Field(default=30, ge=2, le=10000, description="frames per position (ACC18: at least 30)")
    dark_frames: int = Field(default=100, ge=2, le=10000, description="frames with the lamp off, per position")
    window_px: OddPx = Field(default=13, ge=7, le=63, description="window around a point, odd")
    centroid: CentroiderName = Field(
        default="cog", description="centroider that counts; ACC18 names the centre of gravity"
    )
    compare: tuple[ProcessingName, ...] = Field(
        default=("epsf", "epsf_measured"), description="others on the same frames; epsf_measured: PSF built from frames"
    )
    attitude: AttitudeConfig = AttitudeConfig()
    tolerances: ToleranceConfig = ToleranceConfig()
    published_within_fraction: float | None = Field(
        default=None, gt=0, le=1, description="if given, the measured terms have to land this near to the published"
    )
    predict_only: bool = Field(default=False, description="no rendered frames: the predicted terms and sums alone")

    @model_validator(mode="after")
    def _windows(self) -> Config:
        if self.target.rows * self.target.columns < 2:
            raise ValueError("target.rows * target.columns = 1: at least 2 points are needed")
        check_windows(self.window_px, self.target)
        return self

    @property
    def methods(self) -> tuple[str, ...]:
        """All centroiders, the one that counts first."""
        return tuple(dict.fromkeys((self.centroid, *self.compare)))


def _instead(config: Config) -> Experiment | None:
    if not config.predict_only:
        return None
    return replace(rendered, run="experiment:predict", report="prediction.md", instead=None)


rendered = Experiment(
    name="budget",
    config=Config,
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
    takes="6 min (--quick: 45 s)",
    examples={
        "--quick": "a small run",
        "--predict-only": "the predicted terms alone, in seconds",
        "--sweep detector.read_noise_e=2:20:10": "the predicted budget against the read noise",
        "--config acc18_tuned": "an instrument with the published budget",
    },
    show=("budget",),
    options={"predict-only": ("predict_only", "No rendered frames: the predicted terms and sums alone.")},
    instead=_instead,
    quick={
        "frames": 10,
        "dark_frames": 30,
        "target.rows": 3,
        "target.columns": 3,
        "steps.places": 1,
        "steps.positions": 6,
        "tolerances.draws": 30,
        "attitude.trials": 500,
        "attitude.counts": [2, 5, 10, 30],
    },
)
experiment = with_what_if(rendered, renders=True)
main = command(experiment)
