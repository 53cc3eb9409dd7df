"""What a run of the camera report gave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from experiments.camera.confirmation import Comparison, compare
from experiments.camera.records import CameraPrediction, Scalar
from experiments.camera.rendered import Rendered
from experiments.camera.settings import Config
from experiments.camera.thermal import ThermalStudy
from experiments.camera.tornado import Swing
from experiments.camera.verdicts import Verdict, judge, verdict_words

__all__ = ["Result", "thermal_scalars"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Everything."""

    config: Config  # The sensor
    prediction: CameraPrediction  # As configured
    thermal: ThermalStudy  # Over temperature
    swings: tuple[Swing, ...]  # Sensitivities, the largest first
    rendered: Rendered | None  # Frames; None where prediction alone was asked for

    @property
    def scalars(self) -> Mapping[str, Scalar]:
        """Of the prediction, and over temperature."""
        return {**self.prediction.scalars, **thermal_scalars(self.thermal)}

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """On the requirements."""
        return judge(self.config.requirements, self.scalars)

    @property
    def answer(self) -> str:
        """What the verdicts come to, in a sentence."""
        return verdict_words(self.verdicts)

    @property
    def catalogue_ends(self) -> bool:
        """Whether the sensor finds stars that the catalogue does not hold."""
        return self.prediction.catalogue_ends

    @property
    def compared(self) -> tuple[Comparison, ...]:
        """Frames beside the prediction; empty without frames."""
        return () if self.rendered is None else compare(self.prediction, self.rendered)

    @property
    def name(self) -> str:
        """What to call the sensor."""
        instrument = self.prediction.state.instrument
        return self.config.name or f"{instrument.camera.lens.name} on {instrument.detector.name}"


def thermal_scalars(study: ThermalStudy) -> dict[str, Scalar]:
    """Largest changes over the temperatures; NaN for a lens without thermal data."""
    known = len(study.temperature_c) > 0
    nothing = float("nan")
    return {
        "focus_shift_um": Scalar(
            value=study.focus_shift_um, unit="um", label="Change of the best focus over temperature", format=".1f"
        ),
        "spot_thermal_px": Scalar(
            value=float(study.spot_px.max()) if known else nothing,
            unit="px",
            label="Spot radius (RMS), largest over temperature",
            format=".3f",
        ),
        "scale_change_ppm": Scalar(
            value=float(np.abs(study.scale_ppm).max()) if known else nothing,
            unit="ppm",
            label="Change of the plate scale over temperature",
            format=".1f",
        ),
    }
