"""Common parts of the frames of a dataset, without the renderer: camera, stars, light of the sky, attitudes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.dataset.plan import (
    FramePlan,
    Plan,
    build_plan,
    fastest_rad_per_s,
    observer_of,
    plan_frame,
    sun_direction,
)
from experiments.dataset.settings import BackgroundConfig, Config, SkyPointing
from experiments.laboratory.devices.scatter_laws import with_halos
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.light.band import Band
from optics.records import freeze
from optics.units import ARCSEC_RAD
from render.bodies.solar_system import BODIES, SolarSystem, joined, planet_field, solar_system
from render.bodies.stray_light import StrayLight, band_light
from render.camera import Camera
from render.catalogue.index import SkyIndex, build_index
from render.catalogue.motion import Observer
from render.catalogue.record import StarCatalog
from render.catalogue.temperature import star_temperature
from render.detector.radiation import aged
from render.detector.spec import Detector
from render.fits.wcs import LensWcs, lens_wcs
from render.records import StarField
from render.sensor_file.catalogue import load_catalogue
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import Instrument, build_instrument
from render.sensor_file.tables import CatalogueConfig
from render.sky.background import BackgroundMap, UniformSky, background_map, sky_background
from render.sky.field import FieldOfView, SkyField, field_of, field_of_view
from render.sky.star_light import StarLight, star_light
from render.sky.zodiacal import CLOSEST_DEG

if TYPE_CHECKING:
    from render.bodies.body_image import BodyImage, BodyRenderer


MARGIN_PX = 16.0
SEARCHED_FRAMES = 10_000
JITTER_SIGMA = 5.0
LONGEST_ANNEALED_S = 5e6
"""A dose that comes over years has annealed all along: the end of the published curve (`render.detector.radiation`)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Common data of the frames of a dataset; made by `build_scene`."""

    config: Config  # The configuration
    instrument: Instrument  # Camera and detector, cut to the window
    catalogue: SkyIndex  # Stars that are bright enough, with their search tree
    row: NDArray[np.int64]  # (n,) Their rows in the whole catalogue
    temperature_k: FloatArray  # (n,) Temperatures of the black bodies that stand for them
    view: FieldOfView  # What the camera sees
    light: StarLight  # The pass band
    plan: Plan  # Attitudes and motions
    observer: Observer | None  # Where the camera is
    wcs: LensWcs  # World coordinates, fitted to chief rays at the mean of the wavelength nodes
    sky_light: SkyLight  # Light that is no star

    @property
    def faintest_mag(self) -> float:
        """Faintest rendered star: the requested magnitude, or the catalogue's faintest."""
        faintest = float(np.ceil(100.0 * self.catalogue.catalog.magnitude.max()) / 100.0)
        return min(self.config.catalogue.faintest_mag, faintest)

    @property
    def diagonal_deg(self) -> float:
        """Diagonal of the field of view."""
        return _diagonal_deg(self.instrument)

    @property
    def field_deg(self) -> tuple[float, float]:
        """Field of view along columns and rows, at the scale of the boresight."""
        scale, camera = np.sqrt(abs(np.linalg.det(self.wcs.linear))), self.instrument.camera
        wide, high = np.degrees(2.0 * np.arctan(scale * np.array([camera.width_px, camera.height_px]) / 2.0))
        return float(wide), float(high)


