"""Brightness control of the target's source."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = ["BrightnessControl"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BrightnessControl:
    """Sets how many electrons a target point gives per frame."""

    lowest_e: float  # Reach of the control
    highest_e: float  # Reach of the control
    # Standard deviation of the level reached over the level wanted, anew at every setting; the level then stands
    setting_error_ratio: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.lowest_e <= self.highest_e < np.inf:
            raise DomainError(
                f"BrightnessControl: {self.lowest_e:g} ... {self.highest_e:g} e-; it must be positive and increase"
            )
        if not 0.0 <= self.setting_error_ratio < 0.3:
            raise DomainError(
                f"BrightnessControl.setting_error_ratio = {self.setting_error_ratio:g}; it must be 0 to 0.3"
            )

    def levels_e(self, count: int) -> FloatArray:
        """Levels (count,), evenly spaced in the logarithm over the reach."""
        if count < 1:
            raise DomainError(f"levels = {count}; at least 1 is needed")
        return np.asarray(np.geomspace(self.lowest_e, self.highest_e, count))

    def reached_e(self, wanted_e: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Levels that the source really gives."""
        return np.asarray(wanted_e * np.exp(self.setting_error_ratio * rng.standard_normal(np.shape(wanted_e))))
