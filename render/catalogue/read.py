"""Any star catalogue that astropy reads (FITS, VOTable, ECSV, CSV, CDS/MRT) as a `StarCatalog`; units are checked.

Units stated in the file take precedence; otherwise the preset's units are assumed, and numbers that look like another
unit are refused.
"""

from __future__ import annotations

import io
import math
import os
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError, StarbenchError
from optics.fits import open_fits, unpacked
from optics.units import DEG_RAD
from render.catalogue.presets import MEANINGS, ColumnPreset, get_preset
from render.catalogue.record import StarCatalog, direction_from_angles
from render.catalogue.temperature import effective_temperature

_FORMATS = {
    ".fits": "fits", ".fit": "fits", ".vot": "votable", ".votable": "votable", ".xml": "votable", ".ecsv": "ascii.ecsv",
    ".csv": "ascii.csv", ".mrt": "ascii.mrt",
}  # fmt: skip
_OUTPUT = {
    "parallax": "parallax_rad",
    "radial_velocity": "radial_velocity_km_per_s",
    "magnitude": "magnitude",
    "b_v": "b_v_mag",
}
_FEWEST_TO_JUDGE = 20


def read_catalog(
    path: str | Path,
    preset: str | ColumnPreset,
    *,
    format: str | None = None,  # the word of astropy
    readme: str | Path | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    epoch_year: float | None = None,
    magnitude_system: Literal["V", "G"] | None = None,
    **options: Any,
) -> StarCatalog:
    """Read a star catalogue from a file.

    Parameters
    ----------
    path : path
        The catalogue.
    preset : str or ColumnPreset
        "hipparcos", "gaia", "bright_star", "open_bright_star", "plain", or one's own.
    format : str, optional
        astropy's name of the format; told by the file's suffix, or by the preset.
    readme : path, optional
        ReadMe of CDS; the format is then ``ascii.cds``.
    columns, units : mapping, optional
        Meaning (`render.catalogue.presets.MEANINGS`) to the name or the unit of its column; goes before preset and
        file.
    epoch_year, magnitude_system : optional
        Where the preset does not tell, or to go before it.
    **options
        For ``astropy.table.Table.read``.

    Returns
    -------
    StarCatalog
        Rows without a position are left out and counted in ``notes``; other missing values are NaN.

    Raises
    ------
    ConfigError
        A file that cannot be read, a column that is missing, a unit of another kind, no epoch, no magnitude system.
    DomainError
        Values outside what they can be.
    """
    chosen = get_preset(preset)
    table = _read_table(Path(path), chosen, format, readme, options)
    return catalog_from_table(
        table,
        chosen,
        name=Path(path).name,
        columns=columns,
        units=units,
        epoch_year=epoch_year,
        magnitude_system=magnitude_system,
    )


def _read_table(path: Path, preset: ColumnPreset, form: str | None, readme: str | Path | None, options: Any) -> Any:
    from astropy.table import Table

    if not os.path.isfile(path):
        raise ConfigError(f"{path}: no such file; give the path of a star catalogue")
    arguments = {**preset.options, **options}
    if form is not None:
        arguments["format"] = form
    if readme is not None:
        arguments |= {"format": form or "ascii.cds", "readme": str(readme)}
    if "format" not in arguments:
        suffix = Path(path.stem).suffix if path.suffix == ".gz" else path.suffix
        if suffix.lower() not in _FORMATS:
            raise ConfigError(
                f"{path}: suffix {path.suffix!r} does not identify a format; give format=, a name of astropy"
            )
        arguments["format"] = _FORMATS[suffix.lower()]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # astropy warns of what is checked below: units, missing values
            if arguments["format"] == "fits":
                with open_fits(path) as content:
                    return Table.read(content, **arguments)
            packed = unpacked(path)
            if arguments["format"] == "votable":
                check_votable(path.read_bytes() if packed is None else packed, path)
            return Table.read(str(path) if packed is None else io.BytesIO(packed), **arguments)
    except StarbenchError:
        raise
    except Exception as error:  # astropy raises what its readers happen to raise
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ConfigError(f"{path} cannot be read as {arguments['format']}: {reason}") from None


