"""Dark current against the temperature of the detector."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from optics.errors import DomainError

ZERO_C_K = 273.15


def dark_current_ratio(temperature_c: float, *, reference_c: float, doubling_c: float) -> float:
    """Dark current over that at a reference temperature, 2^((T - reference) / doubling), for -200 to 150 C."""
    if not -200.0 <= temperature_c <= 150.0:
        raise DomainError(f"temperature_c = {temperature_c:g} C; it must be -200 to 150 C")
    return float(2.0 ** ((temperature_c - reference_c) / doubling_c))


def tabulated_dark_current(curve_c: Sequence[float], current: Sequence[float], temperature_c: float) -> float:
    """Dark current [e-/s] of a table at increasing temperatures; ln I is linear in 1/T: one activation energy."""
    inverse = -1.0 / (np.asarray(curve_c) + ZERO_C_K)
    return float(np.exp(np.interp(-1.0 / (temperature_c + ZERO_C_K), inverse, np.log(current))))
