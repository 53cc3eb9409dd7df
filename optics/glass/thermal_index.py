r"""Thermal change of the refractive index (dn/dT) by SCHOTT's formula.

Change of the absolute index over a temperature step :math:`\Delta T` from the reference temperature (SCHOTT TIE-19,
*Temperature coefficient of the refractive index*):

.. math:: \Delta n_{abs}(\lambda, \Delta T) = \frac{n^2 - 1}{2 n} \left(D_0 \Delta T + D_1 \Delta T^2
          + D_2 \Delta T^3 + \frac{E_0 \Delta T + E_1 \Delta T^2}{\lambda^2 - \lambda_{TK}^2}\right)

`optics.glass.absolute_index` adds it to the index of the catalogue.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from optics.errors import DomainError

LARGE_STEP_K = 60.0
LARGEST_RESONANCE_UM = 1000.0
"""Bound on the mean resonance wavelength; catalogues state 0 to some tenths of a micrometre."""
LARGE_CHANGE = 0.1
"""Bound on the change of n^2 - 1 over `LARGE_STEP_K`; germanium, the largest of all, changes by 0.013."""


def thermal_change(wavelength_nm: Any, index: Any, volume: Any, strength: Any, resonance: Any) -> Any:
    """Change of the absolute index on any array type; numbers from `ThermalDispersion.terms`."""
    l2 = (wavelength_nm * 1e-3) * (wavelength_nm * 1e-3)
    return (index * index - 1.0) / (2.0 * index) * (volume + strength / (l2 - resonance))


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalDispersion:
    """Constants of SCHOTT's dn/dT formula."""

    D0: float  # [1/K], [1/K^2], [1/K^3]
    D1: float
    D2: float
    E0: float  # [um^2/K], [um^2/K^2]
    E1: float
    lambda_tk_um: float  # Mean resonance wavelength [um]
    range_c: tuple[float, float] = (-100.0, 140.0)  # Temperatures for which the maker states them [C]

    @staticmethod
    def of(constants: Sequence[float], range_c: tuple[float, float] = (-100.0, 140.0)) -> ThermalDispersion:
        """From D0, D1, D2, E0, E1, lambda_TK in the order of catalogues."""
        names = ("D0", "D1", "D2", "E0", "E1", "lambda_tk_um")
        return ThermalDispersion(**dict(zip(names, constants, strict=True)), range_c=range_c)

    @property
    def constants(self) -> tuple[float, ...]:
        """D0, D1, D2, E0, E1, lambda_TK."""
        return self.D0, self.D1, self.D2, self.E0, self.E1, self.lambda_tk_um

    def __post_init__(self) -> None:
        if not np.isfinite((*self.constants, *self.range_c)).all():
            raise DomainError(f"dn/dT constants {(*self.constants, *self.range_c)} hold a value that is not finite")
        if abs(self.lambda_tk_um) > LARGEST_RESONANCE_UM:
            raise DomainError(
                f"dn/dT constant lambda_TK = {self.lambda_tk_um:g} um; at most {LARGEST_RESONANCE_UM:g} um is allowed"
            )
        if max(abs(term) for kelvin in (-LARGE_STEP_K, LARGE_STEP_K) for term in self.terms(kelvin)[:2]) > LARGE_CHANGE:
            raise DomainError(
                f"dn/dT constants {self.constants} change n^2 - 1 by more than a tenth in {LARGE_STEP_K:g} K, which no "
                "glass does; they are [1/K], [1/K^2], [1/K^3], [um^2/K], [um^2/K^2], [um]"
            )

    def terms(self, kelvin: float) -> tuple[float, float, float]:
        """Terms of the formula for one temperature step: volume, resonance strength [um^2], resonance [um^2]."""
        volume = self.D0 * kelvin + self.D1 * kelvin**2 + self.D2 * kelvin**3
        return volume, self.E0 * kelvin + self.E1 * kelvin**2, self.lambda_tk_um**2
