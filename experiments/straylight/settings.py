"""Settings and declaration of the stray-light experiment."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, ClassVar

from pydantic import Field, field_validator

from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.laboratory.settings.sensor_file import SensorConfig, SensorExperimentConfig
from optics.settings import FileName, StrictModel
from render.sensor_file.tables import CatalogueConfig, InstrumentConfig


class PstConfig(StrictModel):
    """Angles and accuracy of the computed point-source transmittance."""

    dimensionless: ClassVar[frozenset[str]] = frozenset({"walls_error"})

    file: FileName = Field(
        default="", description="table instead of the computation: CSV or ECSV with angle_deg and a column per cause"
    )
    angles_deg: tuple[Annotated[float, Field(gt=0, le=90)], ...] = Field(
        default=(0.3, 1, 3, 6, 10, 13, 16, 18, 20, 23, 26, 29, 32, 34, 36, 40, 45, 50, 60, 70, 80, 90),
        min_length=3,
        description="angles of the source from the boresight, increasing",
    )
    azimuths_deg: tuple[Annotated[float, Field(ge=0, le=90)], ...] = Field(
        default=(0.0, 45.0), min_length=1, description="azimuths of the source, from column towards row, increasing"
    )
    points: int = Field(default=4, ge=3, le=15, description="points along each side of the detector")
    rings: int = Field(default=3, ge=1, le=32, description="rings of the pupil quadrature")
    arms: int = Field(default=8, ge=4, le=128, description="azimuths of the pupil quadrature")
    ghost_rings: int = Field(default=12, ge=4, le=200, description="rings of ghost rays on the first surface")
    ghost_arms: int = Field(default=32, ge=8, le=512, description="azimuths of ghost rays on the first surface")
    walls_error: float = Field(default=0.05, gt=0, lt=1, description="relative standard error for walls and vanes")

    @field_validator("angles_deg", "azimuths_deg")
    @classmethod
    def _increasing(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if any(b <= a for a, b in pairwise(values)):
            raise ValueError(f"{list(values)}; they must increase")
        return values


class SunFramesConfig(StrictModel):
    """Frames of the real sky in sunlight."""

    attitudes: int = Field(default=6, ge=2, le=1000, description="attitudes, uniform over all rotations")
    levels: int = Field(default=9, ge=4, le=60, description="number of Sun angles, at equal steps of stray light")
    faintest_mag: float = Field(default=8.0, ge=3, le=12, description="faintest stars that are rendered")


class RatesConfig(StrictModel):
    """Limits of a usable frame; the exclusion angle is the largest angle at which either limit is exceeded."""

    dimensionless: ClassVar[frozenset[str]] = frozenset({"false_per_frame", "lost_fraction"})

    false_per_frame: float = Field(
        default=1.0, ge=0, le=1e6, description="false detections per frame in addition to those without the Sun"
    )
    lost_fraction: float = Field(
        default=0.1, ge=0, lt=1, description="fraction lost of the stars detected without the Sun"
    )


class StraylightConfig(SensorExperimentConfig, SensorConfig):
    """Sensor file; default: a 26 mm F/2 tracker with 1024 x 1024 px, 0.2 s and a baffle that shades from 35 deg on."""

    instrument: InstrumentConfig = InstrumentConfig(
        lens="star_tracker_26mm", detector="cmv4000", width_px=1024, height_px=1024, exposure_s=0.2
    )
    window_px: int = Field(default=7, ge=5, le=63, description="side of the centroid window, odd")
    catalogue: CatalogueConfig = CatalogueConfig()
    dark_frames: int = Field(default=12, ge=1, le=1000, description="dark frames averaged")
    background_e_per_s: float = Field(default=2.0, ge=0, le=1e6, description="sky light per pixel without stray light")
    pst: PstConfig = PstConfig()
    frames: SunFramesConfig = SunFramesConfig()
    rates: RatesConfig = RatesConfig()
    earth_altitude_km: float = Field(
        default=550.0, ge=150, le=1e6, description="altitude of the sensor above the Earth"
    )
    what_if: bool = Field(default=True, description="repeat with dust, coating and vanes changed one at a time")


experiment = Experiment(
    name="straylight",
    config=StraylightConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    limits="experiment:limits",
    takes="3 min (--quick: 30 s)",
    examples={
        "--sensor my.toml": "your own sensor, with its [baffle], [scatter], [contamination]",
        "--set baffle.coating=magic_black --set contamination.level=500": "another coating, more dust",
        "--set baffle.mesh=baffle.ply": "your own baffle as a closed mesh in mm",
        "--set pst.file=measured.csv": "a measured point-source transmittance",
    },
    show=("transmittance", "exclusion"),
    files="experiment:save_table",
    quick={
        "pst.angles_deg": [0.3, 3, 10, 16, 20, 25, 30, 34, 36, 45, 60, 90],
        "pst.azimuths_deg": [0.0],
        "pst.points": 3,
        "pst.rings": 2,
        "pst.ghost_rings": 8,
        "pst.ghost_arms": 24,
        "frames.attitudes": 2,
        "frames.levels": 5,
        "dark_frames": 6,
        "what_if": False,
    },
)
main = command(experiment)
