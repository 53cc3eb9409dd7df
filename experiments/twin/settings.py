"""Inputs of the twin: a folder of frames, and known properties of camera and site."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field, field_validator

from experiments.harness.cli import command
from experiments.harness.config import ExperimentConfig
from experiments.harness.experiment import Experiment
from optics.settings import FileName, FolderName, StrictModel
from optics.validate import parse_model

OrderName = Literal["pinhole", "radial_1", "radial_2", "brown_conrady", "polynomial_3"]


class CameraPriorConfig(StrictModel):
    """Prior knowledge of the camera; frames determine angles per pixel, not lengths."""

    name: str = Field(default="", description="name in reports; default: the folder")
    field_deg: float | None = Field(
        default=None, gt=0.5, le=120, description="approximate field along the width; default: searched"
    )
    pixel_pitch_um: float | None = Field(default=None, ge=0.1, le=1000, description="pixel pitch, binning included")
    focal_length_mm: float | None = Field(
        default=None, gt=0, le=1e5, description="focal length, from which a missing pixel pitch follows"
    )
    aperture_mm: float | None = Field(
        default=None,
        gt=0,
        le=1e4,
        description="entrance pupil diameter; default: the smallest that the measured light allows",
    )
    exposure_s: float | None = Field(
        default=None, gt=0, le=1e4, description="exposure time; default: from the files, else 1 s"
    )
    black_level_dn: float | None = Field(
        default=None,
        ge=0,
        le=65535,
        description="level without light; default: unknown, read noise given as an interval",
    )


class SiteConfig(StrictModel):
    """Site of the frames; with their times it determines the zenith."""

    latitude_deg: float | None = Field(default=None, ge=-90, le=90, description="north positive")
    longitude_deg: float | None = Field(default=None, ge=-180, le=360, description="east positive")
    refraction_arcsec: float = Field(
        default=58.3, ge=0, le=120, description="refraction / tan z; 58.3 at sea level, 0 in space"
    )


class NightConfig(StrictModel):
    """Frames of a known camera, rendered if no folder is given."""

    lens: FileName = Field(default="star_tracker_26mm", description="lens")
    detector: FileName = Field(default="cmv4000", description="detector")
    width_px: int = Field(default=896, ge=256, le=4096, description="columns read out")
    height_px: int = Field(default=768, ge=256, le=4096, description="rows read out")
    exposure_s: float = Field(default=0.5, gt=0, le=100, description="exposure time")
    frames: int = Field(default=6, ge=2, le=50, description="number of frames, at random attitudes")
    darkest_e_per_s: float = Field(default=300.0, ge=0, le=1e6, description="background of the first frame")
    brightest_e_per_s: float = Field(default=7000.0, ge=0, le=1e6, description="background of the last frame")


class TwinConfig(ExperimentConfig):
    """Frames, prior knowledge and rendered sets."""

    SENSOR_KEYS: ClassVar[Mapping[str, str]] = {"instrument.exposure_s": "camera.exposure_s"}

    frames: FolderName = Field(default="", description="folder of frames; empty: frames of a known camera are rendered")
    camera: CameraPriorConfig = CameraPriorConfig()
    site: SiteConfig = SiteConfig()
    orders: tuple[OrderName, ...] = Field(
        default=("pinhole", "radial_1", "radial_2", "brown_conrady", "polynomial_3"),
        min_length=1,
        max_length=5,
        description="camera models compared, simplest first",
    )
    prescription: FileName = Field(
        default="", description="sensor file of a known lens; frames give focus, tilt and decentre"
    )
    realisations: int = Field(default=5, ge=2, le=100, description="rendered sets of frames")
    night: NightConfig = NightConfig()

    @field_validator("orders")
    @classmethod
    def _once(cls, values: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(values)) < len(values):
            raise ValueError("a camera model is named twice")
        return values

    @classmethod
    def of_sensor(cls, file: Path) -> dict[str, Any]:
        """Settings of a sensor file known before frames are read: pitch, exposure time, whether its lens can be
        traced."""
        from render.detector.spec import load_detector
        from render.sensor_file.file import SensorFile, complete_sensor
        from render.sensor_file.instrument import stated_lens

        instrument = SensorFile.model_validate(complete_sensor(file)).instrument
        pitch_um = load_detector(instrument.detector).pixel_pitch_mm * 1e3
        traced = {"prescription": str(file.resolve())} if stated_lens(instrument).surfaces else {}
        return {"camera": {"pixel_pitch_um": pitch_um, "exposure_s": instrument.exposure_s}, **traced}

    def as_sensor(self, file: Path | None) -> StrictModel | None:
        """The sensor file that was given; the twin's own is written by a run."""
        from experiments.laboratory.settings.sensor_file import SensorConfig
        from render.sensor_file.file import read_sensor

        return None if file is None else parse_model(SensorConfig, read_sensor(file, SensorConfig), str(file))


experiment = Experiment(
    name="twin",
    config=TwinConfig,
    run="experiment:run",
    sections="report:SECTIONS",
    axes="report:axes",
    takes="3 min (--quick: 40 s)",
    examples={
        "--frames my_night --set camera.pixel_pitch_um=6.9": "the twin of the camera that took these frames",
        "--quick": "four rendered frames of a known camera",
    },
    options={"frames": ("frames", "Folder of night frames: TIFF, PNG, JPEG, PGM, PPM, FITS, NumPy.")},
    show=("camera", "comparison"),
    judged="twin",
    files="experiment:files",
    quick={
        "night.frames": 4,
        "night.width_px": 704,
        "night.height_px": 640,
        "realisations": 3,
        "orders": ["pinhole", "radial_1", "radial_2"],
    },
)
main = command(experiment)
