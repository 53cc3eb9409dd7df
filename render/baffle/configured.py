"""Baffle and black coating of the table ``[baffle]`` of a sensor file."""

from __future__ import annotations

from optics.errors import DomainError
from render.baffle.black_coating import BlackCoating, black_coating
from render.baffle.mesh import Mesh, read_mesh
from render.baffle.vaned_baffle import VanedBaffle, vaned_baffle
from render.sensor_file.stray import BaffleConfig


def configured_coating(config: BaffleConfig) -> BlackCoating:
    """The black coating, by its name or by the numbers of the table."""
    if config.coating != "own":
        return black_coating(config.coating)
    return BlackCoating(
        name="own", diffuse=config.diffuse, specular=config.specular, roughness=config.roughness, source="settings"
    )


def configured_baffle(config: BaffleConfig, *, entrance_mm: float, field_deg: float) -> VanedBaffle | Mesh | None:
    """The baffle in front of an entrance (radius) and a field (half angle); None for a bare lens.

    `DomainError` for a baffle that cannot be built, `ConfigError` for a mesh that cannot be read.
    """
    if not config.fitted:
        return None
    if config.mesh:
        return read_mesh(config.mesh)
    try:
        return vaned_baffle(
            entrance_mm=entrance_mm,
            field_deg=field_deg,
            shade_deg=config.shade_deg if config.length_mm is None else None,
            length_mm=config.length_mm,
            depth_mm=config.vane_depth_mm,
            vanes=config.vanes,
            clearance_mm=config.clearance_mm,
            edge_mm=1e-3 * config.edge_radius_um,
        )
    except DomainError as error:
        raise DomainError(f"baffle: {error}") from None