def check_votable(content: bytes, path: Path) -> None:
    """Refuse a VOTable with data in other files, and XML entities, which may expand to any size."""
    parser = expat.ParserCreate(namespace_separator=" ")

    def start(name: str, attributes: dict[str, str]) -> None:
        if name.rpartition(" ")[2].upper() == "STREAM" and any(attribute.lower() == "href" for attribute in attributes):
            where = next(value for attribute, value in attributes.items() if attribute.lower() == "href")
            raise ConfigError(f"{path}: its data are in another file ({where[:80]!r}); fetch a file that holds them")

    def entity(*_: Any) -> None:
        raise ConfigError(f"{path}: declares XML entities, which are not allowed in a table; remove them")

    parser.StartElementHandler, parser.EntityDeclHandler = start, entity
    parser.Parse(content, True)


def catalog_from_table(
    table: Any,
    preset: str | ColumnPreset,
    *,
    name: str,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    epoch_year: float | None = None,
    magnitude_system: Literal["V", "G"] | None = None,
) -> StarCatalog:
    """A catalogue from an ``astropy.table.Table``; see `read_catalog`."""
    reader = _Columns(table, get_preset(preset), name, dict(columns or {}), dict(units or {}))
    chosen = reader.preset
    system = magnitude_system or chosen.magnitude_system
    if system is None:
        raise ConfigError(f"{name}: preset {chosen.name!r} has no magnitude system; give magnitude_system=")
    ra, dec = reader.position()
    has_position = np.isfinite(ra) & np.isfinite(dec)
    measured = {target: reader.values(meaning) for meaning, target in _OUTPUT.items()}
    if measured["magnitude"] is None:
        raise reader.missing("magnitude")
    colour = reader.values("bp_rp")
    blue, red = reader.values("bp"), reader.values("rp")
    if colour is None and blue is not None and red is not None:
        colour = blue - red
    count = len(has_position)
    nothing = np.full(count, np.nan)
    motion = [nothing if value is None else value for value in (reader.values("pm_ra"), reader.values("pm_dec"))]
    columns_of_record = {target: nothing if value is None else value for target, value in measured.items()}
    columns_of_record["bp_rp_mag"] = nothing if colour is None else colour
    given = reader.values("effective_temperature")
    by_colour = effective_temperature(columns_of_record["bp_rp_mag"], columns_of_record["b_v_mag"])
    columns_of_record["effective_temperature_k"] = (
        by_colour if given is None else np.where(np.isnan(given), by_colour, given)
    )
    identifier, notes = reader.identifiers()
    if not has_position.all():
        notes += (f"{int((~has_position).sum())} rows without a position left out",)
    if np.isnan(columns_of_record["magnitude"]).any():
        notes += (f"{int(np.isnan(columns_of_record['magnitude']).sum())} stars without a magnitude",)
    catalog = StarCatalog(
        name=name,
        source=chosen.source,
        attribution=chosen.attribution,
        epoch_year=reader.epoch(epoch_year),
        magnitude_system=system,
        id=identifier,
        direction=direction_from_angles(np.where(has_position, ra, 0.0), np.where(has_position, dec, 0.0)),
        proper_motion_rad_per_year=np.stack(motion, axis=1),
        notes=notes,
        **{target: np.where(np.isinf(value), np.nan, value) for target, value in columns_of_record.items()},
    )
    return catalog if has_position.all() else replace(catalog.select(has_position), notes=notes)


