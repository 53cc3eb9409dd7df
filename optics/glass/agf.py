"""Glass catalogues in AGF format of lens design programs (Zemax OpticStudio Help, *format of AGF files*).

One record per glass, one line per type of datum: ``NM`` name, number of the dispersion formula, code, n_d, v_d; ``ED``
expansion and density; ``CD`` coefficients; ``TD`` thermal constants and reference temperature; ``LD`` range; ``IT``
internal transmittances. A glass with invalid data is refused only when it is requested.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from optics.errors import ConfigError, DomainError, StarbenchError, unknown_name
from optics.glass.catalogue import Glass
from optics.glass.dispersion import AGF_FORMULAS, Dispersion
from optics.glass.model_glass import D_NM
from optics.glass.thermal_index import ThermalDispersion
from optics.response import Response
from optics.textfile import read_text

_STATED_ND = 0.05
"""Largest difference of the printed n_d from that of the formula; beyond it the coefficients are no glass."""


@dataclass(slots=True)
class _Record:
    """Lines of one glass, as words: by their two letters, with line numbers."""

    line: int
    name: list[str]
    data: dict[str, list[str]] = field(default_factory=dict)
    transmittance: list[list[str]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class AgfCatalogue:
    """Glasses of one AGF file."""

    name: str  # Name of the catalogue: that of the file without its ending, in capitals
    path: Path  # Where it was read
    _records: dict[str, _Record]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its glasses, in the order of the file."""
        return tuple(record.name[0] for record in self._records.values())

    def __contains__(self, name: str) -> bool:
        return name.upper() in self._records

    def glass(self, name: str) -> Glass:
        """The glass of a name."""
        record = self._records.get(name.upper())
        if record is None:
            raise unknown_name(f"glass of catalogue {self.name}", name, self.names)
        where = f"{self.path.name}: line {record.line}: glass {record.name[0]}"
        try:
            return _glass(record, self.name, self.path.name)
        except DomainError as error:
            raise DomainError(f"{where}: {error}") from None
        except StarbenchError as error:
            raise ConfigError(f"{where}: {error}") from None


def read_agf(path: str | Path) -> AgfCatalogue:
    """Read an AGF catalogue."""
    records: dict[str, _Record] = {}
    current: _Record | None = None
    open_line: list[str] = []
    for number, line in enumerate(read_text(path, "a glass catalogue (AGF)").lines, 1):
        words = line.split()
        if not words:
            continue
        kind = words[0].upper()
        if kind == "NM":
            current = _Record(number, words[1:])
            if current.name:
                records.setdefault(current.name[0].upper(), current)  # a second record of the same name is ignored
            words = []
        elif current is not None and kind == "IT":
            words = words[1:]
            current.transmittance.append(words)
        elif current is not None and kind in ("ED", "CD", "TD", "LD", "BD"):
            words = current.data.setdefault(kind, words[1:])
        elif kind[0] in "+-.0123456789":
            open_line.extend(words)  # some files break long lines
            continue
        else:
            words = []
        open_line = words
    if not records:
        raise ConfigError(f"{path}: the file contains no glass (no line begins with NM)")
    return AgfCatalogue(Path(path).stem.upper(), Path(path), records)


def _number(words: list[str], at: int, default: float) -> float:
    """A number of a line; the default where the line ends before, or has a dash."""
    try:
        value = float(words[at].replace(",", "."))
    except (IndexError, ValueError):
        return default
    return value if math.isfinite(value) else default


def _glass(record: _Record, catalogue: str, file: str) -> Glass:
    name = record.name[0]
    number = int(_number(record.name, 1, 0.0))
    if number not in AGF_FORMULAS:
        raise ConfigError(f"dispersion formula {number} is not one of the thirteen AGF formulas")
    formula, count = AGF_FORMULAS[number]
    words = record.data.get("CD", [])[:count]
    given = [_number(words, i, math.nan) for i in range(len(words))]
    if not any(given) or any(map(math.isnan, given)):
        raise ConfigError("its coefficients (line CD) are missing, not numbers, or all zero")
    padded = [*given, *[0.0] * (count - len(given))]
    if formula == "sellmeier":
        padded = [x for pair in zip(padded[::2], padded[1::2], strict=True) if any(pair) for x in pair]
    nd, vd = _number(record.name, 3, 0.0), _number(record.name, 4, 0.0)
    temperature = _number(record.data.get("TD", []), 6, 20.0)
    expansion, density = (_number(record.data.get("ED", []), i, 0.0) for i in (0, 2))
    curve, thickness = _transmittance(record, name, file)
    low, high = (1e3 * _number(record.data.get("LD", []), i, 0.0) for i in (0, 1))
    if not 0.0 < low < high:
        raise ConfigError("its range of wavelengths (line LD) is missing or not increasing")
    dispersion = Dispersion(formula, tuple(padded))
    glass = Glass(
        name=name,
        maker=catalogue,
        source=f"AGF catalogue {file}",
        dispersion=dispersion,
        range_nm=(low, high),
        reference_temperature_c=temperature,
        dndt=_thermal(record.data.get("TD", [])),
        cte_per_k=1e-6 * expansion if expansion > 0.0 else None,
        density_g_cm3=density if density > 0.0 else None,
        nd=nd if nd > 1.0 else None,
        vd=vd if vd > 0.0 else None,
        transmittance=curve,
        transmittance_mm=thickness,
    )
    if nd > 1.0 and low <= D_NM <= high:
        computed = float(dispersion.index(D_NM))
        if abs(computed - nd) > _STATED_ND:
            raise DomainError(f"its coefficients give n_d = {computed:.5f}, the catalogue states {nd:.5f}")
    return glass


def _thermal(words: list[str]) -> ThermalDispersion | None:
    """The dn/dT constants; none where all are zero or missing: AGF files write zeros for unknown constants."""
    values = [_number(words, i, 0.0) for i in range(6)]
    return ThermalDispersion.of(values) if any(values[:5]) else None


def _transmittance(record: _Record, name: str, file: str) -> tuple[Response | None, float | None]:
    """Internal transmittances, brought to the thickness of the first entry (Beer-Lambert)."""
    points: dict[float, float] = {}
    thickness = None
    for words in record.transmittance:
        wave, value, plate = (_number(words, i, math.nan) for i in range(3))
        if not (wave > 0.0 and 0.0 <= value <= 1.0 and plate > 0.0):
            continue
        thickness = plate if thickness is None else thickness
        points.setdefault(1e3 * wave, value if plate == thickness else value ** (thickness / plate))
    if thickness is None or len(points) < 2:
        return None, None
    waves = sorted(points)
    curve = Response(
        name=f"internal transmittance of {name}",
        source=f"AGF catalogue {file}",
        wavelength_nm=np.array(waves),
        value=np.array([points[w] for w in waves]),
    )
    return curve, thickness
