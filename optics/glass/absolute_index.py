r"""Absolute refractive index along the ray path, on any array library.

Catalogue indices are relative to air at the maker's reference temperature and 1013.25 hPa. Rays need absolute ones:

.. math:: n_{abs}(\lambda, T) = n_{rel}(\lambda) \, n_{air}(\lambda, T_0) + \Delta n_{abs}(\lambda, T - T_0) + \delta

with :math:`n_{rel}` of `optics.glass.dispersion`, :math:`n_{air}` of `optics.glass.air`, :math:`\Delta n_{abs}` of
`optics.glass.thermal_index`, and :math:`\delta` a perturbation (melt
tolerance).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from optics.arrays import ArrayNamespace
from optics.errors import DomainError
from optics.glass.air import STANDARD_PRESSURE_HPA, TEMPERATURE_RANGE_C, kohlrausch_density, kohlrausch_refractivity
from optics.glass.catalogue import Glass
from optics.glass.dispersion import Form
from optics.glass.thermal_index import thermal_change

UNKNOWN_DNDT_K = 5.0
"""How far from its catalogue temperature a glass of unknown dn/dT may be used; 5 K change an index by about 1e-5."""


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

    temperature_c: float = 20.0
    pressure_hpa: float = STANDARD_PRESSURE_HPA

    def __post_init__(self) -> None:
        low, high = TEMPERATURE_RANGE_C
        if not low <= self.temperature_c <= high:
            raise DomainError(
                f"temperature {self.temperature_c} C is outside {low:g} ... {high:g} C, the dn/dT range of catalogues"
            )
        if not 0.0 <= self.pressure_hpa <= 2000.0:
            raise DomainError(f"air pressure {self.pressure_hpa} hPa is outside 0 ... 2000 hPa")

    @property
    def air_density(self) -> float:
        """Density of the air relative to 15 C and 1013.25 hPa."""
        return kohlrausch_density(self.temperature_c, self.pressure_hpa)


CATALOGUE_AIR = Environment()
VACUUM = Environment(pressure_hpa=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class IndexFormula:
    """How one medium of a compiled lens gets its index from its slice of the parameter vector.

    ``form`` is the dispersion formula (None: the surroundings), ``thermal`` whether the temperature differs from the
    catalogue's. Parameters: air density; then for glass: perturbation, the formula's numbers, and for ``thermal`` three
    SCHOTT numbers. The air density is that of the surroundings, for glass that of the maker's measurement.
    """

    at: int
    form: Form | None
    thermal: bool

    def index(self, theta: Sequence[Any], wavelength_nm: Any, xp: ArrayNamespace) -> Any:
        """Absolute refractive index at each wavelength."""
        air_density, rest = theta[self.at], self.at + 1
        air = 1.0 + air_density * kohlrausch_refractivity(wavelength_nm)
        if self.form is None:
            return air
        perturbation, thermal_at = theta[rest], rest + 1 + self.form.size
        relative = self.form.index(wavelength_nm, theta[rest + 1 : thermal_at], xp)
        absolute = relative * air + perturbation
        if self.thermal:
            absolute = absolute + thermal_change(wavelength_nm, relative, *theta[thermal_at : thermal_at + 3])
        return absolute


def index_parameters(
    glass: Glass | None, environment: Environment, perturbation: float
) -> tuple[list[float], Form | None, bool]:
    """Parameter slice, dispersion formula and thermal switch of one medium; ``None`` is the surroundings.

    A glass without dn/dT data keeps its catalogue index within `UNKNOWN_DNDT_K` of the catalogue's temperature.
    """
    if glass is None:
        return [environment.air_density], None, False
    reference = glass.reference_temperature_c
    density = kohlrausch_density(reference, glass.reference_pressure_hpa)
    form = glass.dispersion.form
    parameters = [density, perturbation, *glass.dispersion.numbers]
    kelvin = environment.temperature_c - reference
    if math.isclose(kelvin, 0.0, abs_tol=1e-12) or (glass.dndt is None and abs(kelvin) <= UNKNOWN_DNDT_K):
        return parameters, form, False
    return [*parameters, *glass.thermal_terms(environment.temperature_c)], form, True
