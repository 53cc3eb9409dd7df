"""Centre of gravity of the light above a threshold, as star trackers use it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calib.measure.moments import gravity_table, light_above_background
from calib.measure.options import check_options, option
from calib.measure.pixel_phase import PhaseTable, measure_with_phase
from calib.records import NoiseModel, Stamps, StarTable


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdedCentreOfGravity:
    """Centre of gravity of what rises above a threshold: ``s = max(light - T, 0)``.

    The flux is that of the whole window, without threshold.
    """

    name: ClassVar[str] = "tcog"
    label: ClassVar[str] = "thresholded CoG"
    needs_epsf: ClassVar[bool] = False

    threshold_sigma: float = option(3.0, at_least=0)  # T in units of the noise of a pixel without star
    # As in `calib.measure.centroiders.centre_of_gravity.CentreOfGravity`
    half_width_px: int | None = option(3, at_least=1, unit="px")

    def __post_init__(self) -> None:
        check_options(self)

    def measure(self, stamps: Stamps, noise: NoiseModel) -> StarTable:
        """Position, flux of the window and covariance (selection of pixels taken as fixed) of every stamp."""
        return measure_with_phase(self, stamps, noise)

    def measure_by(self, stamps: Stamps, noise: NoiseModel, known: PhaseTable | None) -> StarTable:
        """The same, width and error by pixel phase from a table (`calib.measure.pixel_phase`)."""
        light, used = light_above_background(stamps, self.half_width_px)
        sky = np.sqrt(noise.variance_e2(stamps.background_e))
        above = np.maximum(light - self.threshold_sigma * sky[:, None, None], 0.0) * used
        return gravity_table(stamps, noise, known, weight=above, light=light, used=used)
