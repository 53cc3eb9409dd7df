"""Settings and declaration of datasets of star frames; the commands ``dataset`` and ``dataset check``."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal

import click
from pydantic import Field, field_validator, model_validator

from experiments.harness.cli import command
from experiments.harness.config import AngleDeg
from experiments.harness.experiment import Experiment
from experiments.harness.interrupts import EXIT_FAILED, EXIT_GOOD, interrupts
from experiments.laboratory.bench.centroid_methods import CentroiderName
from experiments.laboratory.settings.sensor_file import SensorExperimentConfig
from optics.settings import FileName, StrictModel
from render.sensor_file.stray import ContaminationConfig, ScatterConfig
from render.sensor_file.tables import CatalogueConfig, InstrumentConfig, PassbandConfig

DeclinationDeg = Annotated[float, Field(ge=-90, le=90)]
RateDegPerS = Annotated[float, Field(ge=-360, le=360)]
SpectralDensity = Annotated[float, Field(ge=0, le=1e12)]
Vector = tuple[RateDegPerS, RateDegPerS, RateDegPerS]
SunExclusionDeg = Annotated[
    float,
    Field(
        ge=0,
        le=120,
        description="smallest angle between boresight and Sun as seen from the Earth; attitudes nearer are drawn anew",
    ),
]
RandomRollDeg = Annotated[
    float | None, Field(ge=-360, le=360, description="position angle of up in the image; default: random")
]


class SkyPointing(StrictModel):
    """Attitudes uniform over all rotations."""

    kind: Literal["sky"] = "sky"
    sun_exclusion_deg: SunExclusionDeg = 0.0


class ConePointing(StrictModel):
    """Boresights uniform over a cone."""

    kind: Literal["cone"] = "cone"
    ra_deg: float = Field(default=83.8, ge=0, le=360, description="right ascension of the cone's axis")
    dec_deg: float = Field(default=0.0, ge=-90, le=90, description="declination of the axis")
    radius_deg: float = Field(default=10.0, ge=0, le=180, description="half angle of the cone")
    roll_deg: RandomRollDeg = None
    sun_exclusion_deg: SunExclusionDeg = 0.0


class BodyPointing(StrictModel):
    """A field with the Moon or a planet, seen from the Earth, at a random place within a circle about the boresight."""

    kind: Literal["body"] = "body"
    body: Literal["moon", "mercury", "venus", "mars", "jupiter", "saturn", "uranus", "neptune"] = Field(
        default="moon", description="name of the body"
    )
    offset_deg: float = Field(default=2.0, ge=0, le=60, description="largest angle between body and boresight")
    roll_deg: RandomRollDeg = None


class ListPointing(StrictModel):
    """Attitudes from a file: frame k has row k."""

    kind: Literal["list"] = "list"
    file: FileName = Field(
        default="", description="CSV or ECSV with ra_deg, dec_deg, roll_deg or quat_x, quat_y, quat_z, quat_w"
    )


class ScanPointing(StrictModel):
    """Frames of a turning camera at a constant frame rate."""

    kind: Literal["scan"] = "scan"
    file: FileName = Field(
        default="", description="CSV or ECSV with time_s and quaternions; default: a constant rate from ra, dec, roll"
    )
    ra_deg: float = Field(default=83.8, ge=0, le=360, description="right ascension of the boresight at the start")
    dec_deg: float = Field(default=0.0, ge=-90, le=90, description="declination of the boresight at the start")
    roll_deg: float = Field(default=0.0, ge=-360, le=360, description="position angle of up in the image at the start")
    rate_deg_per_s: Vector = Field(default=(0.0, 0.5, 0.0), description="angular velocity in camera axes")
    frame_rate_hz: float = Field(default=1.0, gt=0, le=1e4, description="frames per second")


class FixedRate(StrictModel):
    """The same angular velocity in every frame."""

    kind: Literal["fixed"] = "fixed"
    rate_deg_per_s: Vector = Field(default=(0.0, 0.0, 0.0), description="angular velocity in camera axes")


class RandomRate(StrictModel):
    """An independent angular velocity in every frame, its axis uniform over the sphere."""

    kind: Literal["random"] = "random"
    distribution: Literal["uniform", "log_uniform"] = Field(
        default="uniform", description="distribution of the magnitude"
    )
    lowest_deg_per_s: float = Field(default=0.0, ge=0, le=360, description="smallest magnitude")
    highest_deg_per_s: float = Field(default=0.5, ge=0, le=360, description="largest magnitude")

    @model_validator(mode="after")
    def _ordered(self) -> RandomRate:
        if self.highest_deg_per_s < self.lowest_deg_per_s:
            raise ValueError("highest_deg_per_s is below lowest_deg_per_s")
        if self.distribution == "log_uniform" and not self.lowest_deg_per_s > 0:
            raise ValueError("log_uniform needs lowest_deg_per_s above 0")
        return self


class JitterSpectrumConfig(StrictModel):
    """Random motion about the camera's axes, as one-sided power spectra; power laws between the frequencies."""

    frequency_hz: tuple[Annotated[float, Field(gt=0, le=1e6)], ...] = Field(
        default=(), description="frequencies, at least two, increasing; empty: no jitter"
    )
    psd_x_arcsec2_per_hz: tuple[SpectralDensity, ...] = Field(
        default=(), description="power spectral density about x at these frequencies; empty: at rest"
    )
    psd_y_arcsec2_per_hz: tuple[SpectralDensity, ...] = Field(default=(), description="power spectral density about y")
    psd_z_arcsec2_per_hz: tuple[SpectralDensity, ...] = Field(
        default=(), description="power spectral density about the boresight"
    )

    @model_validator(mode="after")
    def _as_many(self) -> JitterSpectrumConfig:
        frequencies = self.frequency_hz
        if len(frequencies) == 1 or any(b <= a for a, b in pairwise(frequencies)):
            raise ValueError(f"frequency_hz = {list(frequencies)}: at least two, increasing, are needed, or none")
        if frequencies and not any(getattr(self, f"psd_{axis}_arcsec2_per_hz") for axis in "xyz"):
            raise ValueError(f"frequency_hz = {list(frequencies)}: psd_x_arcsec2_per_hz, _y or _z is needed with it")
        for axis in "xyz":
            count = len(getattr(self, f"psd_{axis}_arcsec2_per_hz"))
            if count not in (0, len(self.frequency_hz)):
                raise ValueError(
                    f"psd_{axis}_arcsec2_per_hz has {count} values for {len(self.frequency_hz)} frequencies"
                )
        return self


