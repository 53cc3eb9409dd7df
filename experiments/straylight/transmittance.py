"""Transmittance of the configured sensor: scatter laws, lens, baffle, and variants of dust."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from experiments.harness.system import prompt_pool
from experiments.laboratory.devices.scatter_laws import dust_law, surface_laws
from experiments.straylight.settings import StraylightConfig
from optics.errors import DomainError
from optics.glass.coating import QuarterWave
from optics.lens.system import LensSystem
from optics.rays.ghosts import entrance_radius_mm
from optics.rays.surface_scatter import ScatterLaw, scattering_surfaces
from render.baffle.configured import configured_baffle, configured_coating
from render.baffle.light import BaffleScene
from render.baffle.transmittance import (
    LensTransmittance,
    SensorTransmittance,
    corner_field_deg,
    lens_transmittance,
    sensor_transmittance,
)
from render.baffle.vaned_baffle import VanedBaffle
from render.sensor_file.instrument import Instrument
from render.sensor_file.stray import BaffleConfig

VARIANT_LEVELS = (100.0, 500.0, 1000.0)
"""Cleanliness levels of the first surface in the variants of dust."""


def _laws(config: StraylightConfig, lens: LensSystem) -> dict[str, dict[int, ScatterLaw]]:
    configured = surface_laws(lens, config.scatter, config.contamination)
    laws: dict[str, dict[int, ScatterLaw]] = {
        name: {number: law.bsdf for number, law in by_surface.items()} for name, by_surface in configured.items()
    }
    first = scattering_surfaces(lens)[0]
    for level in VARIANT_LEVELS if config.what_if else ():
        laws[f"dust {level:g}"] = laws["dust"] | {first: dust_law(lens, level, config.contamination).bsdf}
    return laws


def bare_lens(config: StraylightConfig, instrument: Instrument, advance: Callable[[], None]) -> LensTransmittance:
    """Ghosts and scatter of the lens for all directions of the source."""
    camera, setting = instrument.camera, config.pst
    lens = camera.focused_lens
    fitted = configured_baffle(config.baffle, entrance_mm=entrance_radius_mm(lens), field_deg=_field_deg(instrument))

    coating_nm = config.instrument.coating_nm
    with prompt_pool() as pool:
        return lens_transmittance(
            camera,
            instrument.focal_length_mm,
            _laws(config, lens),
            setting.angles_deg,
            setting.azimuths_deg,
            points=setting.points,
            pupil=(setting.rings, setting.arms),
            ghost_rays=(setting.ghost_rings, setting.ghost_arms),
            detector_reflectance=config.scatter.detector_reflectance,
            shade_deg=fitted.shade_deg
            if isinstance(fitted, VanedBaffle)
            else 90.0,  # a mesh may be sunlit at any angle
            each=pool.map,
            advance=advance,
            coating=QuarterWave(design_wavelength_nm=coating_nm) if coating_nm else None,
            absorption=config.instrument.absorption,
        )


def _field_deg(instrument: Instrument) -> float:
    return corner_field_deg(instrument.camera, instrument.focal_length_mm)


def baffle_scene(
    config: StraylightConfig, baffle: BaffleConfig, entrance_mm: float, field_deg: float
) -> BaffleScene | None:
    """Scene of a baffle for its illumination; None for a bare lens."""
    parts = configured_baffle(baffle, entrance_mm=entrance_mm, field_deg=field_deg)
    if parts is None:
        return None
    coating = configured_coating(baffle)
    try:
        return BaffleScene(parts, coating, entrance_mm=entrance_mm, field_deg=field_deg, seed=config.seed)
    except DomainError as fault:
        raise DomainError(f"baffle: {fault}") from None


def check_baffle(config: StraylightConfig, instrument: Instrument) -> None:
    """Early checks: refuse a lens without surfaces, an open mesh, vanes that cut the beam of the field."""
    lens = instrument.camera.focused_lens
    lens.check_surfaces()
    if not scattering_surfaces(lens):
        raise DomainError(
            f"lens {lens.name!r} has no surfaces that reflect or scatter; take a lens file, or a table: pst.file"
        )
    baffle_scene(config, config.baffle, entrance_radius_mm(lens), _field_deg(instrument))


def behind_baffle(
    config: StraylightConfig,
    lens: LensTransmittance,
    baffle: BaffleConfig,
    *,
    dust: str = "dust",
    chosen: Sequence[int] | None = None,
    advance: Callable[[], None] = lambda: None,
) -> SensorTransmittance:
    """All causes of a lens behind a baffle; ``dust``: name of its dust law, ``chosen``: indices of the angles."""
    return sensor_transmittance(
        lens,
        baffle_scene(config, baffle, lens.entrance_mm, lens.field_deg),
        dust=dust,
        chosen=chosen,
        error=config.pst.walls_error,
        source=f"starbench straylight, {config.name or 'as configured'}",
        advance=advance,
    )
