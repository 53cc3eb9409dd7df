r"""Optical glass: one record, a catalogue of published coefficients, and index and absorption computed from them.

Catalogue indices follow Sellmeier's formula and are relative to air at the reference temperature :math:`T_0` of the
maker (20 C; OHARA 25 C) and 1013.25 hPa:

.. math:: n_{rel}^2(\lambda) = 1 + \sum_j \frac{B_j \lambda^2}{\lambda^2 - C_j}

The index against vacuum and at another temperature follows from `optics.glass.thermal_index`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError, unknown_name
from optics.glass.air import STANDARD_PRESSURE_HPA, AirFormula, air_index
from optics.glass.dispersion import Dispersion
from optics.glass.thermal_index import ThermalDispersion, thermal_change
from optics.response import Response, checked_wavelength


@dataclass(frozen=True, slots=True, kw_only=True)
class Glass:
    """An optical material.

    Attributes
    ----------
    name, maker, source : str
        Name in the catalogue, who makes it, where the numbers come from.
    dispersion : Dispersion
        Formula of the index and its coefficients.
    range_nm : (float, float)
        Wavelengths for which the formula holds [nm].
    reference_temperature_c, reference_pressure_hpa : float
        Temperature [C] of the catalogue index, and pressure of the air to which it is relative [hPa]; 0 for vacuum.
    dndt : ThermalDispersion, optional
        How the absolute index changes with temperature.
    cte_per_k : float, optional
        Linear expansion between -30 and +70 C [1/K].
    density_g_cm3 : float, optional
        Density.
    nd, vd : float, optional
        Printed index at 587.5618 nm and Abbe number; for checks and lists, never used to compute.
    transmittance : Response, optional
        Internal transmittance of a plate ``transmittance_mm`` thick.
    transmittance_mm : float, optional
        Thickness of that plate [mm].

    Raises
    ------
    DomainError
        A value that is not finite, a resonance inside the range, an index below that of vacuum.
    ConfigError
        No source.
    """

    name: str
    source: str
    dispersion: Dispersion
    range_nm: tuple[float, float]
    maker: str = "generic"
    reference_temperature_c: float = 20.0
    reference_pressure_hpa: float = STANDARD_PRESSURE_HPA
    dndt: ThermalDispersion | None = None
    cte_per_k: float | None = None
    density_g_cm3: float | None = None
    nd: float | None = None
    vd: float | None = None
    transmittance: Response | None = None
    transmittance_mm: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "range_nm", _floats(self.range_nm, f"glass {self.name}: range_nm"))
        if not self.source:
            raise ConfigError(f"glass {self.name}: a source is missing; say where its coefficients come from")
        if len(self.range_nm) != 2 or not 0.0 < self.range_nm[0] < self.range_nm[1]:
            raise DomainError(
                f"glass {self.name}: range_nm = {self.range_nm}; two increasing wavelengths [nm] are needed"
            )
        coldest, hottest = REFERENCE_RANGE_C
        if not coldest <= self.reference_temperature_c <= hottest:
            raise DomainError(
                f"glass {self.name}: reference_temperature_c = {self.reference_temperature_c:g} C is outside "
                f"{coldest:g} ... {hottest:g} C"
            )
        low, high = self.range_nm
        for resonance in self.dispersion.resonances_um2:
            if resonance > 0.0 and low <= 1e3 * resonance**0.5 <= high:
                raise DomainError(
                    f"glass {self.name}: C = {resonance:g} um^2 is a resonance at {1e3 * resonance**0.5:g} nm, inside "
                    f"its range {low:g} ... {high:g} nm"
                )
        what = "n^2" if self.dispersion.form.squared else "n"
        with np.errstate(all="ignore"):  # powers of the wavelength may overflow or divide by zero: refused below
            total = self.dispersion.total(np.geomspace(low, high, 64))
        if not (total < _LARGEST_INDEX ** (2 if self.dispersion.form.squared else 1)).all():  # or not a number
            raise DomainError(
                f"glass {self.name}: its coefficients {str(self.dispersion.coefficients)[:200]} make {what} larger "
                f"than that of any glass inside {low:g} ... {high:g} nm"
            )
        if not (total >= _LEAST_INDEX).all():
            raise DomainError(f"glass {self.name}: {what} falls to {total.min():g} inside {low:g} ... {high:g} nm")
        if (self.transmittance is None) != (self.transmittance_mm is None):
            raise ConfigError(f"glass {self.name}: give transmittance and transmittance_mm together, or neither")
        if self.transmittance_mm is not None and not self.transmittance_mm > 0.0:
            raise DomainError(
                f"glass {self.name}: transmittance_mm = {self.transmittance_mm:g} mm; it must be positive"
            )

    def _inside(self, wavelength_nm: ArrayLike) -> FloatArray:
        return checked_wavelength(
            wavelength_nm, self.range_nm, f"glass {self.name}", "its dispersion formula holds nowhere else"
        )

    def index(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Index relative to air at ``reference_temperature_c`` and 1013.25 hPa, of the shape of ``wavelength_nm`` [nm].

        The testbed passes vacuum wavelengths (docs/conventions.md). DomainError outside ``range_nm``.
        """
        return self.dispersion.index(self._inside(wavelength_nm))

    def absolute_index(
        self,
        wavelength_nm: ArrayLike,
        *,
        temperature_c: float | None = None,
        air_formula: AirFormula = "kohlrausch",
    ) -> FloatArray:
        """Index against vacuum at ``temperature_c`` [C], the reference temperature if left out.

        ``air_formula`` is the air of the catalogue measurement. DomainError for a wavelength or temperature outside its
        range, or without dn/dT data for another temperature.
        """
        wavelength_nm = self._inside(wavelength_nm)
        relative = self.dispersion.index(wavelength_nm)
        reference = self.reference_temperature_c
        absolute = relative * air_index(wavelength_nm, reference, self.reference_pressure_hpa, formula=air_formula)
        if temperature_c is None or temperature_c == reference:
            return np.asarray(absolute)
        return np.asarray(absolute + thermal_change(wavelength_nm, relative, *self.thermal_terms(temperature_c)))

    def thermal_terms(self, temperature_c: float) -> tuple[float, float, float]:
        """Terms of dn/dT (`optics.glass.thermal_index.thermal_change`) at a temperature; DomainError without data."""
        reference = self.reference_temperature_c
        if self.dndt is None:
            raise DomainError(
                f"glass {self.name} has no dn/dT data, so {temperature_c:g} C cannot be computed; use {reference:g} C"
            )
        low, high = self.dndt.range_c
        if not low <= temperature_c <= high:
            raise DomainError(
                f"glass {self.name}: {temperature_c:g} C is outside {low:g} ... {high:g} C of its dn/dT data"
            )
        return self.dndt.terms(temperature_c - reference)

    def relative_index(
        self,
        wavelength_nm: ArrayLike,
        *,
        temperature_c: float | None = None,
        pressure_hpa: float = STANDARD_PRESSURE_HPA,
        medium: Literal["air", "vacuum"] = "air",
        air_formula: AirFormula = "kohlrausch",
    ) -> FloatArray:
        """Index relative to air of ``pressure_hpa`` [hPa] or to vacuum at the temperature of the glass.

        Other parameters and errors as in `absolute_index`; ConfigError for an unknown ``medium``.
        """
        if medium not in ("air", "vacuum"):
            raise unknown_name("medium", medium, ("air", "vacuum"))
        absolute = self.absolute_index(wavelength_nm, temperature_c=temperature_c, air_formula=air_formula)
        if medium == "vacuum":
            return absolute
        celsius = self.reference_temperature_c if temperature_c is None else temperature_c
        return absolute / air_index(wavelength_nm, celsius, pressure_hpa, formula=air_formula)

    def internal_transmittance(self, wavelength_nm: ArrayLike, path_mm: ArrayLike) -> FloatArray:
        """Fraction of light after a path [mm] through the glass, without reflections (Beer-Lambert).

        ``tau ** (path / thickness)`` with the maker's tau interpolated linearly; wavelengths [nm] and paths broadcast.
        DomainError without a table, outside it, or for a negative path.
        """
        if self.transmittance is None or self.transmittance_mm is None:
            raise DomainError(
                f"glass {self.name} has no internal transmittance table: use another glass, or set "
                "instrument.absorption = false"
            )
        path = np.asarray(path_mm, dtype=np.float64)
        if not (path >= 0.0).all():
            raise DomainError(f"glass {self.name}: path {path[~(path >= 0.0)].flat[0]:g} mm through it is negative")
        return np.asarray(self.transmittance.interpolate(wavelength_nm) ** (path / self.transmittance_mm))