Pointing = SkyPointing | ConePointing | BodyPointing | ListPointing | ScanPointing
Rate = FixedRate | RandomRate


class BackgroundConfig(StrictModel):
    """Light other than stars."""

    dimensionless: ClassVar[frozenset[str]] = frozenset({"uniform_mag_per_arcsec2"})

    extra_e_per_s: float = Field(default=2.0, ge=0, le=1e6, description="uniform background per pixel")
    zodiacal: bool = Field(default=False, description="zodiacal light seen from the Earth, vignetted by the lens")
    uniform_mag_per_arcsec2: float | None = Field(
        default=None,
        ge=0,
        le=40,
        description="V surface brightness of a uniform sky, vignetted by the lens; default: none",
    )
    moon_planets: bool = Field(
        default=False, description="Moon and planets at their positions; needs catalogue.observer = earth"
    )
    stray_light: FileName = Field(
        default="",
        description="point-source transmittance (pst.ecsv of straylight): adds uniform stray light of Sun and "
        "Moon, and of the Earth if earth_distance_km is set; needs catalogue.observer = earth",
    )
    ghosts: bool = Field(
        default=False,
        description="ghosts of stars inside and outside the frame, of Moon and planets, and of Sun and Moon by a "
        "table of stray_light with the cause ghosts",
    )
    earth_direction_deg: tuple[AngleDeg, DeclinationDeg] = Field(
        default=(0.0, 0.0), description="right ascension and declination of the Earth's centre"
    )
    earth_distance_km: float | None = Field(
        default=None,
        ge=6500,
        le=1e7,
        description="distance of the Earth's centre, with moon_planets; default: no Earth",
    )


