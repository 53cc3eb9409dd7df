"""Settings and declaration of the flight: orbit, attitude law, temperatures, aberration, stray light, tracker."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.laboratory.settings.sensor_file import SensorConfig, SensorExperimentConfig
from optics.settings import FileName, StrictModel
from render.sensor_file.detector import DetectorConfig
from render.sensor_file.file import LifeConfig


class OrbitConfig(StrictModel):
    """Kepler's orbit about the Earth, axes of icrs, without drifts; or two-line elements, from their epoch on."""

    dimensionless: ClassVar[frozenset[str]] = frozenset({"eccentricity"})

    perigee_km: float = Field(default=600.0, ge=100, le=400_000, description="lowest altitude above 6378.137 km")
    eccentricity: float = Field(default=0.0, ge=0, lt=0.95, description="eccentricity")
    inclination_deg: float = Field(default=97.8, ge=0, le=180, description="inclination to the equator")
    node_deg: float = Field(default=250.0, ge=-360, le=360, description="right ascension of the ascending node")
    perigee_deg: float = Field(default=0.0, ge=-360, le=360, description="argument of the perigee")
    anomaly_deg: float = Field(default=0.0, ge=-360, le=360, description="mean anomaly at time 0")
    tle: tuple[()] | tuple[str, str] = Field(
        default=(), description="two-line elements in place of the keys above; SGP4 propagates them from their epoch"
    )

    @property
    def kepler(self) -> dict[str, float]:
        """The elements by name."""
        return self.model_dump(exclude={"tle"})


