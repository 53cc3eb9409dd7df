"""Settings and declaration of the attitude-correlated-frames experiment; the defaults are Table 1 of ACF17."""

from __future__ import annotations

import math
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, Field, model_validator

from experiments.harness.cli import command
from experiments.harness.config import AngleDeg
from experiments.harness.experiment import Experiment
from experiments.laboratory.settings.sensor_file import SensorConfig, SensorExperimentConfig
from optics.settings import StrictModel
from optics.validate import parse_model
from render.sensor_file.file import read_sensor
from render.sensor_file.tables import InstrumentConfig

WIDEST_DEG = 120.0
"""Largest field across the diagonal: a rectilinear image stretches as 1 / cos^2 of the field angle."""
UNKNOWNS = 14
CAMERA_UNKNOWNS = 8
Number = TypeVar("Number", int, float)


def _ascending(values: tuple[Number, ...], least: int = 1) -> tuple[Number, ...]:
    # checked here: with a least length of the field, a wrong number in a list would also be refused as a short list
    if len(values) < least:
        raise ValueError(f"{len(values)} given; at least {least} are needed")
    if any(later <= earlier for earlier, later in pairwise(values)):
        raise ValueError("increasing values are needed, each once")
    return values


ONE, TWO = AfterValidator(_ascending), AfterValidator(partial(_ascending, least=2))
"""Check of a list: increasing values, and their smallest number."""
GyroSizes = Annotated[tuple[Annotated[float, Field(ge=0, le=1000)], ...], ONE]


class AcfCameraConfig(StrictModel):
    """The star sensor of Table 1, which does not state the pixel pitch."""

    width_px: int = Field(default=1024, ge=16, le=20000, description="columns")
    height_px: int = Field(default=1024, ge=16, le=20000, description="rows")
    pixel_pitch_um: float = Field(default=10.0, gt=0, le=1000, description="pixel pitch; not stated by ACF17")
    focal_length_mm: float = Field(default=25.6, gt=0, le=1e5, description="focal length")
    x0_px: float = Field(
        default=10.0, ge=-1e5, le=1e5, description="principal point from the centre of the image, columns"
    )
    y0_px: float = Field(
        default=-10.0, ge=-1e5, le=1e5, description="principal point from the centre of the image, rows"
    )
    q1_per_mm2: float = Field(default=2e-4, ge=-1, le=1, description="radial distortion, cubic")
    q2_per_mm4: float = Field(default=-4e-7, ge=-1, le=1, description="radial distortion, fifth order")
    q3_per_mm6: float = Field(default=1e-8, ge=-1, le=1, description="radial distortion, seventh order")
    p1_per_mm: float = Field(default=2e-4, ge=-1, le=1, description="tangential distortion")
    p2_per_mm: float = Field(default=2e-4, ge=-1, le=1, description="tangential distortion")

    @property
    def diagonal_deg(self) -> float:
        """Field across the diagonal, without distortion."""
        half_mm = 0.5e-3 * self.pixel_pitch_um * math.hypot(self.width_px, self.height_px)
        return 2.0 * math.degrees(math.atan2(half_mm, self.focal_length_mm))

    @model_validator(mode="after")
    def _forms_an_image(self) -> AcfCameraConfig:
        if self.diagonal_deg > WIDEST_DEG:
            raise ValueError(
                f"focal_length_mm = {self.focal_length_mm:g} mm: the field is {self.diagonal_deg:.0f} deg across the "
                f"diagonal; at most {WIDEST_DEG:g} deg can be taken by a rectilinear camera: use a longer focal "
                "length or a smaller detector"
            )
        off_px = max(abs(self.x0_px) / self.width_px, abs(self.y0_px) / self.height_px)
        if off_px > 0.25:
            raise ValueError(
                f"principal point ({self.x0_px:g}, {self.y0_px:g}) px: at most a quarter of the image "
                f"({self.width_px} x {self.height_px} px) from its centre"
            )
        return self


