"""The sensor file: one description of a star sensor that every experiment takes (``--sensor my.toml``)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr, field_validator, model_validator

from experiments.harness.config import ExperimentConfig, StrictModel, read_settings
from experiments.laboratory.bench.centroid_methods import CentroiderName
from experiments.laboratory.settings.lens_defaults import lens_defaults, lens_remarks
from experiments.laboratory.settings.requirements import RequirementsConfig
from experiments.laboratory.settings.stray import BaffleConfig, ContaminationConfig, ScatterConfig
from experiments.laboratory.settings.tables import CatalogueConfig, FilterConfig, InstrumentConfig, PassbandConfig
from optics.errors import ConfigError, StarbenchError
from optics.validate import parse_model


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


class SensorConfig(StrictModel):
    """A star sensor: hardware, operation, star catalogue, processing and requirements."""

    name: str = Field(default="", description="name of the sensor in reports; default: lens and detector")
    centroid: CentroiderName = Field(default="epsf", description="centroider")
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
    from experiments.laboratory.devices.instrument import best_defocus_mm

    try:
        found = best_defocus_mm(instrument, passband)
    except StarbenchError:  # said where the lens is needed
        found = 0.0
    return instrument.model_copy(update={"defocus_mm": found})


class SensorExperimentConfig(ExperimentConfig):
    """Base of the configuration of an experiment on a star sensor: it takes the keys of a sensor file that it has."""

    _focused_mm: float | None = PrivateAttr(default=None)  # Where the best focus was asked for

    @classmethod
    def of_sensor(cls, file: Path) -> dict[str, Any]:
        """Settings of this experiment that a sensor file decides.

        The tables of the file are whole: a key that is left out in them has the default of `SensorConfig`, the same in
        every experiment. Settings of the processing that the file lacks are the experiment's defaults.
        """
        for key in read_settings(SensorConfig, file):
            if key in cls.model_fields and key not in SensorConfig.model_fields:
                raise ConfigError(f"{file.name}: {key} is a setting of a run: give it by --set or --config")
        return {key: value for key, value in whole_sensor(file).items() if key in cls.model_fields}

    @model_validator(mode="after")
    def _best_focus(self) -> Self:
        """``defocus_mm = "best"`` becomes the number, for the pass band of this configuration."""
        instrument, passband = getattr(self, "instrument", None), getattr(self, "passband", None)
        if instrument is not None and instrument.defocus_mm == "best":
            from experiments.laboratory.devices.instrument import stated_defocus_mm

            focused = in_best_focus(instrument, passband or PassbandConfig())
            object.__setattr__(self, "instrument", focused)
            self._focused_mm = stated_defocus_mm(focused)
        return self

    @classmethod
    def implied(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """Further settings in the lens file of the instrument (`lens_defaults`)."""
        return lens_defaults(values, getattr(cls(), "instrument", InstrumentConfig()).lens)

    def remarks(self) -> tuple[str, ...]:
        """Settings taken from the lens file of the instrument, and detector values that are not from its data sheet."""
        instrument, passband = getattr(self, "instrument", None), getattr(self, "passband", None)
        focus = self._focused_mm
        words = () if focus is None else (f"In focus for the pass band: instrument.defocus_mm = {focus:g} mm.",)
        told = () if instrument is None else (*lens_remarks(instrument, passband), *detector_remarks(instrument))
        return (*words, *told)

    def notes(self) -> tuple[str, ...]:
        """The same of a detector that is the user's own file, for the terminal."""
        from render.detector.spec import list_detectors

        instrument = getattr(self, "instrument", None)
        if instrument is None or instrument.detector in list_detectors():
            return ()
        return detector_remarks(instrument)

    def as_sensor(self, file: Path | None) -> SensorConfig | None:
        """The sensor file of this configuration; parameters as of `ExperimentConfig.as_sensor`."""
        known = SensorConfig.model_fields
        given = {} if file is None else read_sensor(file)
        own = {key: value for key, value in self.model_dump().items() if key in known}
        return parse_model(SensorConfig, {**given, **own}, "sensor file")


def detector_remarks(instrument: InstrumentConfig) -> tuple[str, ...]:
    """Keys of the detector that came from a base, a default or an assumption; a converter that ends early."""
    from experiments.laboratory.devices.instrument import configured_detector

    try:
        return configured_detector(instrument).remarks()
    except StarbenchError:  # what cannot be read is told where it is needed
        return ()


def read_sensor(file: Path) -> dict[str, Any]:
    """Validated contents of a sensor file, without missing keys. Paths are taken from its folder."""
    given = read_settings(SensorConfig, file)
    parse_model(SensorConfig, given, str(file))
    return given


def whole_sensor(file: Path) -> dict[str, Any]:
    """As `read_sensor`, all tables whole, with what its lens file implies and the defaults of `SensorConfig`."""
    given = read_sensor(file)
    tables = {
        key: value for key, value in SensorConfig.model_validate(given).model_dump().items() if isinstance(value, dict)
    }
    implied = lens_defaults(tables)
    for key, value in implied.items():
        tables[key] = {**tables[key], **value, **given.get(key, {})}
    return {**given, **tables}
