"""The sensor file: one description of a star sensor that the library and every experiment take."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from optics.errors import ConfigError, StarbenchError
from optics.settings import StrictModel, read_settings
from optics.validate import parse_model, read_toml
from render.sensor_file.lens_defaults import lens_defaults
from render.sensor_file.requirements import RequirementsConfig
from render.sensor_file.stray import BaffleConfig, ContaminationConfig, ScatterConfig
from render.sensor_file.tables import CatalogueConfig, FilterConfig, InstrumentConfig, PassbandConfig


class ManufactureConfig(StrictModel):
    """Manufacturing tolerances (standard deviations), from which `camera` draws and traces lenses.

    Elements are named as in the lens file; a tolerance of 0 is exact.
    """

    dimensionless: ClassVar[frozenset[str]] = frozenset({"index"})

    lenses: int = Field(default=0, ge=0, le=100_000, description="number of lenses drawn")
    distribution: Literal["normal", "uniform"] = Field(
        default="normal", description="uniform: within sqrt(3) times the tolerance"
    )
    decentre_um: float = Field(default=10.0, ge=0, le=1000, description="decentre of every element per axis")
    tilt_arcmin: float = Field(default=0.5, ge=0, le=60, description="tilt of every element per axis")
    wedge_arcmin: float = Field(
        default=0.3, ge=0, le=60, description="wedge of every glass element: tilt of its last surface"
    )
    thickness_um: float = Field(
        default=10.0, ge=0, le=1000, description="thickness of every element; all surfaces behind move with it"
    )
    radius_percent: float = Field(default=0.05, ge=0, le=10, description="radius of every curved surface")
    index: float = Field(
        default=1e-4, ge=0, le=0.1, description="refractive index of every glass, the same error at all wavelengths"
    )
    focus_um: float = Field(
        default=5.0, ge=0, le=1000, description="position of the detector along the axis, after focusing"
    )
    refocused: bool = Field(default=True, description="every lens is focused individually (compensator)")


class TimingConfig(StrictModel):
    """Times from the end of an exposure to the attitude."""

    readout_s: float = Field(default=0.0, ge=0, le=1000, description="read-out of a frame")
    processing_s: float = Field(default=0.0, ge=0, le=1000, description="processing of a frame to its attitude")
    overlapped: bool = Field(default=True, description="exposure, read-out and processing of successive frames overlap")

    def period_s(self, exposure_s: float) -> float:
        """Time from one frame to the next [s]."""
        steps = exposure_s, self.readout_s, self.processing_s
        return max(steps) if self.overlapped else sum(steps)


class LifeConfig(StrictModel):
    """Degradation at the end of life, linear in age; `camera` predicts the performance up to then."""

    dimensionless: ClassVar[frozenset[str]] = frozenset(
        {"years", "displacement_dose_tev_per_g", "depleted_volume_um3", "darkened_glass", "contamination"}
    )

    years: float = Field(default=0.0, ge=0, le=100, description="age at the end of life; 0: not predicted")
    displacement_dose_tev_per_g: float = Field(
        default=0.0, ge=0, le=1e5, description="displacement damage dose behind the shield [TeV/g]"
    )
    depleted_volume_um3: float | None = Field(
        default=None, gt=0, le=1e5, description="depleted volume of a pixel, required with a displacement dose [um3]"
    )
    ionising_dark_e_per_s: float = Field(
        default=0.0, ge=0, le=1e7, description="dark current added by the ionising dose, at dark_reference_c"
    )
    darkened_glass: float = Field(default=0.0, ge=0, lt=1, description="fraction of the light lost in darkened glass")
    contamination: float = Field(
        default=0.0, ge=0, lt=1, description="fraction of the light lost by films and particles"
    )

    @model_validator(mode="after")
    def _volume(self) -> LifeConfig:
        if self.displacement_dose_tev_per_g and self.depleted_volume_um3 is None:
            raise ValueError("depleted_volume_um3 is needed with displacement_dose_tev_per_g: area of a pixel x depth")
        return self


class SensorFile(StrictModel):
    """A star sensor: hardware, operation, star catalogue, processing and requirements."""

    name: str = Field(default="", description="name of the sensor in reports; default: lens and detector")
    centroid: str = Field(default="epsf", description="centroider")
    window_px: int = Field(default=13, ge=5, le=63, description="side of the centroid window, odd")
    threshold_sigma: float = Field(
        default=5.0, gt=0, le=1000, description="detection threshold, in standard deviations of the filtered noise"
    )
    compared: tuple[str, ...] = Field(
        default=(), description="agreement of rendered with real frames: lines of text, copied to a dataset's data card"
    )
    instrument: InstrumentConfig = InstrumentConfig()
    passband: PassbandConfig = PassbandConfig()
    filters: FilterConfig = FilterConfig()
    catalogue: CatalogueConfig = CatalogueConfig()
    requirements: RequirementsConfig = RequirementsConfig()
    manufacture: ManufactureConfig = ManufactureConfig()
    baffle: BaffleConfig = BaffleConfig()
    scatter: ScatterConfig = ScatterConfig()
    contamination: ContaminationConfig = ContaminationConfig()
    timing: TimingConfig = TimingConfig()
    life: LifeConfig = LifeConfig()

    @field_validator("window_px")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError(f"{value} px is even; a window has a middle pixel: 5, 7, 9 ... 63")
        return value


def in_best_focus(instrument: InstrumentConfig, passband: PassbandConfig) -> InstrumentConfig:
    """The settings with the number that ``defocus_mm = "best"`` stands for; 0 for a lens that cannot be traced."""
    if instrument.defocus_mm != "best":
        return instrument
    from render.sensor_file.instrument import best_defocus_mm

    try:
        defocus_mm = best_defocus_mm(instrument, passband)
    except StarbenchError:  # raised again where the lens is needed
        defocus_mm = 0.0
    return instrument.model_copy(update={"defocus_mm": defocus_mm})


def read_sensor(file: str | Path, model: type[SensorFile] = SensorFile) -> dict[str, Any]:
    """Validated contents of a sensor file, without missing keys; relative paths are taken from its folder.

    `ConfigError` names the key, its value and the allowed range, or a lens or detector file given in its place.
    """
    from optics.files.read import FOREIGN

    path = str(file)
    table = read_toml(file) if path.lower().endswith(".toml") else {}
    lens = path.lower().endswith(FOREIGN) or "surface" in table or table.get("kind") == "measured"
    if lens or "pixel_pitch_um" in table:
        kind = "lens" if lens else "detector"
        raise ConfigError(
            f"{path} is a {kind} file where a sensor file is needed; name it in one: "
            f'[instrument] {kind} = "{Path(file).name}"'
        )
    given = read_settings(model, file)
    parse_model(model, given, path)
    return given


def complete_sensor(file: str | Path, model: type[SensorFile] = SensorFile) -> dict[str, Any]:
    """As `read_sensor`, all tables whole, with what its lens file implies and the defaults of the model."""
    given = read_sensor(file, model)
    tables = {key: value for key, value in model.model_validate(given).model_dump().items() if isinstance(value, dict)}
    implied = lens_defaults(tables)
    for key, value in implied.items():
        tables[key] = {**tables[key], **value, **given.get(key, {})}
    return {**given, **tables}
