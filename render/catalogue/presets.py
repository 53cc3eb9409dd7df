"""Column names and default units of well-known star catalogues."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from optics.errors import ConfigError, unknown_name

MEANINGS: Mapping[str, str] = {
    "id": "", "ra": "rad", "dec": "rad", "pm_ra": "rad / yr", "pm_dec": "rad / yr", "parallax": "rad",
    "radial_velocity": "km / s", "magnitude": "mag", "bp_rp": "mag", "b_v": "mag", "bp": "mag", "rp": "mag",
    "effective_temperature": "K", "epoch": "yr", "ra_hour": "h", "ra_minute": "min", "ra_second": "s",
    "dec_sign": "", "dec_degree": "deg", "dec_minute": "arcmin", "dec_second": "arcsec",
}  # fmt: skip
"""Quantities of columns, with the unit that they are converted to; proper motion in ra holds the factor cos dec."""

_USUAL_UNITS = {**MEANINGS, "ra": "deg", "dec": "deg", "pm_ra": "mas / yr", "pm_dec": "mas / yr", "parallax": "mas"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnPreset:
    """Columns and units of a catalogue."""

    # name, source, attribution: What it is and whom to name
    name: str
    source: str
    attribution: str = ""
    epoch_year: float | None = None  # Julian year of positions; None where it must be given or stands in a column
    magnitude_system: Literal["V", "G"] | None = None  # Scale of the magnitudes; None where it must be given
    # Meaning (`MEANINGS`) to the names that a column may have, the first found counts; case matters only where two
    # columns differ in nothing else
    columns: Mapping[str, tuple[str, ...]]
    # Meaning to the unit of a column for which the file states none
    units: Mapping[str, str] = field(default_factory=dict)
    # For ``astropy.table.Table.read``: format, positions of columns
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for meaning in (*self.columns, *self.units):
            if meaning not in MEANINGS:
                raise unknown_name("meaning of a column", meaning, MEANINGS)
        object.__setattr__(self, "units", {**_USUAL_UNITS, **self.units})


_OPEN_BRIGHT_STAR = {
    "id": (1, 6), "ra": (45, 12), "dec": (59, 13), "parallax": (73, 7), "pm_ra": (81, 8), "pm_dec": (90, 8),
    "radial_velocity": (99, 7), "magnitude": (148, 5), "b_v": (169, 6),
}  # fmt: skip
"""First character, counted from 1, and width of the fields, as its ReadMe states them."""

_HIPPARCOS = {
    "id": ("HIP",), "ra": ("RAICRS", "RAdeg", "ra"), "dec": ("DEICRS", "DEdeg", "de"), "pm_ra": ("pmRA", "pm_ra"),
    "pm_dec": ("pmDE", "pm_de"), "parallax": ("Plx",), "magnitude": ("Vmag",), "b_v": ("B-V", "b_v"),
}  # fmt: skip
_GAIA = {
    "id": ("source_id", "Source"), "ra": ("ra", "RA_ICRS"), "dec": ("dec", "DE_ICRS"), "pm_ra": ("pmra", "pmRA"),
    "pm_dec": ("pmdec", "pmDE"), "parallax": ("parallax", "Plx"), "radial_velocity": ("radial_velocity", "RV"),
    "magnitude": ("phot_g_mean_mag", "Gmag"), "bp_rp": ("bp_rp", "BP-RP"), "bp": ("phot_bp_mean_mag", "BPmag"),
    "rp": ("phot_rp_mean_mag", "RPmag"), "effective_temperature": ("teff_gspphot", "Teff"), "epoch": ("ref_epoch",),
}  # fmt: skip
_BRIGHT_STAR = {
    "id": ("HR",), "ra": ("RAJ2000",), "dec": ("DEJ2000",), "ra_hour": ("RAh",), "ra_minute": ("RAm",),
    "ra_second": ("RAs",), "dec_sign": ("DE-",), "dec_degree": ("DEd",), "dec_minute": ("DEm",), "dec_second": ("DEs",),
    "pm_ra": ("pmRA",), "pm_dec": ("pmDE",), "parallax": ("Parallax",), "radial_velocity": ("RadVel",),
    "magnitude": ("Vmag",), "b_v": ("B-V",),
}  # fmt: skip
_PRESETS = {
    preset.name: preset
    for preset in (
        ColumnPreset(
            name="hipparcos",
            source="The Hipparcos Catalogue, ESA SP-1200 (1997), CDS I/239",
            attribution="ESA Hipparcos",
            epoch_year=1991.25,
            magnitude_system="V",
            columns=_HIPPARCOS,
        ),
        ColumnPreset(
            name="gaia",
            source="Gaia DR3, Gaia Collaboration, A&A 674, A1 (2023); CDS I/355",
            attribution="ESA/Gaia/DPAC, CC BY-SA 3.0 IGO",
            epoch_year=2016.0,
            magnitude_system="G",
            columns=_GAIA,
        ),
        ColumnPreset(
            name="bright_star",
            source="The Bright Star Catalogue, 5th ed., D. Hoffleit and W. H. Warren (1991), CDS V/50; FK5 of J2000, "
            "taken for icrs",
            epoch_year=2000.0,
            magnitude_system="V",
            columns=_BRIGHT_STAR,
            units={"pm_ra": "arcsec / yr", "pm_dec": "arcsec / yr", "parallax": "arcsec"},
        ),
        ColumnPreset(
            name="open_bright_star",
            source="os-bright-star-catalog-hip, public domain: Hipparcos-2, van Leeuwen, A&A 474, 653 (2007), with ESA "
            "SP-1200 (1997) and others",
            epoch_year=1991.25,
            magnitude_system="V",
            columns={meaning: (meaning,) for meaning in _OPEN_BRIGHT_STAR},
            units={"ra": "rad", "dec": "rad"},
            options={
                "format": "ascii.fixed_width_no_header",
                "names": tuple(_OPEN_BRIGHT_STAR),
                "col_starts": tuple(first - 1 for first, _ in _OPEN_BRIGHT_STAR.values()),
                "col_ends": tuple(first + width - 2 for first, width in _OPEN_BRIGHT_STAR.values()),
            },
        ),
        ColumnPreset(
            name="plain",
            source="columns named as starbench names them",
            columns={meaning: (meaning,) for meaning in MEANINGS},
        ),
    )
}


def preset_names() -> tuple[str, ...]:
    """Names of the built-in presets."""
    return tuple(_PRESETS)


def get_preset(preset: str | ColumnPreset) -> ColumnPreset:
    """Preset by name, or the one handed in."""
    if isinstance(preset, ColumnPreset):
        return preset
    if not isinstance(preset, str):
        raise ConfigError(f"preset {preset!r}: a name ({', '.join(_PRESETS)}) or a ColumnPreset is needed")
    if preset not in _PRESETS:
        raise unknown_name("column preset", preset, _PRESETS)
    return _PRESETS[preset]
