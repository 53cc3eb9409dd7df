r"""Refractive index along the ray path, on any array library.

Catalogue indices are relative to air at 20 C and 1013.25 hPa. A ray sees absolute indices:

.. math:: n_{abs}(\lambda, T) = n_{rel}(\lambda) \, n_{air}(\lambda, 20\,C, 1013.25\,hPa) + \Delta n_{abs}(\lambda, T - 20\,C) + \delta

with the Sellmeier formula for :math:`n_{rel}`, Kohlrausch's formula for air (SCHOTT TIE-19, 2016), SCHOTT's dn/dT
formula for :math:`\Delta n_{abs}`, and :math:`\delta` a perturbation (melt tolerance).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from optics.arrays import ArrayNamespace
from optics.errors import DomainError
from optics.glass import Glass

__all__ = ["CATALOGUE_AIR", "VACUUM", "Environment", "IndexFormula", "air_refractivity"]

REFERENCE_TEMPERATURE_C = 20.0
REFERENCE_PRESSURE_HPA = 1013.25


@dataclass(frozen=True, slots=True, kw_only=True)
class Environment:
    """Surroundings of the lens.

    Attributes
    ----------
    temperature_c : float
        Temperature of glass and air.
    pressure_hpa : float
        Air pressure; 0 is vacuum.
    """

    temperature_c: float = REFERENCE_TEMPERATURE_C
    pressure_hpa: float = REFERENCE_PRESSURE_HPA

    def __post_init__(self) -> None:
        if not -100.0 <= self.temperature_c <= 140.0:
            raise DomainError(
                f"temperature {self.temperature_c} C is outside -100 ... 140 C, the range of the catalogues' dn/dT"
            )
        if not 0.0 <= self.pressure_hpa <= 2000.0:
            raise DomainError(f"air pressure {self.pressure_hpa} hPa is outside 0 ... 2000 hPa")

    @property
    def air_factor(self) -> float:
        """Density of the air relative to 15 C and 1013.25 hPa (Kohlrausch)."""
        return self.pressure_hpa / REFERENCE_PRESSURE_HPA / (1.0 + (self.temperature_c - 15.0) * 3.4785e-3)


CATALOGUE_AIR = Environment()
VACUUM = Environment(pressure_hpa=0.0)


def air_refractivity(l2: Any) -> Any:
    """n - 1 of standard air at 15 C and 1013.25 hPa; ``l2`` is the squared wavelength [um^2] (Kohlrausch 1968)."""
    return 1e-8 * (6432.8 + 2949810.0 * l2 / (146.0 * l2 - 1.0) + 25540.0 * l2 / (41.0 * l2 - 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class IndexFormula:
    """How one medium of a compiled lens gets its index from its slice of the parameter vector.

    ``terms`` Sellmeier terms (0: the surroundings), ``thermal`` whether the temperature differs from the catalogue's.
    Parameters: air factor; then for glass: perturbation, B..., C..., and for ``thermal``: three SCHOTT numbers.
    """

    at: int
    terms: int
    thermal: bool

    def index(self, theta: Sequence[Any], wavelength_nm: Any, xp: ArrayNamespace) -> Any:
        """Absolute refractive index at each wavelength."""
        l2 = (wavelength_nm * 1e-3) * (wavelength_nm * 1e-3)
        if self.terms == 0:
            return 1.0 + theta[self.at] * air_refractivity(l2)
        b = theta[self.at + 2 : self.at + 2 + self.terms]
        c = theta[self.at + 2 + self.terms : self.at + 2 + 2 * self.terms]
        n2 = 1.0 + l2 * 0.0
        for bj, cj in zip(b, c, strict=True):
            n2 = n2 + bj * l2 / (l2 - cj)
        relative = xp.sqrt(n2)
        absolute = relative * (1.0 + CATALOGUE_AIR.air_factor * air_refractivity(l2)) + theta[self.at + 1]
        if self.thermal:
            d, e, pole = theta[self.at + 2 + 2 * self.terms : self.at + 5 + 2 * self.terms]
            absolute = absolute + (n2 - 1.0) / (2.0 * relative) * (d + e / (l2 - pole))
        return absolute


def index_parameters(
    glass: Glass | None, environment: Environment, perturbation: float
) -> tuple[list[float], int, bool]:
    """Parameter slice, number of Sellmeier terms and thermal switch of one medium; ``None`` is the surroundings.

    Raises
    ------
    DomainError
        If the glass has no dn/dT data and the temperature is not the catalogue's.
    """
    if glass is None:
        return [environment.air_factor], 0, False
    b, c = [float(v) for v in glass.B], [float(v) for v in glass.C]
    parameters = [environment.air_factor, perturbation, *b, *c]
    dt = environment.temperature_c - REFERENCE_TEMPERATURE_C
    if math.isclose(dt, 0.0, abs_tol=1e-12):
        return parameters, len(b), False
    if glass.dndt is None:
        raise DomainError(
            f"glass {glass.name} has no dn/dT data; the lens cannot be used at {environment.temperature_c} C "
            f"(catalogue temperature {REFERENCE_TEMPERATURE_C} C)"
        )
    k = glass.dndt
    parameters += [k.D0 * dt + k.D1 * dt**2 + k.D2 * dt**3, k.E0 * dt + k.E1 * dt**2, k.lambda_tk_um**2]
    return parameters, len(b), True
