"""Settings and declaration of the cube-mirror experiment; the defaults are the bench of CUBE09 as far as published."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from experiments.harness.cli import command
from experiments.harness.config import ExperimentConfig, FileName, StrictModel
from experiments.harness.experiment import Experiment
from optics.errors import ConfigError

FaceName = Literal["+Z", "+X", "-X", "+Y", "-Y", "-Z"]


OffsetMm = Annotated[float, Field(ge=-1000, le=1000)]


class SimulatorConfig(StrictModel):
    """The sun simulator."""

    source_arcmin: float = Field(default=3.0, ge=0, le=60, description="angular diameter of the simulated sun")
    diameter_mm: float = Field(default=60.0, gt=0, le=1000, description="width of the beam")
    gap_mm: float = Field(default=20.0, gt=0, le=1000, description="from the screen (CUBE09: about 20 mm)")


class ScreenConfig(StrictModel):
    """The screen with its aperture."""

    distance_mm: float = Field(default=650.0, ge=50, le=10000, description="aperture to cube face (CUBE09: 650 mm)")
    aperture_mm: float = Field(default=2.5, gt=0, le=50, description="diameter of the aperture (CUBE09: 2.5 mm)")
    side_mm: float = Field(default=200.0, gt=0, le=2000, description="side of the screen")
    reflectance_fraction: float = Field(default=0.8, gt=0, le=1, description="diffuse reflectance")


class CubeConfig(StrictModel):
    """The cube mirror and how badly it is glued on."""

    side_mm: float = Field(default=20.0, gt=0, le=500, description="edge length")
    chamfer_mm: float = Field(default=0.5, ge=0, le=50, description="unpolished rim of each face")
    offset_mm: tuple[OffsetMm, OffsetMm, OffsetMm] = Field(
        default=(0.0, 0.0, 0.0), description="centre of the cube in the table frame, from where the axes cross"
    )
    square_arcsec: float = Field(default=20.0, ge=0, le=3600, description="1 sigma: faces out of square")
    mount_arcmin: float = Field(default=40.0, ge=0, le=300, description="1 sigma per axis: cube against table")
    faces: tuple[FaceName, ...] = Field(default=("+Z", "+X"), description="faces in the order of measurement")
    repeats: int = Field(default=1, ge=1, le=20, description="how often each face is trimmed")
    method: Literal["triad", "wahba"] = Field(default="triad", description="reduction of the faces")


class CameraConfig(StrictModel):
    """The CCD camera that looks at the screen."""

    detector: FileName = Field(default="", description="detector TOML file; empty: the 15 um CCD of CUBE09")
    distance_mm: float = Field(default=250.0, ge=50, le=5000, description="from the screen")
    angle_deg: float = Field(default=18.0, ge=5, le=60, description="off the normal of the screen")
    plateau_e: float = Field(default=40000.0, gt=0, le=1e6, description="electrons of a pixel in the full spot")
    exposure_s: float = Field(default=0.1, gt=0, le=100, description="exposure time")
    mounting_arcsec: float = Field(
        default=2.0, ge=0, le=600, description="1 sigma: give of the mount between the two pictures, as tilt of a face"
    )


class TableConfig(StrictModel):
    """The two-axis turntable."""

    outer_reading_arcsec: float = Field(default=0.3, ge=0, le=60, description="1 sigma of a reading (CUBE09)")
    inner_reading_arcsec: float = Field(default=0.4, ge=0, le=60, description="1 sigma of a reading (CUBE09)")
    square_arcsec: float = Field(default=2.0, ge=0, le=600, description="1 sigma: axes out of square (CUBE09)")


class TrimConfig(StrictModel):
    """How the operator trims."""

    stop_px: float = Field(default=1.0, gt=0, le=100, description="both offsets below this (CUBE09: 1 px)")
    allowed: int = Field(default=20, ge=1, le=1000, description="settings of the table per face")
    step_deg: float = Field(default=0.001, ge=0, le=1, description="the table is set in whole steps (Table 1)")
    gain_ratio: float = Field(default=0.8, gt=0, le=1.5, description="part of the offset that a trim takes out")
    start_px: float = Field(default=20.0, ge=0, le=1e5, description="the eye starts within this, per axis (Table 1)")


class SunSensorConfig(StrictModel):
    """The aperture-mask sun sensor and its calibration against the table."""

    detector: FileName = Field(default="", description="detector TOML file; empty: a small CMOS of 7 um pixels")
    hole_um: float = Field(default=200.0, gt=10, le=2000, description="diameter of the hole in the mask")
    gap_mm: float = Field(default=3.0, gt=0.1, le=50, description="mask to detector")
    gap_tolerance_um: float = Field(default=10.0, ge=0, le=200, description="1 sigma of it")
    centring_px: float = Field(default=4.0, ge=0, le=100, description="1 sigma: hole against detector")
    mount_arcmin: float = Field(default=20.0, ge=0, le=300, description="1 sigma per axis: sensor against table")
    field_deg: float = Field(default=43.0, gt=1, le=60, description="table angles go from minus to plus this")
    grid: int = Field(default=11, ge=3, le=41, description="positions along each axis")
    frames: int = Field(default=2, ge=1, le=1000, description="frames averaged at each position")
    plateau_e: float = Field(default=10000.0, gt=0, le=1e6, description="electrons of a pixel in the spot, Sun ahead")
    window_px: int = Field(default=48, ge=16, le=512, description="window around a spot")
    log2_particles: int = Field(default=13, ge=8, le=16, description="particles per spot")


class BenchesConfig(StrictModel):
    """The Monte-Carlo."""

    count: int = Field(default=100, ge=2, le=10000, description="misaligned benches")
    log2_particles: int = Field(default=18, ge=12, le=24, description="particles per picture of the screen")
    shown_log2_particles: int = Field(default=21, ge=12, le=24, description="the same for the pictures in the report")


class Config(ExperimentConfig):
    """The published run: CUBE09 gives distance, aperture, pixel, table, stop rule and error terms."""

    simulator: SimulatorConfig = SimulatorConfig()
    screen: ScreenConfig = ScreenConfig()
    cube: CubeConfig = CubeConfig()
    camera: CameraConfig = CameraConfig()
    table: TableConfig = TableConfig()
    trim: TrimConfig = TrimConfig()
    sensor: SunSensorConfig = SunSensorConfig()
    benches: BenchesConfig = BenchesConfig()

    @classmethod
    def of_sensor(cls, file: Path) -> dict[str, Any]:
        """No star sensor stands on this bench."""
        raise ConfigError(
            f"--sensor {file}: cube measures a sun sensor, a mask with a hole over a detector, which has no lens; it "
            "is set in the tables [sensor] and [camera] of --config"
        )

    @model_validator(mode="after")
    def _reachable(self) -> Config:
        cube = self.cube
        for face in cube.faces:
            if face in ("+Y", "-Y"):
                raise ValueError(
                    f"cube.faces: {face} turns to the light at an outer angle of 90 deg only, where the inner axis "
                    "points along the light and trims nothing; choose from +Z, +X, -X"
                )
            if face == "-Z":
                raise ValueError("cube.faces: -Z is the face that is glued to the sensor; choose from +Z, +X, -X")
        if len({face[1] for face in cube.faces}) < 2:
            raise ValueError(
                f"cube.faces = {list(cube.faces)}: the faces are parallel; one of +Z and one of +X, -X are needed"
            )
        if cube.method == "triad" and len(set(cube.faces)) > 2:
            raise ValueError(
                f"cube.faces = {list(cube.faces)} with cube.method = triad: TRIAD takes two faces; set "
                "cube.method=wahba"
            )
        if cube.faces[0] != "+Z":
            raise ValueError(f"cube.faces starts with {cube.faces[0]}; the first one is +Z, which defines the cube's Z")
        if self.trim.step_deg > 0 and self.trim.gain_ratio == 0:
            raise ValueError("trim.gain_ratio = 0: the table would never move")
        return self


experiment = Experiment(
    name="cube",
    config=Config,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    takes="3 min (--quick: 25 s)",
    examples={
        "--quick": "eight benches instead of a hundred",
        "--set camera.mounting_arcsec=0.5 --set trim.stop_px=0.3": "a stiffer mount, a stricter stop rule",
    },
    show=("trims", "budget"),
    quick={
        "benches.count": 8,
        "benches.log2_particles": 17,
        "benches.shown_log2_particles": 19,
        "sensor.grid": 7,
    },
)
main = command(experiment)
