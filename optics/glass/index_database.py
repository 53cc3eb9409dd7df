r"""Materials as YAML files of the refractiveindex.info database (M. Polyanskiy, Sci. Data 11, 94 (2024)).

Formulas 1 to 7 are read as they stand, a tabulated index by a least-squares polynomial in the squared wavelength whose
largest residual is part of the source. An extinction coefficient k becomes the internal transmittance of 10 mm,
:math:`\tau = \exp(-4 \pi k d / \lambda)`. The database gives indices against air unless a file says otherwise.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError, StarbenchError
from optics.glass.air import STANDARD_PRESSURE_HPA
from optics.glass.catalogue import Glass
from optics.glass.dispersion import Dispersion
from optics.glass.model_glass import model_glass
from optics.glass.thermal_index import ThermalDispersion
from optics.response import Response
from optics.textfile import read_text

PLATE_MM = 10.0
LARGEST_RESIDUAL = 2e-4
"""A tabulated index that no smooth curve follows so closely is refused."""
_KELVIN = 273.15


def read_material(path: str | Path, name: str | None = None) -> Glass:
    """Read a material of refractiveindex.info."""
    text = "\n".join(read_text(path, "a material file (YAML)").lines)
    try:
        file = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}:" if mark else ""
        said = " ".join(str(getattr(error, "problem", None) or error).split())
        raise ConfigError(f"{path}:{where} not valid YAML ({said})") from None
    if not isinstance(file, Mapping) or not isinstance(file.get("DATA"), Sequence):
        raise ConfigError(f"{path}: no list DATA; a material file of refractiveindex.info is needed")
    called = name or Path(path).stem
    try:
        return _glass(file, called)
    except StarbenchError as error:
        raise type(error)(f"{path}: {error}") from None
    except (TypeError, ValueError, KeyError, IndexError, OverflowError) as error:
        raise ConfigError(f"{path}: not in the format of refractiveindex.info ({error})") from None


def _glass(file: Mapping[str, Any], name: str) -> Glass:
    dispersion, curve, note = None, None, ""
    for entry in file["DATA"]:
        kind = str(entry["type"]).strip().lower()
        if kind.startswith("formula") and dispersion is None:
            low, high = (1e3 * float(x) for x in str(entry["wavelength_range"]).split())
            dispersion = _formula(int(kind.split()[1]), [float(x) for x in str(entry["coefficients"]).split()])
        elif kind in ("tabulated n", "tabulated nk") and dispersion is None:
            table = _table(entry["data"])
            (low, high), (dispersion, note) = 1e3 * table[[0, -1], 0], _tabulated(table, file.get("PROPERTIES") or {})
        if kind in ("tabulated k", "tabulated nk"):
            table = _table(entry["data"])
            curve = _plate(table[:, 0], table[:, -1], name)
    if dispersion is None:
        raise ConfigError("it contains no refractive index")
    conditions, properties = (file.get(key) or {} for key in ("CONDITIONS", "PROPERTIES"))
    specs = file.get("SPECS") or {}
    temperature = float(conditions.get("temperature", 293.15)) - _KELVIN
    absolute = any(bool(place.get("n_is_absolute") or place.get("n_absolute")) for place in (conditions, specs))
    return Glass(
        name=name,
        source=f"refractiveindex.info: {_plain(file.get('REFERENCES', ''))}{note}",
        dispersion=dispersion,
        range_nm=(float(low), float(high)),
        reference_temperature_c=round(temperature) if abs(temperature) < 200 else temperature,
        reference_pressure_hpa=0.0 if absolute else STANDARD_PRESSURE_HPA,
        dndt=_thermal(properties),
        cte_per_k=_first(properties, "thermal_expansion"),
        transmittance=curve,
        transmittance_mm=None if curve is None else PLATE_MM,
    )


def _formula(number: int, c: list[float]) -> Dispersion:
    if number == 1:
        squared = [x * x if i % 2 == 0 and i > 0 else x for i, x in enumerate(c)]
        return Dispersion("shifted_sellmeier", tuple(squared))
    names = {2: "shifted_sellmeier", 3: "square_polynomial", 4: "mixed", 5: "polynomial", 6: "gas", 7: "herzberger"}
    if number not in names:
        raise ConfigError(f"formula {number} of refractiveindex.info is not read; formulas 1 to 7 are")
    return Dispersion(names[number], tuple(c))


def _table(text: Any) -> FloatArray:
    rows = [[float(x) for x in line.split()] for line in str(text).splitlines() if line.strip()]
    table = np.array(rows, float)
    if table.ndim != 2 or table.shape[1] < 2 or not (np.abs(table) < 1e6).all():
        raise ConfigError("a table of data has rows of unequal length, no numbers, or numbers beyond a million")
    if not (table[:, 0] > 0.0).all():
        raise DomainError(f"a table of data has the wavelength {table[:, 0].min():g} um; they must be positive")
    _, first = np.unique(table[:, 0], return_index=True)
    return np.asarray(table[first])


def _tabulated(table: FloatArray, properties: Mapping[str, Any]) -> tuple[Dispersion, str]:
    """Smooth curve through a table; through n_d and v_d where the table is rough and the file states them."""
    dispersion, residual = fitted_index(table[:, 0], table[:, 1])
    if residual <= LARGEST_RESIDUAL:
        return dispersion, f"; polynomial through {len(table)} values, residuals up to {residual:.1e}"
    nd, vd = (float(properties.get(key) or 0.0) for key in ("nd", "Vd"))
    if not (nd > 1.0 and vd > 0.0):
        raise DomainError(f"its tabulated index is too rough: a smooth curve leaves residuals of {residual:.1e}")
    return model_glass("", nd, vd).dispersion, "; index from its n_d and v_d, as its table is too rough"


def fitted_index(wave_um: FloatArray, index: FloatArray) -> tuple[Dispersion, float]:
    """Smooth curve through measured indices.

    Shapes: ``wave_um`` (n,), ``index`` (n,).
    """
    exponents = (0, 2, -2, -4, -6, -8)[: max(2, min(6, (len(wave_um) + 1) // 2 + (len(wave_um) > 3)))]
    columns = np.stack([wave_um**p for p in exponents], axis=1)
    factors = np.linalg.lstsq(columns / abs(columns).max(0), index**2, rcond=None)[0] / abs(columns).max(0)
    residual = float(np.abs(np.sqrt(np.maximum(columns @ factors, 0.0)) - index).max())
    return Dispersion("schott", tuple(float(f) for f in factors)), residual


def _plate(wave_um: FloatArray, k: FloatArray, name: str) -> Response:
    tau = np.exp(-4e3 * np.pi * np.maximum(k, 0.0) * PLATE_MM / wave_um)
    return Response(
        name=f"internal transmittance of {name}", source="refractiveindex.info", wavelength_nm=1e3 * wave_um, value=tau
    )


def _thermal(properties: Mapping[str, Any]) -> ThermalDispersion | None:
    for entry in properties.get("thermal_dispersion") or ():
        if str(entry.get("type", "")).lower() in ("formula a", "schott formula"):
            return ThermalDispersion.of([float(x) for x in str(entry["coefficients"]).split()[:6]])
    return None


def _first(properties: Mapping[str, Any], key: str) -> float | None:
    """A datum that some files misspell: then it is not known."""
    for entry in properties.get(key) or ():
        with suppress(TypeError, ValueError):
            return float(entry["value"])
    return None


def _plain(text: str) -> str:
    """One line without HTML."""
    return " ".join(re.sub(r"<[^>]*>", "", str(text)).split())
