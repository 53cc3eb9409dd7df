"""Configuration of the camera report: a sensor file, and the studies of the report."""

from __future__ import annotations

import typing
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.sweeps import SweptConfig, with_what_if
from experiments.laboratory.settings.prediction import PredictedSensorConfig
from optics.settings import StrictModel


class SlewRatesConfig(StrictModel):
    """Slew rates of the curves, from rest to the rate whose trail fills the window."""

    points: int = Field(default=5, ge=0, le=41, description="number of rates")
    fastest_deg_per_s: float | None = Field(
        default=None, gt=0, le=100, description="highest rate, in place of the default"
    )


class TemperatureRangeConfig(StrictModel):
    """Temperatures of lens and housing; the lens is focused at the prescription's temperature."""

    lowest_c: float = Field(default=-20.0, ge=-100, le=100, description="lowest temperature")
    highest_c: float = Field(default=40.0, ge=-100, le=100, description="highest temperature")
    points: int = Field(default=5, ge=2, le=41, description="number of temperatures")

    @model_validator(mode="after")
    def _range(self) -> TemperatureRangeConfig:
        if self.lowest_c >= self.highest_c:
            raise ValueError(f"lowest_c = {self.lowest_c:g} is not below highest_c = {self.highest_c:g}")
        return self


class LostInSpaceConfig(StrictModel):
    """Lost-in-space identification of simulated star lists."""

    attitudes: int = Field(default=200, ge=0, le=10_000, description="number of attitudes taken from [sky]")


class RenderedFramesConfig(StrictModel):
    """Rendered frames that check the prediction: the real sky, and a grid of artificial stars."""

    sky: int = Field(default=8, ge=2, le=1000, description="frames of the real sky, in random attitudes")
    chart_stars: int = Field(default=300, ge=40, le=20000, description="artificial stars spread over the detector")
    readouts: int = Field(default=8, ge=3, le=1000, description="read-outs of the artificial stars")


Parameter = Literal[
    "instrument.exposure_s",
    "instrument.f_number",
    "instrument.defocus_mm",
    "instrument.chip_temperature_c",
    "detector.read_noise_e",
    "detector.dark_current_e_per_s",
    "detector.prnu",
    "throughput_fraction",
    "background_e_per_s",
    "threshold_sigma",
]


class TornadoConfig(StrictModel):
    """Sensitivity analysis: settings changed singly to rank design changes, and the size of each change."""

    parameters: tuple[Parameter, ...] = Field(
        default=typing.get_args(Parameter), description="keys that are varied; empty: no chart"
    )
    change_fraction: float = Field(default=0.2, gt=0, lt=1, description="relative change of keys with a natural zero")
    chip_k: float = Field(default=10.0, gt=0, le=50, description="change of the chip temperature")


class CameraReportConfig(SweptConfig, PredictedSensorConfig):
    """Sensor file and evaluations; defaults: the built-in star tracker."""

    NOT_SWEPT: ClassVar[frozenset[str]] = frozenset(
        {
            "requirements",
            "filters",
            "sky",
            "lost",
            "motion",
            "thermal",
            "frames",
            "tornado",
            "manufacture",
            "life",
            "baffle",
            "scatter",
            "contamination",
        }
    )

    motion: SlewRatesConfig = SlewRatesConfig()
    thermal: TemperatureRangeConfig = TemperatureRangeConfig()
    lost: LostInSpaceConfig = LostInSpaceConfig()
    frames: RenderedFramesConfig = RenderedFramesConfig()
    tornado: TornadoConfig = TornadoConfig()
    predict_only: bool = Field(default=False, description="predict only, without rendered frames")


experiment = with_what_if(
    Experiment(
        name="camera",
        config=CameraReportConfig,
        run="run:run",
        sections="experiment:SECTIONS",
        predict="experiment:predict",
        limits="answer:limits",
        swept=(
            "attitude_cross_arcsec",
            "attitude_roll_arcsec",
            "single_star_arcsec",
            "limiting_magnitude_mag",
            "stars_worst_per_frame",
            "nea_arcsec",
            "stars_mean_per_frame",
            "spot_px",
        ),
        compared=("magnitudes.nea_arcsec", "magnitudes.detected_fraction"),
        takes="1 min (--quick: 30 s)",
        examples={
            "--sensor my.toml": "your own sensor",
            "--sensor my.toml --predict-only": "the answer and the report without frames, in 10 s",
            "--sensor my.toml --set instrument.exposure_s=0.2": "the same with another exposure",
            "--sensor my.toml --sweep instrument.exposure_s=0.05:0.4:8": "curves over the exposure time",
            "--sensor my.toml --sweep exposure_s=0.01:1:9:log": "logarithmic steps; a list: exposure_s=0.05,0.1,0.4",
            "--sensor my.toml --sweep exposure_s=0.05:0.4:8 --sweep f_number=3:5:5": "a map over two keys",
            "--sensor a.toml --sensor b.toml": "comparison of predictions",
        },
        show=("requirements",),
        options={"predict-only": ("predict_only", "Predict only, without rendered frames.")},
        renders=lambda config: not config.predict_only,
        quick={
            "sky.attitudes": 200,
            "thermal.points": 3,
            "motion.points": 3,
            "lost.attitudes": 60,
            "frames.sky": 4,
            "frames.chart_stars": 270,
            "frames.readouts": 4,
            "dark_frames": 8,
        },
    )
)
main = command(experiment)
