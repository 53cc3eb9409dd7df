"""Settings and declaration of the calibration on rendered frames of a moving sky."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from experiments.harness.cli import command
from experiments.harness.config import AngleDeg, OddPx
from experiments.harness.experiment import Experiment
from experiments.laboratory.bench.centroid_methods import CentroiderName
from experiments.laboratory.settings.sensor_file import SensorConfig, SensorExperimentConfig
from optics.settings import StrictModel
from render.sensor_file.file import complete_sensor, in_best_focus
from render.sensor_file.lens_defaults import lens_remarks
from render.sensor_file.tables import InstrumentConfig, PassbandConfig

FEWEST_FRAMES = 4
CAMERAS = ("narrow", "wide", "own")
"""Tables of settings that describe a camera."""


def parse_model_name(name: str) -> tuple[str, int]:
    """Family and degree of a camera model: ``"brown_conrady"``, ``"pinhole"`` or ``"polynomial_5"``."""
    if name in ("brown_conrady", "pinhole"):
        return name, 0
    match = re.fullmatch(r"polynomial_([1-9])", name)
    if not match:
        raise ValueError(f"{name!r}: a camera model is 'pinhole', 'brown_conrady' or 'polynomial_1' to 'polynomial_9'")
    return "polynomial", int(match.group(1))


def model_label(name: str) -> str:
    """Name of a camera model for readers."""
    family, degree = parse_model_name(name)
    return {"pinhole": "pinhole", "brown_conrady": "Brown–Conrady"}.get(family, f"polynomial, degree {degree}")


class SkycalCameraConfig(StrictModel):
    """A camera and its stars."""

    instrument: InstrumentConfig = InstrumentConfig()
    faintest_mag: float = Field(default=9.0, ge=0, le=10, description="faintest stars rendered, Gaia G")
    background_e_per_s: float = Field(default=2.0, ge=0, le=1e5, description="sky light per pixel")
    sobol_log2_rays: int = Field(
        default=13, ge=8, le=20, description="log2 of the rays per star for pupils that are sampled by Sobol points"
    )
    psf_spacing_px: float = Field(default=256.0, gt=8, le=1e5, description="distance between rendered PSFs")
    model: str = Field(default="brown_conrady", description="main camera model, one of models")
    models: tuple[str, ...] = Field(
        default=("pinhole", "polynomial_3", "brown_conrady", "polynomial_5", "polynomial_7"),
        min_length=1,
        description="camera models compared: pinhole, brown_conrady, polynomial_1 to polynomial_9",
    )

    @field_validator("models")
    @classmethod
    def _known(cls, values: tuple[str, ...]) -> tuple[str, ...]:
        for value in values:
            parse_model_name(value)
        if len(set(values)) != len(values):
            raise ValueError("a camera model is given twice")
        return values

    @model_validator(mode="after")
    def _among_them(self) -> SkycalCameraConfig:
        if self.model not in self.models:
            raise ValueError(f"model = {self.model!r} is none of models = {list(self.models)}")
        return self


class SkycalSkyConfig(StrictModel):
    """First boresight and light of the sky."""

    ra_deg: float = Field(default=260.0, ge=0, le=360, description="right ascension of the first boresight")
    dec_deg: float = Field(default=30.0, ge=-89, le=89, description="declination of the first boresight")
    nodes: int = Field(default=12, ge=4, le=64, description="number of wavelengths that sample the pass band")
    reference_k: float = Field(
        default=4800.0, ge=1000, le=1e5, description="star colour that the map, the PSF and the truth refer to"
    )


class SkycalMotionConfig(StrictModel):
    """Motion of the camera, and accuracy of its a priori attitude."""

    rate_deg_per_s: float = Field(default=0.5, gt=0, le=20, description="angular speed")
    axis_deg: float = Field(
        default=60.0, ge=0, le=90, description="angle of the axis of rotation from the boresight; 90: no roll"
    )
    frame_rate_hz: float = Field(default=1.0, gt=0, le=1000, description="frames per second")
    attitude_error_arcmin: float = Field(
        default=3.0, ge=0, le=60, description="standard deviation per axis of the a priori attitude"
    )


class SkycalGyroConfig(StrictModel):
    """The gyro of ACF17, Table 1."""

    rate_hz: float = Field(default=100.0, gt=0, le=10000, description="samples per second")
    bias_deg_per_h: float = Field(default=0.03, ge=0, le=1000, description="magnitude of the bias per axis")
    angle_random_walk_deg_per_sqrt_h: float = Field(
        default=0.005, ge=0, le=100, description="angle random walk per axis"
    )
    installation_deg: tuple[AngleDeg, AngleDeg, AngleDeg] = Field(
        default=(2.0, 2.0, 2.0), description="theta1, theta2, theta3: camera from gyro, angles as in ACF17 eq. 2"
    )


class SkycalStartConfig(StrictModel):
    """Start values of the calibration and of the first star matching."""

    focal_ratio: float = Field(
        default=0.78125, gt=0.3, lt=3, description="start value of the focal length / true focal length"
    )
    sheet_error_fraction: float = Field(
        default=0.003, ge=-0.1, le=0.1, description="error of the focal length assumed by the first matching"
    )


class SkycalConfig(SensorExperimentConfig):
    """Sixty frames through the 206 mm lens and through a wide one."""

    SENSOR_KEYS: ClassVar[Mapping[str, str]] = {
        "instrument": "own.instrument",
        "catalogue.faintest_mag": "own.faintest_mag",
    }

    which: Literal["both", "narrow", "wide", "own"] = Field(
        default="both", description="cameras; own: from a sensor file"
    )
    narrow: SkycalCameraConfig = SkycalCameraConfig(faintest_mag=9.5, background_e_per_s=2.0)
    wide: SkycalCameraConfig = SkycalCameraConfig(
        instrument=InstrumentConfig(
            lens="star_tracker_26mm", detector="cmv4000", width_px=1862, height_px=1862, defocus_mm=0.010
        ),
        faintest_mag=6.5,
        background_e_per_s=6.0,
        psf_spacing_px=140.0,
    )
    own: SkycalCameraConfig = SkycalCameraConfig(faintest_mag=8.0)
    passband: PassbandConfig = PassbandConfig()
    sky: SkycalSkyConfig = SkycalSkyConfig()
    motion: SkycalMotionConfig = SkycalMotionConfig()
    gyro: SkycalGyroConfig = SkycalGyroConfig()
    start: SkycalStartConfig = SkycalStartConfig()
    frames: int = Field(default=60, ge=FEWEST_FRAMES, le=10000, description="frames per camera")
    dark_frames: int = Field(default=20, ge=1, le=1000, description="dark frames, averaged and subtracted")
    centroid: CentroiderName = Field(
        default="epsf", description="centroider; epsf: PSF of the reference colour at each field position"
    )
    window_px: OddPx = Field(default=13, ge=7, le=63, description="side of the centroid window, odd")
    threshold_sigma: float = Field(
        default=6.0, gt=0, le=1000, description="detection threshold, in standard deviations of the filtered noise"
    )
    least_snr: float = Field(
        default=15.0, gt=0, le=1e5, description="smallest signal-to-noise ratio of a star in the calibration"
    )
    map_points: int = Field(default=25, ge=5, le=101, description="points of the map along the longer side")

    @model_validator(mode="after")
    def _turns(self) -> SkycalConfig:
        total = self.motion.rate_deg_per_s * (self.frames - 1) / self.motion.frame_rate_hz
        if not math.isfinite(total) or total > 3600.0:
            raise ValueError(
                f"motion.rate_deg_per_s = {self.motion.rate_deg_per_s:g}, frames = {self.frames}: the camera turns by "
                f"{total:.0f} deg; at most 3600 deg (ten revolutions) are possible"
            )
        if self.gyro.rate_hz < self.motion.frame_rate_hz:
            raise ValueError(
                f"gyro.rate_hz = {self.gyro.rate_hz:g} Hz: at least motion.frame_rate_hz = "
                f"{self.motion.frame_rate_hz:g} Hz is needed"
            )
        return self

    @model_validator(mode="after")
    def _best_focus_of_all(self) -> Self:
        for name in ("own", "narrow", "wide"):
            camera = getattr(self, name)
            instrument = in_best_focus(camera.instrument, self.passband)
            if instrument is not camera.instrument:
                object.__setattr__(self, name, camera.model_copy(update={"instrument": instrument}))
        return self

    @classmethod
    def of_sensor(cls, file: Path) -> dict[str, Any]:
        """Settings that a sensor file decides: the camera ``own``, which then is the one that runs."""
        given = complete_sensor(file, SensorConfig)
        own = {"instrument": given["instrument"], "faintest_mag": given["catalogue"]["faintest_mag"]}
        shared = {key: value for key, value in given.items() if key in cls.model_fields}
        return {**shared, "which": "own", "own": own}

    @classmethod
    def implied(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """Further settings in the lens file of the camera ``own``, where that camera runs."""
        if values.get("which") != "own" or not isinstance(values.get("own"), Mapping):
            return {}
        implied = super().implied({**values, "instrument": values["own"].get("instrument")})
        own = {"own": {"instrument": implied.pop("instrument")}} if "instrument" in implied else {}
        return {**implied, **own}

    def remarks(self) -> tuple[str, ...]:
        """Settings taken from the lens file of the camera ``own``."""
        return lens_remarks(self.own.instrument, self.passband) if self.which == "own" else ()

    def as_sensor(self, file: Path | None) -> SensorConfig | None:
        """The sensor file of the first camera that runs; parameters as of `ExperimentConfig.as_sensor`."""
        camera = next(iter(self.cameras.values()))
        sensor = super().as_sensor(file)
        if sensor is None:
            return None
        catalogue = sensor.catalogue.model_copy(update={"faintest_mag": camera.faintest_mag})
        return sensor.model_copy(update={"instrument": camera.instrument, "catalogue": catalogue})

    @property
    def cameras(self) -> dict[str, SkycalCameraConfig]:
        """The cameras that are run, by name."""
        return {name: getattr(self, name) for name in (("narrow", "wide") if self.which == "both" else (self.which,))}


experiment = Experiment(
    name="skycal",
    config=SkycalConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    takes="3 min (--quick: 1 min)",
    examples={
        "--quick": "six frames, fewer stars",
        "--set which=wide --set frames=20": "the wide lens alone, 20 frames",
        "--set centroid=gaussian": "another centroider",
    },
    show=("methods", "parts"),
    files="experiment:files",
    quick={
        "frames": 6,
        "dark_frames": 5,
        "motion.rate_deg_per_s": 3.0,
        "map_points": 13,
        "narrow.faintest_mag": 8.7,
        "narrow.psf_spacing_px": 400.0,
        "narrow.models": ["pinhole", "brown_conrady", "polynomial_3"],
        "wide.faintest_mag": 6.2,
        "wide.psf_spacing_px": 170.0,
        "wide.models": ["pinhole", "brown_conrady", "polynomial_5"],
    },
)
main = command(experiment)
