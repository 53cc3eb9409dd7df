"""Spectral energy distributions: photons emitted per nanometre.

Only the shape matters where a magnitude sets the scale (`optics.light.magnitudes`). Both types have the unit photons
s^-1 mm^-2 nm^-1, emitted by the surface of a blackbody or tabulated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from scipy import constants

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.response import Curve, checked_wavelength

PHOTON_J_NM = constants.h * constants.c * 1e9
"""Energy of a photon times its wavelength in vacuum [J nm] (CODATA)."""

_SECOND_RADIATION_NM_K = constants.h * constants.c / constants.k * 1e9


@runtime_checkable
class Sed(Protocol):
    """A source: photons s^-1 mm^-2 nm^-1 over wavelength."""

    @property
    def range_nm(self) -> tuple[float, float]:
        """Wavelengths for which it is known [nm]."""
        ...

    @property
    def breakpoints_nm(self) -> FloatArray:
        """Wavelengths at which it is not smooth [nm], increasing; may be empty."""
        ...

    def photon_density(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Photons s^-1 mm^-2 nm^-1 at each wavelength [nm]."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Blackbody:
    r"""Black-body spectrum, the usual model of a star.

    .. math:: N(\lambda) = \frac{2 \pi c}{\lambda^4} \frac{1}{e^{h c / \lambda k T} - 1}

    Attributes
    ----------
    temperature_k : float
        Effective temperature [K].

    Raises
    ------
    DomainError
        Temperature not positive or not finite.
    """

    temperature_k: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.temperature_k) and self.temperature_k > 0.0):
            raise DomainError(f"blackbody temperature {self.temperature_k:g} K; it must be positive and finite")

    @property
    def range_nm(self) -> tuple[float, float]:
        """Any wavelength from 1 nm to 1 cm."""
        return 1.0, 1e7

    @property
    def breakpoints_nm(self) -> FloatArray:
        """None: Planck's law is smooth."""
        return np.empty(0)

    def photon_density(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Photons s^-1 mm^-2 nm^-1 leaving the surface, at wavelengths [nm] of any shape, up to 1 cm."""
        wave = checked_wavelength(wavelength_nm, self.range_nm, f"blackbody of {self.temperature_k:g} K")
        # exp(-x) / (1 - exp(-x)) instead of 1 / (exp(x) - 1): no overflow for cold bodies in the blue
        decay = -_SECOND_RADIATION_NM_K / (wave * self.temperature_k)
        per_m3_s = 2.0 * math.pi * constants.c / (wave * 1e-9) ** 4 * np.exp(decay) / -np.expm1(decay)
        return np.asarray(per_m3_s * 1e-15)  # m^-2 m^-1 -> mm^-2 nm^-1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TabulatedSed(Curve):
    """Tabulated spectrum, interpolated linearly in the tabulated quantity.

    Attributes
    ----------
    name, source : str
        What it is and where it comes from.
    wavelength_nm : (n,)
        Increasing wavelengths [nm].
    value : (n,)
        Photons s^-1 mm^-2 nm^-1 or W mm^-2 nm^-1, or anything proportional where a magnitude sets the scale.
    quantity : {"photon", "power"}
        Which of the two.

    Raises
    ------
    DomainError
        Unequal lengths, NaN, wavelengths not increasing, a negative value, all values zero.
    ConfigError
        Unknown quantity, no source.
    """

    quantity: Literal["photon", "power"]
    noun: ClassVar[str] = "spectrum"
    largest: ClassVar[float] = math.inf

    def __post_init__(self) -> None:
        Curve.__post_init__(self)
        if not self.value.any():
            raise DomainError(f"{self.title} is zero everywhere")
        if self.quantity not in ("photon", "power"):
            raise ConfigError(f"{self.title}: quantity {self.quantity!r} is neither 'photon' nor 'power'")

    @property
    def breakpoints_nm(self) -> FloatArray:
        """The tabulated wavelengths."""
        return self.wavelength_nm

    def photon_density(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Photons s^-1 mm^-2 nm^-1, or proportional to it, at wavelengths [nm] of any shape in the table."""
        value = self.interpolate(wavelength_nm)
        return value if self.quantity == "photon" else value * np.asarray(wavelength_nm, float) / PHOTON_J_NM
