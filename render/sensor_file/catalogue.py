"""The star catalogue of a configuration."""

from __future__ import annotations

from pathlib import Path

from optics.errors import ConfigError
from render.catalogue.record import StarCatalog
from render.sensor_file.tables import CatalogueConfig
from render.sky.sky import EPOCH_YEAR, built_in_catalogue


def load_catalogue(config: CatalogueConfig) -> StarCatalog:
    """The configured catalogue."""
    if config.source == "gaia":
        return built_in_catalogue(config.epoch_year != EPOCH_YEAR)
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