def _floats(values: Any, what: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(v) for v in values)
    except (TypeError, ValueError):
        raise DomainError(f"{what} = {values!r} is not a list of numbers") from None
    if not np.isfinite(numbers).all():
        raise DomainError(f"{what} = {numbers} holds a value that is not finite")
    return numbers


REFERENCE_RANGE_C = (-273.15, 1000.0)
"""Temperatures at which an index may have been measured."""
_LEAST_INDEX = 0.999
"""Lowest refractive index of a glass; vacuum has 0.99973 against air."""
_LARGEST_INDEX = 10.0
"""Highest refractive index of a glass; lead telluride, the highest of transparent materials, has 6."""

_SCALARS = ("nd", "vd", "cte_per_k", "density_g_cm3", "reference_temperature_c", "reference_pressure_hpa")
_TRANSMITTANCE = ("transmittance_mm", "transmittance_nm", "transmittance")
_FORMULA = ("B", "C", "formula", "coefficients", "range_nm", "dndt", "dndt_range_c")
_KEYS = ("maker", "source", *_FORMULA, *_SCALARS, *_TRANSMITTANCE)


def glass_from_table(name: str, table: Mapping[str, Any]) -> Glass:
    """Glass from a table of keys, as in ``[glass.NAME]`` of a lens file."""
    if not isinstance(table, Mapping):
        raise ConfigError(f"glass {name}: a table with B and C is needed, got {table!r}")
    for key in table:
        if key not in _KEYS:
            raise unknown_name(f"key of glass {name}:", key, _KEYS)
    source, dispersion = str(table.get("source", "")), _dispersion(name, table)
    if "range_nm" not in table:
        raise ConfigError(f"glass {name}: key 'range_nm' is missing; say for which wavelengths the formula holds")
    curve, thickness = _transmittance(name, table, source)
    return Glass(
        name=name,
        maker=str(table.get("maker", "generic")),
        source=source,
        dispersion=dispersion,
        range_nm=table["range_nm"],  # its length is checked by the record
        dndt=_thermal(name, table),
        transmittance=curve,
        transmittance_mm=thickness,
        **{key: _floats([table[key]], f"glass {name}: {key}")[0] for key in _SCALARS if key in table},
    )