class RadiationConfig(StrictModel):
    """Radiation effects in the detector."""

    dimensionless: ClassVar[frozenset[str]] = frozenset({"depleted_volume_um3"})

    environment: Literal["none", "deep_space_solar_minimum", "deep_space_solar_maximum", "solar_flare", "leo_quiet"] = (
        Field(default="none", description="cosmic rays")
    )
    depth_um: float = Field(default=10.0, ge=1, le=500, description="thickness of the sensitive silicon")
    displacement_dose_tev_per_g: float = Field(
        default=0.0, ge=0, le=1e6, description="displacement damage dose, which creates hot pixels"
    )
    depleted_volume_um3: float = Field(default=30.0, gt=0, le=1e5, description="depleted volume of a pixel")


class SplitsConfig(StrictModel):
    """Training, validation and test frames; adding frames never changes the split of existing frames."""

    by: Literal["auto", "sky", "arc", "frame"] = Field(
        default="auto",
        description="sky: regions of the sky separated by gaps; arc: arcs of a scan; frame: at random; auto: "
        "sky for random attitudes, and for cones and lists if the gaps leave half of the frames, "
        "arc for scans, otherwise frame",
    )
    gap_deg: float | None = Field(
        default=None,
        ge=0,
        le=180,
        description="smallest angle between boresights of two splits; default: the field's diagonal",
    )

    train_fraction: float = Field(default=0.8, ge=0, le=1, description="fraction of frames for training")
    validation_fraction: float = Field(default=0.1, ge=0, le=1, description="fraction of frames for validation")
    test_fraction: float = Field(default=0.1, ge=0, le=1, description="fraction of frames for the final test")

    @model_validator(mode="after")
    def _whole(self) -> SplitsConfig:
        total = self.train_fraction + self.validation_fraction + self.test_fraction
        if abs(total - 1.0) > 1e-9:
            raise ValueError(f"train, validation and test add up to {total:g}; they must add up to 1")
        return self


class FilesConfig(StrictModel):
    """How frames and truth are stored."""

    truth: Literal["parquet", "ecsv"] = Field(default="parquet", description="format of truth and index")
    compression: Literal["none", "rice", "gzip"] = Field(
        default="none", description="lossless tile compression of the frames"
    )
    mask: Literal["always", "saturated", "never"] = Field(
        default="saturated", description="which frames get a mask of saturated and defective pixels"
    )
    layers: bool = Field(
        default=False, description="expected electrons by source (stars, ghosts, sky ...), 4 bytes per pixel each"
    )


class CardConfig(StrictModel):
    """Entries of the data card, COCO and Croissant; frames do not depend on them."""

    title: str = Field(default="Star frames with exact truth", description="name of the dataset")
    version: str = Field(default="1.0.0", description="version of the dataset")
    licence: str = Field(
        default="",
        pattern=r"^[A-Za-z0-9.+-]{0,100}$",
        description="SPDX identifier such as CC-BY-4.0 (letters, digits, '.', '+', '-'); default: the catalogue's",
    )
    citation: str = Field(default="", description="citation; default: starbench and the star catalogue")


class VerifyConfig(StrictModel):
    """Evaluation of the frames: stars measured, attitudes solved blind, world coordinates checked."""

    frames: int = Field(default=200, ge=0, le=10_000_000, description="number of frames evaluated, from the first")
    dark_frames: int = Field(default=20, ge=1, le=1000, description="dark frames averaged")