class AcfStartConfig(StrictModel):
    """Start values of ACC: Table 2, no distortion, theta = 0; the other methods start from ACC's camera."""

    focal_length_mm: float = Field(default=20.0, gt=0, le=1e5, description="initial focal length")
    x0_px: float = Field(default=0.0, ge=-1e5, le=1e5, description="initial principal point, columns")
    y0_px: float = Field(default=0.0, ge=-1e5, le=1e5, description="initial principal point, rows")
    phi_from_stars: bool = Field(
        default=False, description="start phi from the stars with the start camera, in place of ACF17's 0 deg"
    )


class AcfGyroConfig(StrictModel):
    """The gyro of Table 1 and the motion; ACF17 does not state the axes of rotation."""

    rate_hz: float = Field(default=100.0, gt=0, le=10000, description="samples per second")
    angular_speed_deg_per_s: float = Field(default=0.5, gt=0, le=20, description="magnitude of the angular rate")
    motion: Literal["turning_axis", "fixed_axis"] = Field(
        default="turning_axis", description="whether the rotation axis turns in the body, once per sequence"
    )
    bias_deg_per_h: float = Field(
        default=0.03, ge=0, le=1000, description="magnitude of the bias per axis; its sign is drawn per run"
    )
    angle_random_walk_deg_per_sqrt_h: float = Field(
        default=0.005, ge=0, le=100, description="angle random walk per axis"
    )
    installation_deg: tuple[AngleDeg, AngleDeg, AngleDeg] = Field(
        default=(2.0, 2.0, 2.0), description="theta1, theta2, theta3: star sensor from gyro, angles as in eq. 2"
    )


class AcfSkyConfig(StrictModel):
    """Stars, uniform over the sphere; ACF17 does not state their number."""

    # with one star in a frame there is no interstar angle and no free attitude
    stars_per_frame: float = Field(default=34.0, ge=2, le=200, description="mean number of stars per frame")
    phi_deg: tuple[AngleDeg, AngleDeg, AngleDeg] = Field(
        default=(56.9476, -1.0046, -25.3335), description="phi1, phi2, phi3 of the first frame (Table 2)"
    )


class SweepConfig(StrictModel):
    """Not in ACF17: gain over free attitudes against star count and gyro noise."""

    stars: Annotated[tuple[Annotated[int, Field(ge=2, le=100)], ...], TWO] = Field(
        default=(2, 3, 4, 6, 10, 20, 40), description="stars per frame"
    )
    gyro_factor: Annotated[tuple[Annotated[float, Field(ge=0, le=1e5)], ...], ONE] = Field(
        default=(0.0, 1.0, 10.0, 50.0), description="gyro bias and random walk relative to Table 1"
    )
    noise_px: float = Field(default=0.1, gt=0, le=10, description="noise of a star's position per axis")
    skies: int = Field(default=100, ge=4, le=10000, description="runs per point, each with another sky")