def build_scene(config: Config) -> Scene:
    """Read and prepare everything, and refuse what cannot become a dataset."""
    instrument = build_instrument(config.instrument)
    try:
        instrument.check_field()
    except DomainError as error:
        raise DomainError(f"instrument.width_px, instrument.height_px: {error}") from None
    instrument = _aged(instrument, config)
    instrument = replace(instrument, camera=with_halos(instrument.camera, config.scatter, config.contamination))
    band = open_band(config.passband, instrument)
    plan = build_plan(config, instrument.detector.height_px, _diagonal_deg(instrument))
    whole = load_catalogue(config.catalogue)
    bright = np.flatnonzero(whole.magnitude <= config.catalogue.faintest_mag)
    if not len(bright):
        raise DomainError(_no_star(whole, config.catalogue))
    catalogue = whole.select(bright)
    light = star_light([band], nodes=config.nodes, magnitude_system=whole.magnitude_system)
    observer = observer_of(config)
    pixel_rad = instrument.pixel_arcsec * ARCSEC_RAD
    scene = Scene(
        config=config,
        instrument=instrument,
        catalogue=build_index(catalogue),
        row=bright,
        temperature_k=star_temperature(catalogue, config.catalogue.temperature),
        view=field_of_view(instrument.camera, margin_px=MARGIN_PX + _path_px(plan, instrument)),
        light=light,
        plan=plan,
        observer=observer,
        wcs=lens_wcs(instrument.camera, wavelength_nm=float(light.wavelength_nm.mean())),
        sky_light=build_sky_light(
            config, instrument.camera, band, pixel_rad=pixel_rad, observer=observer, detector=instrument.detector
        ),
    )
    _check_light(scene)
    _check_stars(scene)
    if config.background.zodiacal:
        to_sun = sun_direction(config.catalogue.epoch_year)
        check_sun(plan, to_sun, scene.view, min(config.frames, SEARCHED_FRAMES))
    return scene


def _aged(instrument: Instrument, config: Config) -> Instrument:
    """The instrument with what radiation has done to its detector."""
    radiation = config.radiation
    if not radiation.displacement_dose_tev_per_g:
        return instrument
    detector = aged(
        instrument.detector,
        displacement_dose_tev_per_g=radiation.displacement_dose_tev_per_g,
        depleted_volume_um3=radiation.depleted_volume_um3,
        temperature_c=config.instrument.chip_temperature_c,
        annealed_s=LONGEST_ANNEALED_S,
    )
    return replace(instrument, detector=detector)


def stars_of(scene: Scene, frame: int) -> SkyField:
    """Stars that a frame sees in the middle of its exposure; `SkyField.row` counts in ``scene.catalogue``."""
    return seen_at(scene, plan_frame(scene.plan, frame).attitude)


def seen_at(scene: Scene, attitude: Rotation) -> SkyField:
    """Stars that are seen in an attitude cam from icrs."""
    return field_of(
        scene.catalogue, scene.view, attitude, epoch_year=scene.config.catalogue.epoch_year, observer=scene.observer
    )


def _diagonal_deg(instrument: Instrument) -> float:
    camera = instrument.camera
    half_mm = 0.5 * camera.pixel_pitch_mm * np.hypot(camera.width_px, camera.height_px)
    return float(np.degrees(2.0 * np.arctan(half_mm / instrument.focal_length_mm)))


def _no_star(catalogue: StarCatalog, config: CatalogueConfig) -> str:
    known = catalogue.magnitude[np.isfinite(catalogue.magnitude)]
    if not len(known):
        return f"catalogue {catalogue.name} has no magnitude for any of its {len(catalogue)} stars; name another column"
    return (
        f"catalogue.faintest_mag = {config.faintest_mag:g}: the brightest star of catalogue {catalogue.name} has "
        f"{known.min():.2f} mag; raise it"
    )


def _check_light(scene: Scene) -> None:
    """Refuse stars that cannot be rendered now, not in the middle of the work."""
    coldest, hottest = np.argmin(scene.temperature_k), np.argmax(scene.temperature_k)
    for at in (coldest, hottest):
        try:
            scene.light.photon_rate(scene.catalogue.catalog.magnitude[[at]], scene.temperature_k[[at]])
        except DomainError as error:
            number = scene.catalogue.catalog.id[at]
            raise DomainError(f"catalogue {scene.catalogue.catalog.name}, star {number}: {error}") from None