class AttitudeLawConfig(StrictModel):
    """Attitude law."""

    law: Literal["inertial", "turn", "nadir", "table"] = Field(
        default="turn",
        description="inertial: at rest; turn: at a constant rate; nadir: fixed to the local vertical; table: a file",
    )
    ra_deg: float = Field(
        default=135.0, ge=-360, le=360, description="inertial, turn: right ascension of the boresight at time 0"
    )
    dec_deg: float = Field(default=-15.0, ge=-90, le=90, description="inertial, turn: declination")
    roll_deg: float = Field(
        default=0.0, ge=-360, le=360, description="inertial, turn: position angle of up in the image"
    )
    rate_deg_per_s: float = Field(default=0.01, ge=0, le=5, description="turn: rate, across the line of sight")
    direction_deg: float = Field(
        default=20.0, ge=-360, le=360, description="turn: direction of the star trails, from column towards row"
    )
    off_zenith_deg: float = Field(
        default=30.0,
        ge=0,
        le=180,
        description="nadir: angle of the boresight from the zenith, towards the orbit's pole",
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
    """Random motion in addition to the law, with a flat spectrum about each axis."""

    rms_arcsec: float = Field(default=0.0, ge=0, le=1000, description="RMS about each axis")
    lowest_hz: float = Field(default=0.1, gt=0, le=1000, description="lower limit of the spectrum")
    highest_hz: float = Field(default=5.0, gt=0, le=1000, description="upper limit of the spectrum")

    @model_validator(mode="after")
    def _range(self) -> JitterConfig:
        if self.lowest_hz >= self.highest_hz:
            raise ValueError(f"lowest_hz = {self.lowest_hz:g} is not below highest_hz = {self.highest_hz:g}")
        return self


class TemperatureConfig(StrictModel):
    """Temperature of lens and housing minus that of the calibration: offset, first harmonics of the orbit, eclipse."""

    offset_k: float = Field(default=0.5, ge=-60, le=60, description="offset, mean over the orbit")
    mean_k: float = Field(default=1.0, ge=0, le=60, description="uniform temperature: amplitude of the first harmonic")
    axial_k: float = Field(default=0.0, ge=0, le=20, description="gradient from front to detector: amplitude")
    transverse_k: float = Field(default=0.0, ge=0, le=20, description="transverse gradient along columns: amplitude")
    radial_k: float = Field(default=0.0, ge=0, le=20, description="gradient of the elements, centre to edge: amplitude")
    phase_deg: float = Field(default=40.0, ge=-360, le=360, description="phase of the harmonics at time 0")
    eclipse_k: float = Field(default=-0.5, ge=-60, le=60, description="uniform temperature: step in the Earth's shadow")
    eclipse_time_s: float = Field(default=600.0, gt=0, le=1e5, description="time constant of the step")
    file: FileName = Field(
        default="", description="CSV with time_s, mean_k and any of axial_k, transverse_x_k, transverse_y_k, radial_k"
    )


class AberrationConfig(StrictModel):
    """Correction of aberration by the tracker."""

    corrected: Literal["all", "earth", "none"] = Field(
        default="all", description="earth: the Earth's motion only, not the orbit's; none: no correction"
    )
    velocity_error_m_per_s: float = Field(
        default=20.0, ge=-1e4, le=1e4, description="error of the tracker's velocity, along the orbit (corrected = all)"
    )


class ExclusionConfig(StrictModel):
    """Background light, and exclusion angles inside which there is no attitude."""

    sun_file: FileName = Field(
        default="", description="light of the Sun: CSV with angle_deg, e_per_px_s; default: none"
    )
    earth_file: FileName = Field(
        default="", description="light of the sunlit Earth by angle to its limb: CSV as for the Sun"
    )
    moon_file: FileName = Field(default="", description="light of the Moon: CSV as for the Sun")
    sun_exclusion_deg: float = Field(default=35.0, ge=0, le=180, description="exclusion angle of the Sun")
    earth_exclusion_deg: float = Field(default=10.0, ge=0, le=90, description="exclusion angle of the Earth's limb")
    moon_exclusion_deg: float = Field(default=0.0, ge=0, le=180, description="exclusion angle of the Moon")


Alignment = Annotated[float, Field(ge=-36000, le=36000)]


class TrackerConfig(StrictModel):
    """Settings of the tracker."""

    faintest_mag: float | None = Field(
        default=None,
        ge=-2,
        le=20,
        description="faintest guide star; default: limiting magnitude (half detected) minus 1.5",
    )
    fewest: int = Field(default=4, ge=3, le=100, description="fewest stars for an attitude")
    most: int = Field(default=30, ge=3, le=1000, description="most stars tracked")
    gate_px: float = Field(
        default=2.0,
        gt=0,
        le=50,
        description="largest distance of a star from its predicted place after the common shift",
    )
    alignment_arcsec: tuple[Alignment, Alignment, Alignment] = Field(
        default=(0.01, -0.005, 0.2), description="ground alignment error about x, y, roll"
    )
    wrong_sigma: float = Field(
        default=20.0, gt=3, le=1e4, description="error, in sigma, above which an attitude is counted as wrong"
    )

    @model_validator(mode="after")
    def _stars(self) -> TrackerConfig:
        if self.fewest > self.most:
            raise ValueError(f"fewest = {self.fewest} is above most = {self.most}")
        return self


Environment = Literal["none", "deep_space_solar_minimum", "deep_space_solar_maximum", "solar_flare", "leo_quiet"]


class FlightFramesConfig(StrictModel):
    """Rendered parts of the orbit."""

    segments: int = Field(default=12, ge=2, le=500, description="number of segments, evenly spaced over the orbit")
    frames: int = Field(default=14, ge=3, le=1000, description="frames per segment, each read out twice")
    rate_hz: float = Field(default=5.0, gt=0, le=100, description="frames per second")
    switched: int = Field(
        default=6, ge=1, le=100, description="frames per segment also rendered with the lens as calibrated"
    )
    thermal_states: int = Field(
        default=4,
        ge=1,
        le=500,
        description="number of traced thermal states; segments of similar temperature share their mean",
    )
    psf_grid: int = Field(default=9, ge=3, le=33, description="PSFs of the tracker's grid along the longer side")
    planets: bool = Field(default=True, description="planets rendered as points, false stars to the tracker")
    cosmic_rays: Environment = Field(default="none", description="cosmic rays in every readout, 10 um of silicon")
    end_of_life: bool = Field(default=False, description="render the sensor at the end of life")


class FlightConfig(SensorExperimentConfig, SensorConfig):
    """Sensor file and flight; defaults: the built-in 206 mm star camera in a low Earth orbit."""

    detector: DetectorConfig = DetectorConfig()
    orbit: OrbitConfig = OrbitConfig()
    attitude: AttitudeLawConfig = AttitudeLawConfig()
    jitter: JitterConfig = JitterConfig()
    temperature: TemperatureConfig = TemperatureConfig()
    aberration: AberrationConfig = AberrationConfig()
    straylight: ExclusionConfig = ExclusionConfig()
    tracker: TrackerConfig = TrackerConfig()
    frames: FlightFramesConfig = FlightFramesConfig()
    life: LifeConfig = LifeConfig(
        years=10.0, darkened_glass=0.1, displacement_dose_tev_per_g=50.0, depleted_volume_um3=60.0
    )
    star_temperature_k: float = Field(
        default=5800.0, ge=1000, le=60000, description="star temperature for which camera model and PSFs are calibrated"
    )
    rates_deg_per_s: tuple[Annotated[float, Field(ge=0, le=100)], ...] = Field(
        default=(0.0, 0.02, 0.05), max_length=20, description="turn rates of the predicted curve; empty: none"
    )
    dark_frames: int = Field(default=20, ge=2, le=1000, description="dark frames averaged and subtracted")
    predict_only: bool = Field(default=False, description="predict only, without rendered frames")

    @model_validator(mode="after")
    def _possible(self) -> FlightConfig:
        if self.frames.end_of_life and not self.life.years:
            raise ValueError("frames.end_of_life needs life.years above 0")
        if self.instrument.line_time_us:
            raise ValueError("instrument.line_time_us: the flight is predicted for a global shutter; set it to 0")
        return self


experiment = Experiment(
    name="flight",
    config=FlightConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    axes="experiment:axes",
    takes="90 s (--quick: 40 s)",
    examples={
        "--quick": "a small run",
        "--sensor my.toml": "your own sensor",
        "--sensor my.toml --predict-only": "the prediction without frames",
        "--set attitude.law=nadir": "attitude fixed to the local vertical",
        "--set aberration.corrected=earth": "the motion about the Earth is not corrected",
    },
    show=("terms",),
    options={"predict-only": ("predict_only", "Predict only, without rendered frames.")},
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
