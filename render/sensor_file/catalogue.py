"""The star catalogue of a configuration."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from optics.errors import ConfigError
from render.catalogue.record import StarCatalog
from render.sensor_file.tables import CatalogueConfig


def load_catalogue(config: CatalogueConfig) -> StarCatalog:
    """The configured catalogue."""
    if config.source == "gaia":
        return _gaia(config.epoch_year != 2016.0)  # that of the package: no star moves
    from render.catalogue.read import read_catalog

    system = None if config.magnitude_system == "preset" else config.magnitude_system
    try:
        return read_catalog(Path(config.source), config.preset, magnitude_system=system)
    except ConfigError as error:
        if "magnitude_system=" not in str(error):
            raise
        raise ConfigError(
            f"catalogue.preset = {config.preset!r} has no magnitude system; set catalogue.magnitude_system to V or G"
        ) from None


@cache
def _gaia(motions: bool) -> StarCatalog:
    from render.catalogue.gaia import load_gaia

    return load_gaia(motions=motions)