class DatasetConfig(SensorExperimentConfig):
    """Two hundred frames of the real sky in random attitudes."""

    frames: int = Field(
        default=200, ge=1, le=10_000_000, description="total number of frames; a larger number extends the dataset"
    )
    instrument: InstrumentConfig = InstrumentConfig(
        lens="star_tracker_26mm", detector="cmv4000", width_px=1024, height_px=1024, exposure_s=0.2
    )
    passband: PassbandConfig = PassbandConfig()
    nodes: int = Field(default=6, ge=2, le=64, description="number of wavelengths that sample the pass band")
    pupil_tolerance: float = Field(
        default=1e-4,
        ge=1e-7,
        le=1e-2,
        description="largest error of a pixel by the pupil quadrature, relative to the star's light",
    )
    catalogue: CatalogueConfig = CatalogueConfig()
    compared: tuple[str, ...] = Field(
        default=(), description="agreement with frames of the real sensor, from a sensor file"
    )
    centroid: CentroiderName = Field(default="epsf", description="centroider")
    window_px: int = Field(default=7, ge=5, le=63, description="side of the centroid window, odd")
    threshold_sigma: float = Field(
        default=5.0, gt=0, le=1000, description="detection threshold, in standard deviations of the filtered noise"
    )
    pointing: Pointing = Field(default=SkyPointing(), discriminator="kind", description="distribution of attitudes")
    rate: Rate = Field(default=FixedRate(), discriminator="kind", description="rotation during the exposure")
    jitter: JitterSpectrumConfig = JitterSpectrumConfig()
    background: BackgroundConfig = BackgroundConfig()
    scatter: ScatterConfig = ScatterConfig()
    contamination: ContaminationConfig = ContaminationConfig()
    radiation: RadiationConfig = RadiationConfig()
    splits: SplitsConfig = SplitsConfig()
    files: FilesConfig = FilesConfig()
    exports: tuple[Literal["coco", "webdataset"], ...] = Field(
        default=(), description="exports for machine learning: coco, webdataset"
    )
    png_bits: Literal[8, 16] = Field(
        default=16, description="bits of COCO images; 16: raw DN, 8: stretched for display"
    )
    card: CardConfig = CardConfig()
    verify: VerifyConfig = VerifyConfig()
    calibration_frames: int = Field(
        default=20, ge=0, le=1000, description="frames averaged in each of bias, dark and flat; 0 or 1: none"
    )
    workers: int = Field(default=0, ge=0, le=4096, description="processes; 0: one per processor; 1: no extra process")
    scheduler: str = Field(default="", description="Dask scheduler such as tcp://host:8786; default: this machine")

    @model_validator(mode="before")
    @classmethod
    def _seen_from_the_earth(cls, values: Any) -> Any:
        """Settings that a body in the field implies: an observer on the Earth, and its light."""
        pointing = values.get("pointing") if isinstance(values, Mapping) else None
        kind = pointing.get("kind") if isinstance(pointing, Mapping) else getattr(pointing, "kind", None)
        if kind != "body":
            return values
        implied: dict[str, dict[str, Any]] = {"catalogue": {"observer": "earth"}, "background": {"moon_planets": True}}
        tables: dict[str, Any] = {}
        for name, settings in implied.items():
            given = values.get(name, {})
            table = given.model_dump() if isinstance(given, StrictModel) else given
            tables[name] = {**table, **settings} if isinstance(table, Mapping) else table  # refused by the field
        return {**values, **tables}

    @field_validator("window_px")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError(f"{value} px is even; a window has a middle pixel: 5, 7, 9 ... 63")
        return value

    @field_validator("exports")
    @classmethod
    def _once(cls, values: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(values)) != len(values):
            raise ValueError("an export is named twice")
        return values


experiment = Experiment(
    name="dataset",
    config=DatasetConfig,
    run="experiment:run",
    sections="experiment:SECTIONS",
    files="experiment:files",
    output="remote:dataset_at",
    takes="50 s (--quick: 12 s)",
    examples={
        "--frames 1000 --out sky": "the real sky, 1024 x 1024 px, random attitudes; the same command resumes",
        "--frames 5000 --workers 8 --out sky": "extend it, in eight processes",
        "check sky": "read every file; list damaged and missing files",
        "--sensor my.toml --set 'exports=[\"coco\"]'": "your own sensor, with a COCO export",
    },
    options={
        "frames": ("frames", "Frames in all."),
        "workers": ("workers", "Processes; 0: one per processor."),
        "scheduler": ("scheduler", "Address of a Dask scheduler."),
    },
    quick={"frames": 10, "instrument.width_px": 512, "instrument.height_px": 512},
)
main = command(experiment)


@main.command(help="Read every file of a dataset and list damaged and missing files.")
@click.argument("folder", metavar="FOLDER_OR_URL")
def check(folder: str) -> int:
    """0 if every file is as it was written, 1 if not."""
    interrupts.at_once, interrupts.message = False, lambda: "interrupted; nothing was changed"
    checked = experiment.part("remote:check_at")(folder)
    click.echo("\n".join(checked.lines()))
    return EXIT_FAILED if checked.damaged or checked.missing else EXIT_GOOD
