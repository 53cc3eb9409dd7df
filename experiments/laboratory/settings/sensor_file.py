"""Settings of an experiment on a star sensor: it takes the keys of a sensor file (``--sensor my.toml``)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import Field, PrivateAttr, model_validator

from experiments.harness.config import ExperimentConfig
from experiments.laboratory.bench.centroid_methods import CentroiderName
from optics.errors import ConfigError, StarbenchError
from optics.validate import parse_model, read_toml
from render.sensor_file.file import SensorFile, complete_sensor, in_best_focus, read_sensor
from render.sensor_file.lens_defaults import lens_defaults, lens_remarks
from render.sensor_file.tables import InstrumentConfig, PassbandConfig


class SensorConfig(SensorFile):
    """A star sensor: hardware, operation, star catalogue, processing and requirements."""

    centroid: CentroiderName = Field(default="epsf", description="centroider")


class SensorExperimentConfig(ExperimentConfig):
    """Base of the configuration of an experiment on a star sensor: it reads its keys from a sensor file."""

    _focused_mm: float | None = PrivateAttr(default=None)  # Best focus, where ``defocus_mm = "best"``

    @classmethod
    def of_sensor(cls, file: Path) -> dict[str, Any]:
        """Settings of this experiment from a sensor file.

        A key that a table of the file omits has the default of `SensorConfig`, the same in every experiment. Settings
        of the processing that the file omits have the defaults of the experiment.
        """
        for key in read_toml(file) if file.suffix == ".toml" else ():
            if key in cls.model_fields and key not in SensorConfig.model_fields:
                raise ConfigError(f"{file.name}: {key} is a setting of a run: give it by --set or --config")
        return {key: value for key, value in complete_sensor(file, SensorConfig).items() if key in cls.model_fields}

    @model_validator(mode="after")
    def _best_focus(self) -> Self:
        """``defocus_mm = "best"`` becomes the number, for the pass band of this configuration."""
        instrument, passband = getattr(self, "instrument", None), getattr(self, "passband", None)
        if instrument is not None and instrument.defocus_mm == "best":
            focused = in_best_focus(instrument, passband or PassbandConfig())
            object.__setattr__(self, "instrument", focused)
            self._focused_mm = float(focused.defocus_mm)
        return self

    @classmethod
    def implied(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """Further settings in the lens file of the instrument (`lens_defaults`)."""
        return lens_defaults(values, getattr(cls(), "instrument", InstrumentConfig()).lens)

    def remarks(self) -> tuple[str, ...]:
        """Settings taken from the lens file of the instrument, and detector values that are not from its data sheet."""
        instrument, passband = getattr(self, "instrument", None), getattr(self, "passband", None)
        focus = self._focused_mm
        focused = () if focus is None else (f"In focus for the pass band: instrument.defocus_mm = {focus:g} mm.",)
        hardware = () if instrument is None else (*lens_remarks(instrument, passband), *detector_remarks(instrument))
        return (*focused, *hardware)

    def notes(self) -> tuple[str, ...]:
        """Remarks on a detector from a file of the user, for the terminal."""
        from render.detector.spec import list_detectors

        instrument = getattr(self, "instrument", None)
        if instrument is None or instrument.detector in list_detectors():
            return ()
        return detector_remarks(instrument)

    def as_sensor(self, file: Path | None) -> SensorConfig | None:
        """The sensor file of this configuration; parameters as of `ExperimentConfig.as_sensor`."""
        of_file = {} if file is None else read_sensor(file, SensorConfig)
        configured = {key: value for key, value in self.model_dump().items() if key in SensorConfig.model_fields}
        return parse_model(SensorConfig, {**of_file, **configured}, "sensor file")


def detector_remarks(instrument: InstrumentConfig) -> tuple[str, ...]:
    """Keys of the detector that came from a base, a default or an assumption; a converter that ends early."""
    from render.sensor_file.instrument import configured_detector

    try:
        return configured_detector(instrument).remarks()
    except StarbenchError:  # the reader of the detector raises it again
        return ()
