"""Light of a frame that is no star: zodiacal light, a uniform sky, the Moon and the planets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.dataset.frames.plan import FramePlan, Plan, plan_frame
from experiments.dataset.settings import BackgroundConfig, Config, SkyPointing
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.light.band import Band
from render.bodies.solar_system import BODIES, SolarSystem, planet_field, solar_system
from render.camera import Camera
from render.catalogue.motion import Observer
from render.records import StarField
from render.sky.background import BackgroundMap, UniformSky, background_map, sky_background
from render.sky.field import FieldOfView
from render.sky.zodiacal import CLOSEST_DEG

if TYPE_CHECKING:
    from render.bodies.body_image import BodyImage, BodyRenderer

__all__ = [
    "PLANET_IDS",
    "Disk",
    "SkyLight",
    "build_sky_light",
    "check_sun",
    "diffuse_light",
    "resolved_light",
]


PLANET_IDS = {
    "mercury": -1000199,
    "venus": -1000299,
    "moon": -1000301,
    "earth": -1000399,
    "mars": -1000499,
    "jupiter": -1000599,
    "saturn": -1000699,
    "uranus": -1000799,
    "neptune": -1000899,
}
"""``star_id`` of bodies of the solar system: minus one million minus the number that JPL's NAIF gives them."""
LAST_PLANET_ID = max(PLANET_IDS.values())
RESOLVED_PX = 1.0
"""A body of a larger diameter is rendered as a disk, a smaller one is a point of light among the stars."""
SUN_MARGIN_DEG = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Disk:
    """A body that a frame shows as a disk."""

    name: str  # Which
    row: int  # Its place in `SkyLight.disks`
    image: BodyImage  # Its light in the frame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SkyLight:
    """What all frames have of it in common; made by `build_sky_light`."""

    config: BackgroundConfig  # What was asked for
    diffuse: BackgroundMap | None  # Etendue of every pixel; None without zodiacal light and uniform sky
    points: SolarSystem | None  # Bodies smaller and larger than a pixel
    disks: SolarSystem | None  # Bodies smaller and larger than a pixel
    light: StarField | None  # The points, with their light
    bands: tuple[Band, ...]  # The pass band


def build_sky_light(
    config: Config, camera: Camera, band: Band, *, pixel_rad: float, observer: Observer | None
) -> SkyLight:
    """Prepare it."""
    background = config.background
    diffuse = points = disks = light = None
    if background.zodiacal or background.uniform_mag_per_arcsec2 is not None:
        diffuse = background_map(camera, [band])
    if background.moon_planets:
        if observer is None:
            raise ConfigError("background.moon_planets needs an observer; set catalogue.observer = earth")
        seen = BODIES if background.earth_distance_km is None else (*BODIES, "earth")
        system = solar_system(config.catalogue.epoch_year, observer=observer, bodies=seen)
        large = system.angular_diameter_rad > RESOLVED_PX * pixel_rad
        disks, small = system.select(large), system.select(~large)
        points = small.select(np.isfinite(small.magnitude_v))  # the others stand beside the Sun
        light = planet_field(points, [band], nodes=config.nodes)
    return SkyLight(config=background, diffuse=diffuse, points=points, disks=disks, light=light, bands=(band,))


def check_sun(plan: Plan, to_sun: FloatArray, view: FieldOfView, frames: int) -> None:
    """Refuse zodiacal light for attitudes so near the Sun that it is not known there."""
    needed = CLOSEST_DEG + float(np.degrees(view.radius_rad)) + SUN_MARGIN_DEG
    pointing = plan.config.pointing
    said = f"background.zodiacal: the light within {CLOSEST_DEG:g} deg of the Sun is not known"
    if isinstance(pointing, SkyPointing):
        if pointing.sun_exclusion_deg < needed:
            raise DomainError(f"{said}; set pointing.sun_exclusion_deg to at least {np.ceil(needed):g}")
        return
    for frame in range(frames):
        boresight = plan_frame(plan, frame).attitude.as_matrix()[2]
        angle = float(np.degrees(np.arccos(np.clip(boresight @ to_sun, -1.0, 1.0))))
        if angle < needed:
            raise DomainError(
                f"{said}, frame {frame} looks {angle:.1f} deg from it and its corners {needed - CLOSEST_DEG:.1f} deg "
                "farther; change catalogue.epoch_year, the attitudes, or leave it out"
            )


def diffuse_light(sky: SkyLight, attitude: Rotation, config: Config) -> NDArray[np.float32] | None:
    """Electrons per second in every pixel (h, w) of zodiacal light and uniform sky; None where there is neither."""
    if sky.diffuse is None:
        return None
    magnitude = sky.config.uniform_mag_per_arcsec2
    return sky_background(
        sky.diffuse,
        attitude,
        epoch_year=config.catalogue.epoch_year,
        zodiacal=sky.config.zodiacal,
        uniform=None if magnitude is None else UniformSky(magnitude_per_arcsec2=magnitude),
    )[:, :, 0]


def resolved_light(
    sky: SkyLight, renderer: BodyRenderer, plan: FramePlan, config: Config, *, duration_s: float, full_well_e: float
) -> list[Disk]:
    """The disks that a frame sees, the nearest first; nearer ones hide what is behind them."""
    if sky.disks is None:
        return []
    images = renderer.render_system(
        sky.disks,
        plan.attitude.as_matrix(),
        turn_rad=float(np.linalg.norm(plan.rate_rad_per_s)) * duration_s,
        exposure_s=config.instrument.exposure_s,
        trajectory=plan.trajectory,
        start_s=plan.start_s,
        line_time_s=config.instrument.line_time_us * 1e-6,
        ceiling_e=full_well_e,
    )
    return [Disk(name=sky.disks.name[row], row=row, image=image) for row, image in images]
