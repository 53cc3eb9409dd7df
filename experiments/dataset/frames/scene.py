"""All that frames of a dataset have in common, without the renderer: camera, stars, light, attitudes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.dataset.frames.plan import Plan, build_plan, fastest_rad_per_s, observer_of, plan_frame, sun_direction
from experiments.dataset.frames.sky_light import SkyLight, build_sky_light, check_sun
from experiments.dataset.settings import Config, SkyPointing
from experiments.laboratory.catalogue import load_catalogue
from experiments.laboratory.filter_wheel import open_band
from experiments.laboratory.instrument import Instrument, build_instrument
from experiments.laboratory.settings import CatalogueConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import ARCSEC_RAD
from render.catalogue.index import SkyIndex, build_index
from render.catalogue.motion import Observer
from render.catalogue.record import StarCatalog
from render.catalogue.temperature import star_temperature
from render.detector.radiation import aged
from render.fits.wcs import LensWcs, lens_wcs
from render.sky.field import FieldOfView, SkyField, StarLight, field_of, field_of_view, star_light

__all__ = ["Scene", "build_scene", "seen_at", "stars_of"]


MARGIN_PX = 16.0
SEARCHED_FRAMES = 10_000
JITTER_SIGMA = 5.0
LONGEST_ANNEALED_S = 5e6
"""A dose that comes over years has annealed all along: the end of the published curve (`render.detector.radiation`)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """What every frame of a dataset needs; made by `build_scene`."""

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
        """Faintest star that is rendered: what was asked for, or where the catalogue ends."""
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
        sky_light=build_sky_light(config, instrument.camera, band, pixel_rad=pixel_rad, observer=observer),
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
        scene.catalogue,
        scene.view,
        attitude,
        epoch_year=scene.config.catalogue.epoch_year,
        observer=scene.observer,
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
    """How far a star may be from where it is in the middle of the exposure [px]."""
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
            f"jitter of {shaken_px / JITTER_SIGMA:.4g} px RMS across the boresight throws stars out of the frame of "
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
        f"no frame sees a star to catalogue.faintest_mag = {scene.config.catalogue.faintest_mag:g} mag; raise it or "
        "point elsewhere"
    )