class _Columns:
    """Finds the columns of a table by what they mean, in the units of `MEANINGS`."""

    def __init__(
        self, table: Any, preset: ColumnPreset, name: str, columns: dict[str, str], units: dict[str, str]
    ) -> None:
        for meaning in (*columns, *units):
            if meaning not in MEANINGS:
                raise ConfigError(f"{name}: {meaning!r} is not a known quantity; known: {', '.join(MEANINGS)}")
        self.table, self.preset, self.name, self.columns, self.units = table, preset, name, columns, units
        self.unstated: set[str] = set()

    def find(self, meaning: str) -> Any:
        """The column, or None."""
        names = (self.columns[meaning],) if meaning in self.columns else self.preset.columns.get(meaning, ())
        for name in names:
            if name in self.table.colnames:
                return self.table[name]
        folded: dict[str, list[str]] = {}
        for name in self.table.colnames:
            folded.setdefault(name.casefold(), []).append(name)
        for name in names:
            if len(folded.get(name.casefold(), [])) == 1:
                return self.table[folded[name.casefold()][0]]
        if meaning in self.columns:
            raise ConfigError(f"{self.name} has no column {names[0]!r}; it has {', '.join(self.table.colnames[:12])}")
        return None

    def missing(self, meaning: str) -> StarbenchError:
        wanted = " or ".join(self.preset.columns.get(meaning, (meaning,)))
        return ConfigError(
            f"{self.name} has no column for {meaning} ({wanted}); it has {', '.join(self.table.colnames[:12])}; "
            f"columns={{{meaning!r}: ...}}"
        )

    def values(self, meaning: str) -> FloatArray | None:
        """Column in its unit, NaN where masked; None if there is none."""
        column = self.find(meaning)
        return None if column is None else self._numbers(column, meaning)

    def _numbers(self, column: Any, meaning: str) -> FloatArray:
        from astropy import units as astropy_units

        try:
            data = np.ma.filled(np.ma.asarray(column).astype(np.float64), np.nan)
        except (TypeError, ValueError):
            raise ConfigError(f"{self.name}: column {column.name!r} ({meaning}) does not hold numbers") from None
        if not MEANINGS[meaning]:
            return np.asarray(data)
        stated = self.units.get(meaning) or column.unit
        if not stated:
            self.unstated.add(meaning)
            stated = self.preset.units[meaning]
        try:
            factor = astropy_units.Unit(stated).to(astropy_units.Unit(MEANINGS[meaning]))
        except (ValueError, TypeError, astropy_units.UnitConversionError):
            raise ConfigError(
                f"{self.name}: column {column.name!r} ({meaning}) is in {str(stated)!r}, which is not convertible to "
                f"{MEANINGS[meaning]}; state the true one with units={{{meaning!r}: ...}}"
            ) from None
        return np.asarray(data * factor)

    def position(self) -> tuple[FloatArray, FloatArray]:
        """Right ascension and declination [rad], from numbers, sexagesimal text, or hours, minutes and seconds."""
        columns = self.find("ra"), self.find("dec")
        if columns[0] is None and self.find("ra_hour") is not None:
            return self._split_position()
        for column, meaning in zip(columns, ("ra", "dec"), strict=True):
            if column is None:
                raise self.missing(meaning)
        if columns[0].dtype.kind in "USO":
            return self._sexagesimal(columns[0], "hourangle"), self._sexagesimal(columns[1], "deg")
        ra, dec = self._numbers(columns[0], "ra"), self._numbers(columns[1], "dec")
        self._check_angles(ra, dec)
        return ra, dec

    def _split_position(self) -> tuple[FloatArray, FloatArray]:
        parts: dict[str, Any] = {}
        for meaning in ("ra_hour", "ra_minute", "ra_second", "dec_degree", "dec_minute", "dec_second"):
            parts[meaning] = self.values(meaning)
            if parts[meaning] is None:
                raise self.missing(meaning)
        sign = self.find("dec_sign")
        if sign is None:
            raise self.missing("dec_sign")
        text = np.ma.filled(np.ma.asarray(sign).astype("U2"), "+")
        south = np.where(np.char.startswith(np.char.strip(text), "-"), -1.0, 1.0)
        hours = parts["ra_hour"] + parts["ra_minute"] / 60.0 + parts["ra_second"] / 3600.0
        degrees = parts["dec_degree"] + parts["dec_minute"] / 60.0 + parts["dec_second"] / 3600.0
        return hours * (15.0 * DEG_RAD), south * degrees * DEG_RAD

    def _sexagesimal(self, column: Any, unit: str) -> FloatArray:
        from astropy import units as astropy_units
        from astropy.coordinates import Angle

        text = np.char.strip(np.ma.filled(np.ma.asarray(column).astype("U40"), ""))
        given = text != ""
        angle = np.full(len(text), np.nan)
        try:
            angle[given] = Angle(text[given], unit=astropy_units.Unit(unit)).to_value(astropy_units.rad)
        except ValueError:
            raise ConfigError(
                f"{self.name}: column {column.name!r} does not hold angles; {str(text[given][0])!r} is one"
            ) from None
        return angle

    def _check_angles(self, ra: FloatArray, dec: FloatArray) -> None:
        highest, lowest = np.nanmax(ra, initial=0.0), np.nanmin(ra, initial=0.0)
        if highest > 2.0 * math.pi * (1 + 1e-9) or lowest < -2.0 * math.pi * (1 + 1e-9):
            raise DomainError(
                f"{self.name}: ra up to {max(highest, -lowest) / DEG_RAD:g} deg; at most 360 deg is allowed; state "
                "its unit with units="
            )
        steepest = float(np.nanmax(np.abs(dec), initial=0.0))
        if steepest > math.pi / 2 * (1 + 1e-9):
            raise DomainError(
                f"{self.name}: dec up to {steepest / DEG_RAD:g} deg; at most 90 deg is allowed; state its unit "
                "with units="
            )
        if "ra" not in self.unstated or np.isfinite(ra).sum() < _FEWEST_TO_JUDGE:
            return
        raw, unit = highest / DEG_RAD, self.preset.units["ra"]
        if unit == "deg" and raw <= 2.0 * math.pi and steepest / DEG_RAD <= math.pi / 2:
            guess = "radians"
        elif unit == "deg" and raw <= 24.0 and float(np.nanmax(dec) - np.nanmin(dec)) > 60.0 * DEG_RAD:
            guess = "hours"
        else:
            return
        raise DomainError(
            f"{self.name} states no unit, and ra up to {raw:.4g} looks like {guess}, not {unit}; state the unit "
            "with units={'ra': ..., 'dec': ...}"
        )

    def epoch(self, given: float | None) -> float:
        """Julian year of the positions."""
        if given is not None:
            return float(given)
        stated = self.values("epoch")
        if stated is not None and len(stated):
            if np.nanmin(stated) != np.nanmax(stated):
                raise ConfigError(
                    f"{self.name}: epochs from {np.nanmin(stated):g} to {np.nanmax(stated):g}; a single epoch is needed"
                )
            return float(np.nanmax(stated))
        if self.preset.epoch_year is None:
            raise ConfigError(f"{self.name}: preset {self.preset.name!r} has no epoch; give epoch_year=")
        return self.preset.epoch_year

    def identifiers(self) -> tuple[NDArray[np.int64], tuple[str, ...]]:
        """Numbers of the stars; the row where there are none."""
        column = self.find("id")
        rows = np.arange(len(self.table), dtype=np.int64)
        if column is None:
            return rows, ("id: row of the file",)
        try:
            numbers = np.ma.asarray(column)
            if numbers.dtype.kind == "f":  # a gap makes a column of whole numbers one of floats
                numbers, exact = np.ma.masked_invalid(numbers), 2 ** (np.finfo(numbers.dtype).nmant + 1)
                if not (np.abs(numbers.compressed()) < exact).all() or (numbers.compressed() % 1 != 0).any():
                    raise ValueError
                numbers = np.ma.array(numbers.filled(-1.0), mask=np.ma.getmaskarray(numbers))
            return np.ma.filled(numbers.astype(np.int64), -1), ()
        except (TypeError, ValueError, OverflowError):
            fault = "does not hold whole numbers, or inexact ones (floats)"
            return rows, (f"id: row of the file, column {column.name!r} {fault}",)
