"""Temperature field of a lens over time: a table of states, and the first-order response to a forcing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.heated_lens import COMPONENTS
from optics.records import freeze


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThermalHistory:
    """Temperatures of lens and housing less those of its dimensions, at increasing times."""

    time_s: FloatArray  # (t,) Increasing
    values_k: FloatArray  # (t, 5) In the order of `optics.lens.heated_lens.COMPONENTS`

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "time_s", shape=("t",), sizes=sizes)
        freeze(self, "values_k", shape=("t", len(COMPONENTS)), sizes=sizes)

    def at(self, time_s: ArrayLike) -> FloatArray:
        """States (..., 5) [K], linear between the times; constant beyond the ends."""
        t = np.asarray(time_s, float)
        return np.stack([np.interp(t, self.time_s, column) for column in self.values_k.T], axis=-1)


def first_order_response(forcing: ArrayLike, *, step_s: float, constant_s: float) -> FloatArray:
    """Response (n,) of a body of one time constant, ``constant_s dy/dt = forcing - y``, from rest at zero.

    ``forcing`` (n,) at even steps holds over the step before its time, for which the response is exact.
    """
    if not (step_s > 0.0 and constant_s > 0.0):
        raise DomainError(f"step_s = {step_s:g}, constant_s = {constant_s:g} s; both must be positive")
    decay = float(np.exp(-step_s / constant_s))
    return np.asarray(lfilter([1.0 - decay], [1.0, -decay], np.asarray(forcing, float)))
