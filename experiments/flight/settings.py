"""Settings and declaration of the flight: orbit, attitude law, temperatures, aberration, stray light, tracker."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from experiments.harness.cli import command
from experiments.harness.config import StrictModel
from experiments.harness.experiment import Experiment
from experiments.laboratory.detector_changes import DetectorConfig
from experiments.laboratory.sensor_file import LifeConfig, SensorConfig, SensorExperimentConfig
from experiments.laboratory.settings import FileName


class OrbitConfig(StrictModel):
    """Kepler's orbit about the Earth, axes of icrs, without drifts; or two-line elements, from their epoch on."""

    dimensionless: ClassVar[frozenset[str]] = frozenset({"eccentricity"})

    perigee_km: float = Field(default=600.0, ge=100, le=400_000, description="lowest altitude above 6378.137 km")
    eccentricity: float = Field(default=0.0, ge=0, lt=0.95, description="shape")
    inclination_deg: float = Field(default=97.8, ge=0, le=180, description="to the equator")
    node_deg: float = Field(default=250.0, ge=-360, le=360, description="right ascension of the ascending node")
    perigee_deg: float = Field(default=0.0, ge=-360, le=360, description="argument of the perigee")
    anomaly_deg: float = Field(default=0.0, ge=-360, le=360, description="mean anomaly at time 0")
    tle: tuple[()] | tuple[str, str] = Field(
        default=(), description="two-line elements, in place of all above: propagated by SGP4, epoch theirs"
    )


class AttitudeLawConfig(StrictModel):
    """Where the camera looks, and how it turns."""

    law: Literal["inertial", "turn", "nadir", "table"] = Field(
        default="turn",
        description="inertial: at rest; turn: at a constant rate; nadir: fixed to the local vertical; table: a file",
    )
    ra_deg: float = Field(default=135.0, ge=-360, le=360, description="boresight at time 0 (inertial, turn)")
    dec_deg: float = Field(default=-15.0, ge=-90, le=90, description="the same")
    roll_deg: float = Field(default=0.0, ge=-360, le=360, description="the same")
    rate_deg_per_s: float = Field(default=0.01, ge=0, le=5, description="turn: rate, across the line of sight")
    direction_deg: float = Field(
        default=20.0, ge=-360, le=360, description="turn: where stars trail to on the detector, from columns to rows"
    )
    off_zenith_deg: float = Field(
        default=30.0, ge=0, le=180, description="nadir: boresight from the zenith, towards the pole of the orbit"
    )
    file: FileName = Field(
        default="", description="table: CSV with time_s, qx, qy, qz, qw (cam from icrs, scalar last), over the orbit"
    )

    @model_validator(mode="after")
    def _file(self) -> AttitudeLawConfig:
        if (self.law == "table") != bool(self.file):
            raise ValueError('attitude.file and attitude.law = "table": give both, or neither')
        return self


class JitterConfig(StrictModel):
    """Random motion of the line of sight about the law: a flat spectrum about each axis."""

    rms_arcsec: float = Field(default=0.0, ge=0, le=1000, description="about each axis; 0: none")
    lowest_hz: float = Field(default=0.1, gt=0, le=1000, description="spectrum from")
    highest_hz: float = Field(default=5.0, gt=0, le=1000, description="spectrum to")

    @model_validator(mode="after")
    def _range(self) -> JitterConfig:
        if self.lowest_hz >= self.highest_hz:
            raise ValueError(f"lowest_hz = {self.lowest_hz:g} is not below highest_hz = {self.highest_hz:g}")
        return self


class TemperatureConfig(StrictModel):
    """Lens and housing against the temperature of the calibration: offset, first harmonics of the orbit, eclipse."""

    offset_k: float = Field(default=0.5, ge=-60, le=60, description="mean over the orbit")
    mean_k: float = Field(default=1.0, ge=0, le=60, description="uniform: amplitude of the first harmonic")
    axial_k: float = Field(default=0.0, ge=0, le=20, description="front to detector: amplitude")
    transverse_k: float = Field(default=0.0, ge=0, le=20, description="across, along columns: amplitude")
    radial_k: float = Field(default=0.0, ge=0, le=20, description="elements, middle to edge: amplitude")
    phase_deg: float = Field(default=40.0, ge=-360, le=360, description="of the harmonics at time 0")
    eclipse_k: float = Field(default=-0.5, ge=-60, le=60, description="uniform: step in the shadow of the Earth")
    eclipse_time_s: float = Field(default=600.0, gt=0, le=1e5, description="time constant of that step")
    file: FileName = Field(
        default="", description="CSV with time_s, mean_k and any of axial_k, transverse_x_k, transverse_y_k, radial_k"
    )


class AberrationConfig(StrictModel):
    """What the tracker knows of its velocity."""

    corrected: Literal["all", "earth", "none"] = Field(
        default="all", description="earth: the motion about the Earth is left out; none: no aberration is corrected"
    )
    velocity_error_m_per_s: float = Field(
        default=20.0, ge=-1e4, le=1e4, description="error of the known velocity, along the orbit (all)"
    )


