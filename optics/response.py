"""Tabulated curves over wavelength: quantum efficiency, transmittance, reflectance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.records import freeze_alike

ROUNDING = 1e-12


def checked_wavelength(
    wavelength_nm: ArrayLike, range_nm: tuple[float, float], title: str, advice: str = "stay inside"
) -> FloatArray:
    """Wavelengths as a float64 array, all inside a range."""
    try:
        wave = np.asarray(wavelength_nm, dtype=np.float64)
    except (TypeError, ValueError):
        raise DomainError(f"{title}: wavelength {wavelength_nm!r} is not a number in nm") from None
    low, high = range_nm
    bad = ~((wave >= low * (1.0 - ROUNDING)) & (wave <= high * (1.0 + ROUNDING)))
    if bad.any():
        value = wave[bad].flat[0] if wave.ndim else float(wave)
        raise DomainError(f"{title}: wavelength {value:g} nm is outside {low:g} ... {high:g} nm; {advice}")
    return wave


def check_table(wavelength_nm: FloatArray, value: FloatArray, title: str, *, upper: float = np.inf) -> None:
    """Refuse an invalid curve: fewer than two points, wavelengths not increasing, values outside 0 ... ``upper``."""
    if wavelength_nm.size < 2:
        raise DomainError(f"{title}: a table needs at least two points, got {wavelength_nm.size}")
    if wavelength_nm[0] <= 0:
        raise DomainError(f"{title}: wavelength {wavelength_nm[0]:g} nm is not positive")
    step = np.diff(wavelength_nm)
    if not (step > 0).all():
        at = int(np.argmax(step <= 0))
        raise DomainError(
            f"{title}: wavelengths must increase, but {wavelength_nm[at + 1]:g} nm follows {wavelength_nm[at]:g} nm"
        )
    bad = (value < 0) | (value > upper)
    if bad.any():
        at = int(np.argmax(bad))
        raise DomainError(
            f"{title}: value {value[at]:g} at {wavelength_nm[at]:g} nm is outside "
            f"{f'0 ... {upper:g}' if np.isfinite(upper) else '0 ... infinity'}"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """Values tabulated over wavelength; their meaning and the values outside the table depend on the type of curve."""

    name: str
    source: str  # Of its numbers
    wavelength_nm: FloatArray  # (n,) Increasing wavelengths [nm]
    value: FloatArray  # (n,) Value at each of them
    noun: ClassVar[str] = "curve"
    largest: ClassVar[float] = 1.0
    """Largest allowed value; a fraction does not exceed 1."""

    def __post_init__(self) -> None:
        freeze_alike(self, "wavelength_nm", "value", shape=("n",))
        check_table(self.wavelength_nm, self.value, self.title, upper=self.largest)
        if not self.source:
            raise ConfigError(f"{self.title} needs a source; say where its numbers come from")

    @property
    def title(self) -> str:
        """Name in messages."""
        return f"{self.noun} {self.name!r}"

    @property
    def range_nm(self) -> tuple[float, float]:
        """First and last wavelength [nm]."""
        return float(self.wavelength_nm[0]), float(self.wavelength_nm[-1])

    def interpolate(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Linear interpolation."""
        wave = checked_wavelength(wavelength_nm, self.range_nm, self.title, "the table ends there")
        result: Any = np.interp(wave, self.wavelength_nm, self.value)
        return np.asarray(result)


class Response(Curve):
    """A fraction (0 ... 1) tabulated over wavelength: quantum efficiency, transmittance or reflectance; see `Curve`.

    Attributes
    ----------
    name : str
        What it is.
    wavelength_nm : (n,)
        Increasing vacuum wavelengths [nm].
    value : (n,)
        Fractions at them; linear in between.
    source : str
        Where they come from.
    """

    __slots__ = ()

    @property
    def title(self) -> str:
        return self.name
