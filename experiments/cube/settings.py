"""Settings and declaration of the cube-mirror experiment; the defaults are the bench of CUBE09 as far as published."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from experiments.harness.cli import command
from experiments.harness.config import ExperimentConfig
from experiments.harness.experiment import Experiment
from optics.errors import ConfigError
from optics.settings import FileName, StrictModel

FaceName = Literal["+Z", "+X", "-X", "+Y", "-Y", "-Z"]


OffsetMm = Annotated[float, Field(ge=-1000, le=1000)]


class SimulatorConfig(StrictModel):
    """The sun simulator."""

    source_arcmin: float = Field(default=3.0, ge=0, le=60, description="angular diameter of the simulated sun")
    diameter_mm: float = Field(default=60.0, gt=0, le=1000, description="width of the beam")
    gap_mm: float = Field(default=20.0, gt=0, le=1000, description="distance from the screen (CUBE09: about 20 mm)")


class ScreenConfig(StrictModel):
    """The screen with its aperture."""

    distance_mm: float = Field(default=650.0, ge=50, le=10000, description="aperture to cube face (CUBE09: 650 mm)")
    aperture_mm: float = Field(default=2.5, gt=0, le=50, description="diameter of the aperture (CUBE09: 2.5 mm)")
    side_mm: float = Field(default=200.0, gt=0, le=2000, description="side of the screen")
    reflectance_fraction: float = Field(default=0.8, gt=0, le=1, description="diffuse reflectance")


class CubeConfig(StrictModel):
    """Cube mirror and its mounting errors."""

    side_mm: float = Field(default=20.0, gt=0, le=500, description="edge length")
    chamfer_mm: float = Field(default=0.5, ge=0, le=50, description="unpolished rim of each face")
    offset_mm: tuple[OffsetMm, OffsetMm, OffsetMm] = Field(
        default=(0.0, 0.0, 0.0), description="centre of the cube in the table frame, from the intersection of the axes"
    )
    square_arcsec: float = Field(default=20.0, ge=0, le=3600, description="1 sigma: deviation of the faces from 90 deg")
    mount_arcmin: float = Field(
        default=40.0, ge=0, le=300, description="1 sigma per axis: misalignment of cube and table"
    )
    faces: tuple[FaceName, ...] = Field(default=("+Z", "+X"), description="faces in the order of measurement")
    repeats: int = Field(default=1, ge=1, le=20, description="trims per face")
    method: Literal["triad", "wahba"] = Field(default="triad", description="reduction method")


class CubeCameraConfig(StrictModel):
    """CCD camera that images the screen."""

    detector: FileName = Field(default="", description="detector TOML file; empty: the 15 um CCD of CUBE09")
    distance_mm: float = Field(default=250.0, ge=50, le=5000, description="distance from the screen")
    angle_deg: float = Field(default=18.0, ge=5, le=60, description="angle from the normal of the screen")
    plateau_e: float = Field(default=40000.0, gt=0, le=1e6, description="electrons per pixel in the fully lit spot")
    exposure_s: float = Field(default=0.1, gt=0, le=100, description="exposure time")
    mounting_arcsec: float = Field(
        default=2.0,
        ge=0,
        le=600,
        description="1 sigma: movement of the mount between the two pictures, as tilt of a face",
    )


class CubeTableConfig(StrictModel):
    """The two-axis turntable."""

    outer_reading_arcsec: float = Field(default=0.3, ge=0, le=60, description="1 sigma of a reading (CUBE09)")
    inner_reading_arcsec: float = Field(default=0.4, ge=0, le=60, description="1 sigma of a reading (CUBE09)")
    square_arcsec: float = Field(
        default=2.0, ge=0, le=600, description="1 sigma: non-orthogonality of the axes (CUBE09)"
    )


class TrimConfig(StrictModel):
    """Trim procedure."""

    stop_px: float = Field(default=1.0, gt=0, le=100, description="largest accepted offset per axis (CUBE09: 1 px)")
    allowed: int = Field(default=20, ge=1, le=1000, description="most table settings per face")
    step_deg: float = Field(default=0.001, ge=0, le=1, description="step of the table setting (Table 1)")
    gain_ratio: float = Field(default=0.8, gt=0, le=1.5, description="fraction of the offset removed by a trim")
    start_px: float = Field(
        default=20.0, ge=0, le=1e5, description="largest initial offset per axis, set by eye (Table 1)"
    )


class SunSensorConfig(StrictModel):
    """Aperture-mask sun sensor and its calibration on the table."""

    detector: FileName = Field(default="", description="detector TOML file; empty: a small CMOS of 7 um pixels")
    hole_um: float = Field(default=200.0, gt=10, le=2000, description="diameter of the hole in the mask")
    gap_mm: float = Field(default=3.0, gt=0.1, le=50, description="mask to detector")
    gap_tolerance_um: float = Field(default=10.0, ge=0, le=200, description="1 sigma of the distance")
    centring_px: float = Field(default=4.0, ge=0, le=100, description="1 sigma: offset of hole and detector")
    mount_arcmin: float = Field(
        default=20.0, ge=0, le=300, description="1 sigma per axis: misalignment of sensor and table"
    )
    field_deg: float = Field(default=43.0, gt=1, le=60, description="half range of the table angles")
    grid: int = Field(default=11, ge=3, le=41, description="positions along each axis")
    frames: int = Field(default=2, ge=1, le=1000, description="frames averaged at each position")
    plateau_e: float = Field(
        default=10000.0, gt=0, le=1e6, description="electrons per pixel in the spot, Sun on the axis"
    )
    window_px: int = Field(default=48, ge=16, le=512, description="side of the window around a spot")
    log2_particles: int = Field(default=13, ge=8, le=16, description="log2 of the particles per spot")


class BenchesConfig(StrictModel):
    """Monte Carlo over benches."""

    count: int = Field(default=100, ge=2, le=10000, description="number of misaligned benches")
    log2_particles: int = Field(default=18, ge=12, le=24, description="log2 of the particles per picture of the screen")
    shown_log2_particles: int = Field(
        default=21, ge=12, le=24, description="log2 of the particles for the report's pictures"
    )


class CubeMirrorConfig(ExperimentConfig):
    """The published run; CUBE09 states distance, aperture, pixel, table, stopping criterion and error terms."""

    simulator: SimulatorConfig = SimulatorConfig()
    screen: ScreenConfig = ScreenConfig()
    cube: CubeConfig = CubeConfig()
    camera: CubeCameraConfig = CubeCameraConfig()
    table: CubeTableConfig = CubeTableConfig()
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
    def _reachable(self) -> CubeMirrorConfig:
        cube = self.cube
        for face in cube.faces:
            if face in ("+Y", "-Y"):
                raise ValueError(
                    f"cube.faces: {face} faces the light at an outer angle of 90 deg only, where the inner axis is "
                    "parallel to the light and cannot trim; choose from +Z, +X, -X"
                )
            if face == "-Z":
                raise ValueError("cube.faces: -Z is glued to the sensor; choose from +Z, +X, -X")
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
            raise ValueError(
                f"cube.faces starts with {cube.faces[0]}; the first face must be +Z, which defines the cube's Z"
            )
        if self.trim.step_deg > 0 and self.trim.gain_ratio == 0:
            raise ValueError("trim.gain_ratio = 0: the table would never move")
        return self


experiment = Experiment(
    name="cube",
    config=CubeMirrorConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    takes="3 min (--quick: 25 s)",
    examples={
        "--quick": "eight benches instead of a hundred",
        "--set camera.mounting_arcsec=0.5 --set trim.stop_px=0.3": "a stiffer mount, a tighter trim",
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