class AcfConfig(SensorExperimentConfig):
    """The published runs; ACF17 does not state pixel pitch, number of stars and axes of motion."""

    camera: AcfCameraConfig = AcfCameraConfig()
    start: AcfStartConfig = AcfStartConfig()
    gyro: AcfGyroConfig = AcfGyroConfig()
    sky: AcfSkyConfig = AcfSkyConfig()
    frames: int = Field(
        default=60, ge=4, le=1000, description="frames; odd frames calibrate, even frames test (sec. 3.1)"
    )
    frame_rate_hz: float = Field(default=1.0, gt=0, le=1000, description="frames per second")
    runs: int = Field(default=100, ge=4, le=100000, description="Monte Carlo runs per point")
    noise_px: Annotated[tuple[Annotated[float, Field(gt=0, le=10)], ...], TWO] = Field(
        default=(0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5),
        description="noise of a star's position per axis (Fig. 3, Fig. 5)",
    )
    table_noise_px: float = Field(
        default=0.1, gt=0, le=10, description="noise of a star's position per axis (Fig. 4, Table 2)"
    )
    bias_deg_per_h: GyroSizes = Field(
        default=(0.001, 0.01, 0.1), description="bias values of Fig. 3a, without random walk"
    )
    angle_random_walk_deg_per_sqrt_h: GyroSizes = Field(
        default=(0.0001, 0.001, 0.01), description="random-walk values of Fig. 3b, without bias"
    )
    counts: Annotated[tuple[Annotated[int, Field(ge=2, le=200)], ...], TWO] = Field(
        default=(6, 10, 14, 20, 34, 60), description="star counts of the RMS curve (Fig. 4)"
    )
    sweep: SweepConfig = SweepConfig()
    workers: int = Field(
        default=0, ge=0, le=256, description="processes; 0: one per processor; the result does not depend on it"
    )

    @classmethod
    def of_sensor(cls, file: Path) -> dict[str, Any]:
        """Settings that a sensor file decides: the camera, by a fit, and where the adjustment starts, as far off as in
        ACF17.
        """
        from experiments.acf.sensor import camera_settings

        camera = camera_settings(InstrumentConfig.model_validate(read_sensor(file, SensorConfig).get("instrument", {})))
        off = AcfStartConfig().focal_length_mm / AcfCameraConfig().focal_length_mm
        return {"camera": camera, "start": {"focal_length_mm": off * camera["focal_length_mm"]}}

    def as_sensor(self, file: Path | None) -> SensorConfig | None:
        """The sensor file that the camera was fitted to; None for a camera that is only a model."""
        return None if file is None else parse_model(SensorConfig, read_sensor(file, SensorConfig), str(file))

    @model_validator(mode="after")
    def _enough(self) -> AcfConfig:
        if self.gyro.rate_hz < self.frame_rate_hz:
            raise ValueError(
                f"gyro.rate_hz = {self.gyro.rate_hz:g} Hz: at least frame_rate_hz = {self.frame_rate_hz:g} Hz is needed"
            )
        calibrating = (self.frames + 1) // 2
        for key, stars in (
            ("sky.stars_per_frame", self.sky.stars_per_frame),
            ("counts", float(self.counts[0])),
        ):
            equations = 2 * calibrating * stars
            if equations < 2 * UNKNOWNS:
                raise ValueError(
                    f"{key} = {stars:g}, frames = {self.frames}: {calibrating} frames calibrate and give "
                    f"{equations:g} equations for {UNKNOWNS} unknowns; at least {2 * UNKNOWNS} are needed: more stars "
                    "or more frames"
                )
        measured, unknowns = 2 * self.frames * self.sweep.stars[0], CAMERA_UNKNOWNS + 3 * self.frames
        if measured < unknowns + CAMERA_UNKNOWNS:
            raise ValueError(
                f"sweep.stars = {self.sweep.stars[0]}, frames = {self.frames}: {measured} measurements for {unknowns} "
                f"unknowns of camera and free attitudes; at least {unknowns + CAMERA_UNKNOWNS} are needed: more "
                "stars or more frames"
            )
        return self


experiment = Experiment(
    name="acf",
    config=AcfConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    takes="3 min (--quick: 20 s)",
    examples={
        "--quick": "a small run",
        "--set runs=20": "fewer runs",
        "--set camera.pixel_pitch_um=6.36 --set sky.stars_per_frame=21": "pixel pitch and stars implied by ACF17",
    },
    show=("table2", "fig4"),
    renders=lambda _: False,
    quick={
        "runs": 12,
        "noise_px": [0.05, 0.1, 0.5],
        "bias_deg_per_h": [0.001, 0.1],
        "angle_random_walk_deg_per_sqrt_h": [0.0001, 0.01],
        "counts": [10, 20, 40],
        "sweep.stars": [3, 6, 20],
        "sweep.gyro_factor": [0.0, 1.0, 10.0],
        "sweep.skies": 12,
    },
)
main = command(experiment)