def _dispersion(name: str, table: Mapping[str, Any]) -> Dispersion:
    if "formula" in table or "coefficients" in table:
        wrong = [key for key in ("B", "C") if key in table]
        missing = [key for key in ("formula", "coefficients") if key not in table]
        if wrong or missing:
            raise ConfigError(f"glass {name}: give either B and C, or formula and coefficients, not parts of both")
        keys = ["coefficients"]
    else:
        keys = ["B", "C"]
        missing = [key for key in keys if key not in table]
    if missing:
        raise ConfigError(
            f"glass {name}: key {missing[0]!r} is missing; B, C [um^2] and range_nm make a Sellmeier formula"
        )
    numbers = [_floats(table[key], f"glass {name}: {key}") for key in keys]
    try:
        return Dispersion.sellmeier(*numbers) if len(keys) == 2 else Dispersion(str(table["formula"]), numbers[0])
    except ConfigError as error:
        raise ConfigError(f"glass {name}: {error}") from None
    except DomainError as error:
        raise DomainError(f"glass {name}: {error}") from None


def _thermal(name: str, table: Mapping[str, Any]) -> ThermalDispersion | None:
    if "dndt" not in table:
        return None
    constants = _floats(table["dndt"], f"glass {name}: dndt")
    if len(constants) != 6:
        raise ConfigError(f"glass {name}: dndt has {len(constants)} numbers; D0 D1 D2 E0 E1 lambda_TK are needed")
    try:
        dndt = ThermalDispersion.of(constants)
    except DomainError as error:
        raise DomainError(f"glass {name}: {error}") from None
    if "dndt_range_c" not in table:
        return dndt
    low, high = _floats(table["dndt_range_c"], f"glass {name}: dndt_range_c")
    return replace(dndt, range_c=(low, high))


