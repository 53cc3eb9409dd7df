"""Centre of gravity of the light above a threshold, as star trackers use it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calib.measure.centroid_error.s_curve import PhaseTable
from calib.measure.centroiders.centre_of_gravity import CentreOfGravity
from calib.measure.centroiding.moments import gravity_table, light_above_background
from calib.measure.centroiding.options import option
from calib.records import NoiseModel, Stamps, StarTable


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdedCentreOfGravity(CentreOfGravity):
    """Centre of gravity of what rises above a threshold: ``s = max(light - T, 0)``.

    The flux is that of the whole window, without threshold; the covariance takes the selection of pixels as fixed.
    """

    name: ClassVar[str] = "tcog"
    label: ClassVar[str] = "thresholded CoG"

    threshold_sigma: float = option(3.0, at_least=0)  # T in units of the noise of a pixel without star

    def measure_by(self, stamps: Stamps, noise: NoiseModel, table: PhaseTable | None) -> StarTable:
        light, used = light_above_background(stamps, self.half_width_px)
        sky = np.sqrt(noise.variance_e2(stamps.background_e))
        above = np.maximum(light - self.threshold_sigma * sky[:, None, None], 0.0) * used
        return gravity_table(stamps, noise, table, weight=above, light=light, used=used)