class StraylightConfig(StrictModel):
    """Background light, and angles from the boresight within which the sensor is blind."""

    sun_file: FileName = Field(default="", description="CSV with angle_deg, e_per_px_s; left out: none")
    earth_file: FileName = Field(default="", description="the same for the lit Earth, angle to its limb")
    moon_file: FileName = Field(default="", description="the same for the Moon")
    sun_exclusion_deg: float = Field(default=35.0, ge=0, le=180, description="nearer to the Sun: no attitude")
    earth_exclusion_deg: float = Field(default=10.0, ge=0, le=90, description="nearer to the Earth's limb")
    moon_exclusion_deg: float = Field(default=0.0, ge=0, le=180, description="nearer to the Moon")


Alignment = Annotated[float, Field(ge=-36000, le=36000)]


class TrackerConfig(StrictModel):
    """How the tracker works."""

    faintest_mag: float | None = Field(
        default=None, ge=-2, le=20, description="guide stars; left out: 1.5 mag brighter than half are found"
    )
    fewest: int = Field(default=4, ge=3, le=100, description="stars that an attitude needs")
    most: int = Field(default=30, ge=3, le=1000, description="stars that are tracked at most")
    gate_px: float = Field(default=2.0, gt=0, le=50, description="from its place after the common shift")
    alignment_arcsec: tuple[Alignment, Alignment, Alignment] = Field(
        default=(0.01, -0.005, 0.2), description="error of the alignment on ground, about x, y, roll"
    )
    wrong_sigma: float = Field(default=20.0, gt=3, le=1e4, description="an error beyond so many sigma is wrong")

    @model_validator(mode="after")
    def _stars(self) -> TrackerConfig:
        if self.fewest > self.most:
            raise ValueError(f"fewest = {self.fewest} is above most = {self.most}")
        return self


Environment = Literal["none", "deep_space_solar_minimum", "deep_space_solar_maximum", "solar_flare", "leo_quiet"]


class FramesConfig(StrictModel):
    """Which part of the orbit is rendered."""

    segments: int = Field(default=12, ge=2, le=500, description="parts of the orbit, evenly apart")
    frames: int = Field(default=14, ge=3, le=1000, description="frames of a segment, each read out twice")
    rate_hz: float = Field(default=5.0, gt=0, le=100, description="frames per second")
    switched: int = Field(default=6, ge=1, le=100, description="frames of a segment rendered with the lens as built")
    thermal_states: int = Field(
        default=4, ge=1, le=500, description="lenses traced hot and cold: segments of like temperature share the mean"
    )
    psf_grid: int = Field(default=9, ge=3, le=33, description="PSFs of the tracker along the longer side")
    planets: bool = Field(default=True, description="planets shine as points of light, false stars to the tracker")
    cosmic_rays: Environment = Field(default="none", description="tracks in every readout, 10 um of silicon")
    end_of_life: bool = Field(default=False, description="frames of the sensor at the end of its life")


class Config(SensorExperimentConfig, SensorConfig):
    """A sensor file, and its flight; the defaults are the built-in 206 mm star camera in a low orbit."""

    detector: DetectorConfig = DetectorConfig()
    orbit: OrbitConfig = OrbitConfig()
    attitude: AttitudeLawConfig = AttitudeLawConfig()
    jitter: JitterConfig = JitterConfig()
    temperature: TemperatureConfig = TemperatureConfig()
    aberration: AberrationConfig = AberrationConfig()
    straylight: StraylightConfig = StraylightConfig()
    tracker: TrackerConfig = TrackerConfig()
    frames: FramesConfig = FramesConfig()
    life: LifeConfig = LifeConfig(
        years=10.0, darkened_glass=0.1, displacement_dose_tev_per_g=50.0, depleted_volume_um3=60.0
    )
    star_temperature_k: float = Field(
        default=5800.0, ge=1000, le=60000, description="colour that camera model and PSFs are calibrated with"
    )
    rates_deg_per_s: tuple[Annotated[float, Field(ge=0, le=100)], ...] = Field(
        default=(0.0, 0.02, 0.05), max_length=20, description="rates that the same stars are predicted for; none: []"
    )
    dark_frames: int = Field(default=20, ge=2, le=1000, description="frames without light in the subtracted mean")
    predict_only: bool = Field(default=False, description="no rendered frames: the prediction alone")

    @model_validator(mode="after")
    def _possible(self) -> Config:
        if self.frames.end_of_life and not self.life.years:
            raise ValueError("frames.end_of_life needs life.years and what changes in them")
        if self.instrument.line_time_us:
            raise ValueError("instrument.line_time_us: the flight is predicted for a global shutter; set it to 0")
        return self


experiment = Experiment(
    name="flight",
    config=Config,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    takes="90 s (--quick: 40 s)",
    examples={
        "--quick": "a small run",
        "--sensor my.toml": "your own sensor",
        "--sensor my.toml --predict-only": "the prediction without frames",
        "--set attitude.law=nadir": "fixed to the local vertical",
        "--set aberration.corrected=earth": "the motion about the Earth is not corrected",
    },
    show=("terms",),
    options={"predict-only": ("predict_only", "No rendered frames: the prediction alone.")},
    renders=lambda config: not config.predict_only,
    quick={
        "frames.segments": 6,
        "frames.frames": 8,
        "frames.switched": 4,
        "frames.thermal_states": 1,
        "dark_frames": 8,
        "rates_deg_per_s": [0.0],
    },
)
main = command(experiment)
