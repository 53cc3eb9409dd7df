"""Centre of gravity of all light in a window, the centroid of the first star trackers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from calib.measure.centroid_error.s_curve import MomentCentroider, PhaseTable
from calib.measure.centroiding.moments import gravity_table, light_above_background
from calib.measure.centroiding.options import option
from calib.records import NoiseModel, Stamps, StarTable
from optics.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class CentreOfGravity(MomentCentroider):
    """Centre of gravity ``x = sum(s x) / sum(s)`` of the light s above the background."""

    name: ClassVar[str] = "cog"
    label: ClassVar[str] = "centre of gravity"
    needs_epsf: ClassVar[bool] = False

    # The sums run over ``2 half_width_px + 1`` rows and columns about the pixel nearest the start; None: all of them
    half_width_px: int | None = option(3, at_least=1, unit="px")

    def measure_by(self, stamps: Stamps, noise: NoiseModel, table: PhaseTable | None) -> StarTable:
        light, used = light_above_background(stamps, self.half_width_px)
        return gravity_table(stamps, noise, table, weight=light, light=light, used=used)

    def response(self, stamps: Stamps, noise: NoiseModel) -> FloatArray:
        """Derivatives (n, 2, h, w) [px/e-] of the position by the signal of each pixel: its lever over all light."""
        light, used = light_above_background(stamps, self.half_width_px)
        position_px = self.measure_by(stamps, noise, None).pixel_px
        column, row = (position_px - stamps.corner_px).T[:, :, None, None]
        rows, columns = np.indices(light.shape[1:])
        lever = np.stack([columns - column, rows - row], axis=1)
        total = light.sum((1, 2))[:, None, None, None]
        return np.asarray(used[:, None] * lever / np.where(total > 0.0, total, np.nan))