def _path_px(plan: Plan, instrument: Instrument) -> float:
    """Largest distance of a star from its place in the middle of the exposure [px]."""
    across, about = fastest_rad_per_s(plan)
    camera = instrument.camera
    pixel_rad = instrument.pixel_arcsec * ARCSEC_RAD
    smallest_px = min(camera.width_px, camera.height_px)
    exposure_s = plan.config.instrument.exposure_s
    if across * exposure_s / pixel_rad > 0.5 * smallest_px:
        raise DomainError(
            f"at {np.degrees(across):g} deg/s stars move by {across * exposure_s / pixel_rad:.0f} px in "
            f"instrument.exposure_s = {exposure_s:g} s and leave the frame of {camera.width_px} x {camera.height_px} "
            f"px; at most {np.degrees(0.5 * smallest_px * pixel_rad / exposure_s):.3g} deg/s is possible"
        )
    corner_px = 0.5 * float(np.hypot(camera.width_px, camera.height_px))
    moved_px = 0.5 * plan.duration_s * across / pixel_rad
    if moved_px > corner_px:
        raise DomainError(
            f"at {np.degrees(across):g} deg/s stars move by {2 * moved_px:.0f} px while rows are read "
            f"(instrument.line_time_us = {plan.config.instrument.line_time_us:g} us), more than the diagonal of "
            f"{2 * corner_px:.0f} px; take a lower rate or line time"
        )
    shaken = np.zeros(3) if plan.jitter is None else plan.jitter.rms_arcsec * ARCSEC_RAD * JITTER_SIGMA
    shaken_px = float(np.hypot(shaken[0], shaken[1])) / pixel_rad
    if shaken_px > 0.5 * smallest_px:
        raise DomainError(
            f"jitter of {shaken_px / JITTER_SIGMA:.4g} px RMS across the boresight moves stars out of the frame of "
            f"{camera.width_px} x {camera.height_px} px; lower jitter.psd_x_arcsec2_per_hz, psd_y_arcsec2_per_hz"
        )
    # a turn about the boresight brings in no star from farther than the corners
    rolled_px = min((0.5 * plan.duration_s * about + float(shaken[2])) * corner_px, corner_px - 0.5 * smallest_px)
    return moved_px + shaken_px + rolled_px


def _check_stars(scene: Scene) -> None:
    """Refuse a dataset of which no frame sees a star; single empty frames are frames of an empty sky."""
    if isinstance(scene.config.pointing, SkyPointing) or scene.config.background.moon_planets:
        return  # some frame of a random sky may always see one; planets are points of light too
    for frame in range(min(scene.config.frames, SEARCHED_FRAMES)):
        if len(stars_of(scene, frame)):
            return
    raise DomainError(
        f"no frame contains a star to catalogue.faintest_mag = {scene.config.catalogue.faintest_mag:g} mag; raise it "
        "or point elsewhere"
    )


# --- Light that is no star: zodiacal light, a uniform sky, the Moon and the planets

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
    """Sky light common to all frames; made by `build_sky_light`."""

    config: BackgroundConfig  # What was asked for
    diffuse: BackgroundMap | None  # Etendue of every pixel; None without zodiacal light and uniform sky
    points: SolarSystem | None  # Bodies smaller and larger than a pixel
    disks: SolarSystem | None
    light: StarField | None  # The points, with their light
    bands: tuple[Band, ...]  # The pass band
    stray: StrayLight | None = None  # Of Sun, Moon and Earth


def build_sky_light(
    config: Config, camera: Camera, band: Band, *, pixel_rad: float, observer: Observer | None, detector: Detector
) -> SkyLight:
    """Prepare the light of the sky."""
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
    stray = None
    if background.stray_light:
        if observer is None:
            raise ConfigError("background.stray_light needs an observer; set catalogue.observer = earth")
        stray = StrayLight(
            background.stray_light,
            band_light(detector, band),
            observer=observer,
            epoch_year=config.catalogue.epoch_year,
            earth=background.earth_distance_km is not None,
            ghosts=background.ghosts,
        )
    return SkyLight(
        config=background, diffuse=diffuse, points=points, disks=disks, light=light, bands=(band,), stray=stray
    )