def _transmittance(name: str, table: Mapping[str, Any], source: str) -> tuple[Response | None, float | None]:
    given = [table[key] for key in _TRANSMITTANCE if key in table]
    if not given:
        return None, None
    if len(given) < len(_TRANSMITTANCE):
        raise ConfigError(f"glass {name}: give transmittance_mm, transmittance_nm and transmittance together, or none")
    thickness_mm, wavelength_nm, value = given
    title = f"internal transmittance of {name}"
    return Response(name=title, source=source, wavelength_nm=wavelength_nm, value=value), float(thickness_mm)


_CURRENT, _OBSOLETE = "glasses.toml", "glasses_obsolete.toml"


@cache
def _catalogue(file: str) -> dict[str, Any]:
    return tomllib.loads(files("optics").joinpath("data", file).read_text(encoding="utf-8"))


def list_glasses(maker: str | None = None, *, obsolete: bool = False) -> tuple[str, ...]:
    """Names in the catalogue, sorted; of one maker if given (SCHOTT, OHARA, CDGM, generic), or the obsolete ones.

    Parameters
    ----------
    maker : str, optional
        SCHOTT, OHARA, CDGM or generic; all if left out.
    obsolete : bool
        The obsolete glasses in place of the glasses in production.

    Returns
    -------
    tuple of str
        Names for `get_glass`.
    """
    catalogue = _catalogue(_OBSOLETE if obsolete else _CURRENT)
    makers = {source["maker"] for source in catalogue["source"].values()}
    if maker is not None and maker not in makers:
        raise unknown_name("glass maker", maker, makers)
    sources, glasses = catalogue["source"], catalogue["glass"]
    return tuple(sorted(n for n, g in glasses.items() if maker in (None, sources[g["source"]]["maker"])))


@cache
def get_glass(name: str) -> Glass:
    """Glass from the catalogue (``optics/data/glasses.toml``, then obsolete glasses).

    Parameters
    ----------
    name : str
        Catalogue name, for example ``"N-BK7"``, ``"S-FPL53"``, ``"H-K9L"``, ``"CaF2"``, ``"fused-silica"``.

    Returns
    -------
    Glass
        Always the same object for the same name.

    Raises
    ------
    ConfigError
        Unknown name, with the nearest ones.
    """
    catalogues = [_catalogue(file) for file in (_CURRENT, _OBSOLETE)]
    catalogue = next((c for c in catalogues if name in c["glass"]), None)
    if catalogue is None:
        raise unknown_name("glass", name, [known for c in catalogues for known in c["glass"]])
    entry = dict(catalogue["glass"][name])
    origin = catalogue["source"][entry.pop("source")]
    entry |= {"maker": origin["maker"], "source": origin["text"]}
    entry["reference_temperature_c"] = origin["reference_temperature_c"]
    if "dndt" in entry:
        entry["dndt_range_c"] = origin["dndt_range_c"]
    return glass_from_table(name, entry)
