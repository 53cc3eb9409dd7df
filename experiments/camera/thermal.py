"""The sensor from its coldest to its hottest: focus, scale, spot and accuracy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.camera.prediction import predict_camera
from experiments.camera.records import CameraPrediction
from experiments.camera.settings import Config
from experiments.harness.range import with_value
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens_file import load_lens
from optics.records import freeze

__all__ = ["ThermalStudy", "thermal_study"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalStudy:
    """t temperatures of lens and housing."""

    temperature_c: FloatArray  # (t,) Temperatures
    focus_um: FloatArray  # (t,) Best focus from the detector
    scale_ppm: FloatArray  # (t,) Change of the plate scale against the prescription's temperature
    spot_px: FloatArray  # (t,) RMS radius of the white spot, largest over the field, with the detector where it is
    colour_px: FloatArray  # (t,) Largest separation of wavelengths over the field
    nea_arcsec: FloatArray  # (t,) Of the star that is quoted; NaN where it saturates
    attitude_arcsec: FloatArray  # (t,) Across the boresight, median over the sky; infinite where too few stars are seen
    refusal: str = ""  # Why there is nothing; "" where there is

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in _COLUMNS:
            freeze(self, name, shape=("t",), sizes=sizes, finite=name not in {"nea_arcsec", "attitude_arcsec"})

    @property
    def focus_shift_um(self) -> float:
        """Largest change of the best focus between two temperatures of the range."""
        return float(np.ptp(self.focus_um)) if len(self.focus_um) else float("nan")


_COLUMNS = ("temperature_c", "focus_um", "scale_ppm", "spot_px", "colour_px", "nea_arcsec", "attitude_arcsec")


def thermal_study(config: Config) -> ThermalStudy:
    """Predict the sensor at all temperatures; a lens without thermal data is said to have none."""
    setting = config.thermal
    reference_c = load_lens(config.instrument.lens).environment.temperature_c
    rows: list[tuple[float, ...]] = []
    try:
        scale = _at(config, reference_c).state.performance.plate_scale_mm
        for kelvin in np.linspace(setting.lowest_c, setting.highest_c, setting.points):
            found = _at(config, float(kelvin))
            rows.append(
                (
                    float(kelvin),
                    found.value("best_focus_um"),
                    1e6 * (found.state.performance.plate_scale_mm / scale - 1.0),
                    found.value("spot_px"),
                    found.value("lateral_colour_px"),
                    found.value("nea_arcsec"),
                    found.value("attitude_cross_arcsec"),
                )
            )
    except DomainError as error:
        nothing: dict[str, Any] = dict.fromkeys(_COLUMNS, np.empty(0))
        return ThermalStudy(**nothing, refusal=str(error).splitlines()[0])
    columns: dict[str, Any] = dict(zip(_COLUMNS, np.array(rows).T, strict=True))
    return ThermalStudy(**columns)


def _at(config: Config, temperature_c: float) -> CameraPrediction:
    return predict_camera(with_value(config, "instrument.lens_temperature_c", temperature_c))