def check_sun(plan: Plan, to_sun: FloatArray, view: FieldOfView, frames: int) -> None:
    """Refuse zodiacal light for attitudes so near the Sun that it is not known there."""
    needed = CLOSEST_DEG + float(np.degrees(view.radius_rad)) + SUN_MARGIN_DEG
    pointing = plan.config.pointing
    reason = f"background.zodiacal: the light within {CLOSEST_DEG:g} deg of the Sun is not known"
    if isinstance(pointing, SkyPointing):
        if pointing.sun_exclusion_deg < needed:
            raise DomainError(f"{reason}; set pointing.sun_exclusion_deg to at least {np.ceil(needed):g}")
        return
    for frame in range(frames):
        boresight = plan_frame(plan, frame).attitude.as_matrix()[2]
        angle = float(np.degrees(np.arccos(np.clip(boresight @ to_sun, -1.0, 1.0))))
        if angle < needed:
            raise DomainError(
                f"{reason}, frame {frame} looks {angle:.1f} deg from it and its corners {needed - CLOSEST_DEG:.1f} deg "
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


# --- Point sources that a frame sees: stars of the catalogue, and planets smaller than a pixel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointSources:
    """n point sources."""

    light: StarField  # Directions along icrs and light, as the renderer takes them
    star_id: NDArray[np.int64]  # (n,) Who they are
    catalogue_row: NDArray[np.int64]  # (n,)
    magnitude: FloatArray  # (n,) As the truth tells them
    temperature_k: FloatArray  # (n,)

    def __post_init__(self) -> None:
        sizes = {"n": len(self.light)}
        for name, kind in (("star_id", np.int64), ("catalogue_row", np.int64), ("magnitude", np.float64)):
            freeze(self, name, shape=("n",), dtype=kind, sizes=sizes)
        freeze(self, "temperature_k", shape=("n",), sizes=sizes, finite=False)

    def __len__(self) -> int:
        return len(self.light)

    @property
    def direction(self) -> FloatArray:
        """Unit vectors (n, 3) along icrs."""
        return self.light.direction


def point_sources(scene: Scene, plan: FramePlan) -> PointSources:
    """Point sources of a frame, stars in the order of the catalogue, planets behind them."""
    field = seen_at(scene, plan.attitude)
    kelvin = scene.temperature_k[field.row]
    stars = PointSources(
        light=scene.light.stars(field.direction, field.stars.magnitude, kelvin),
        star_id=field.stars.id,
        catalogue_row=scene.row[field.row],
        magnitude=field.stars.magnitude,
        temperature_k=kelvin,
    )
    planets = _planets(scene, plan)
    return stars if planets is None else _together(stars, planets)


def smear_px(scene: Scene, sources: PointSources, plan: FramePlan, row_px: FloatArray) -> FloatArray:
    """Motion (n, 2) of chief rays at the design wavelength from the start to the end of their row's exposure [px]."""
    if plan.trajectory is None or not len(sources):
        return np.zeros((len(sources), 2))
    camera = scene.config.instrument
    last = scene.instrument.camera.height_px - 1.0
    starts = plan.start_s + np.clip(np.nan_to_num(row_px), 0.0, last) * (camera.line_time_us * 1e-6)
    direction = np.array(sources.direction)
    ends = [
        scene.view.pixel_of(plan.trajectory.attitude(times).apply(direction))
        for times in (starts, starts + camera.exposure_s)
    ]
    return np.asarray(ends[1] - ends[0])


def _planets(scene: Scene, plan: FramePlan) -> PointSources | None:
    sky, view = scene.sky_light, scene.view
    if sky.points is None or sky.light is None:
        return None
    seen = np.flatnonzero(view.on_detector(view.pixel_of(sky.points.direction @ plan.attitude.as_matrix().T)))
    if not len(seen):
        return None
    light = StarField(
        direction=sky.light.direction[seen],
        wavelength_nm=sky.light.wavelength_nm,
        photon_rate=sky.light.photon_rate[seen],
        band=sky.light.band,
    )
    return PointSources(
        light=light,
        star_id=np.array([PLANET_IDS[sky.points.name[i]] for i in seen]),
        catalogue_row=np.full(len(seen), -1),
        magnitude=sky.points.magnitude_v[seen],
        temperature_k=np.full(len(seen), np.nan),
    )


def _together(first: PointSources, second: PointSources) -> PointSources:
    columns = ("star_id", "catalogue_row", "magnitude", "temperature_k")
    both = {name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in columns}
    return PointSources(light=joined(first.light, second.light), **both)
