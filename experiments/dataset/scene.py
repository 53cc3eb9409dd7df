"""Common parts of the frames of a dataset: camera, stars, light of the sky, attitudes, and their simulator."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from experiments.dataset.plan import Plan, build_plan, fastest_rad_per_s, observer_of, plan_frame
from experiments.dataset.settings import DatasetConfig, SkyPointing
from experiments.laboratory.devices.scatter_laws import with_halos
from optics.errors import ConfigError, DomainError
from optics.units import ARCSEC_RAD, RAD_DEG
from render.bodies.solar_system import BODIES
from render.catalogue.motion import earth_observer
from render.catalogue.record import StarCatalog
from render.detector.displacement_damage import aged
from render.fits.wcs import LensWcs, lens_wcs
from render.motion.image_motion import image_motion
from render.sensor_file.catalogue import load_catalogue
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import Instrument, build_instrument
from render.sensor_file.tables import CatalogueConfig
from render.simulator import MARGIN_PX, SkySimulator
from render.sky.field import SkyField
from render.sky.sky import Sky, load_sky
from render.sky.star_light import StarLight
from render.sky.zodiacal import CLOSEST_DEG

MAX_CHECKED_FRAMES = 10_000
"""Frames whose attitude is checked before rendering; a longer sequence is checked at its start."""
JITTER_SIGMA = 5.0
"""Jitter amplitude in standard deviations, for the margin of the star field."""
MAX_ANNEALING_S = 5e6
"""Annealing time of a dose accumulated over years: the end of the published curve
(`render.detector.displacement_damage`)."""
SUN_MARGIN_DEG = 0.5
"""Margin for the motion during an exposure, to the least solar elongation of the zodiacal light."""
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
"""Rows of the truth up to this ``star_id`` are bodies of the solar system; ids of stars are above it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DatasetScene:
    """Common data of the frames of a dataset; from `build_scene`."""

    config: DatasetConfig
    instrument: Instrument  # Camera and detector, restricted to the read-out window
    simulator: SkySimulator  # Stars to the magnitude limit, bodies, diffuse light
    row: NDArray[np.int64]  # (n,) Rows of the rendered stars in the full catalogue
    plan: Plan
    wcs: LensWcs  # World coordinates, fitted to chief rays at the mean of the wavelength nodes

    @property
    def sky(self) -> Sky:
        """Stars at the epoch of the frames."""
        return self.simulator.sky

    @property
    def catalogue(self) -> StarCatalog:
        """Stars at the epoch of their catalogue."""
        return self.sky.catalog

    @property
    def light(self) -> StarLight:
        """Photons of stars by magnitude and temperature, in the passband."""
        return self.simulator.light

    @property
    def faintest_mag(self) -> float:
        """Faintest rendered star: the requested magnitude, or the catalogue's faintest."""
        faintest = float(np.ceil(100.0 * self.catalogue.magnitude.max()) / 100.0)
        return min(self.config.catalogue.faintest_mag, faintest)

    @property
    def field_deg(self) -> tuple[float, float]:
        """Field of view along columns and rows, at the scale of the boresight."""
        camera = self.instrument.camera
        return self.wcs.field_deg(camera.width_px, camera.height_px)


def build_scene(config: DatasetConfig) -> DatasetScene:
    """Read all input files, and refuse settings that cannot be rendered."""
    instrument = build_instrument(config.instrument)
    try:
        instrument.check_field()
    except DomainError as error:
        raise DomainError(f"instrument.width_px, instrument.height_px: {error}") from None
    instrument = _irradiated(instrument, config)
    instrument = replace(instrument, camera=with_halos(instrument.camera, config.scatter, config.contamination))
    plan = build_plan(config, instrument.detector.height_px, instrument.diagonal_deg)
    catalogue = load_catalogue(config.catalogue)
    rows = np.flatnonzero(catalogue.magnitude <= config.catalogue.faintest_mag)
    if not len(rows):
        raise DomainError(_no_star_message(catalogue, config.catalogue))
    sky = load_sky(
        catalogue,
        faintest_mag=config.catalogue.faintest_mag,
        epoch_year=config.catalogue.epoch_year,
        observer=observer_of(config),
        temperature=config.catalogue.temperature,
    )
    simulator = _simulator(config, instrument, sky, plan)
    scene = DatasetScene(
        config=config,
        instrument=instrument,
        simulator=simulator,
        row=rows,
        plan=plan,
        wcs=lens_wcs(instrument.camera, wavelength_nm=float(simulator.light.wavelength_nm.mean())),
    )
    _check_temperatures(scene)
    _check_stars(scene)
    if config.background.zodiacal:
        _check_sun(scene)
    return scene


def _simulator(config: DatasetConfig, instrument: Instrument, sky: Sky, plan: Plan) -> SkySimulator:
    background, radiation = config.background, config.radiation
    for key in ("moon_planets", "stray_light"):
        if getattr(background, key) and sky.observer is None:
            raise ConfigError(f"background.{key} needs an observer; set catalogue.observer = earth")
    bodies = BODIES if background.earth_distance_km is None else (*BODIES, "earth")
    return SkySimulator(
        instrument,
        sky,
        exposure_s=config.instrument.exposure_s,
        line_time_s=config.instrument.line_time_us * 1e-6,
        passband=open_band(config.passband, instrument),
        nodes=config.nodes,
        temperature_c=config.instrument.chip_temperature_c,
        background_e_per_s=background.extra_e_per_s,
        zodiacal=background.zodiacal,
        uniform=background.uniform_mag_per_arcsec2,
        seed=plan.streams.child("detector"),
        bodies=bodies if background.moon_planets else (),
        stray_light=background.stray_light or None,
        ghosts=background.ghosts,
        detector_reflectance=config.scatter.detector_reflectance,
        cosmic_rays=None if radiation.environment == "none" else radiation.environment,
        silicon_depth_um=radiation.depth_um,
        margin_px=MARGIN_PX + _checked_displacement_px(plan, instrument),
        tolerance=config.pupil_tolerance,
        by_grid=True,
    )


def _irradiated(instrument: Instrument, config: DatasetConfig) -> Instrument:
    """The instrument with the displacement damage of its detector."""
    radiation = config.radiation
    if not radiation.displacement_dose_tev_per_g:
        return instrument
    detector = aged(
        instrument.detector,
        displacement_dose_tev_per_g=radiation.displacement_dose_tev_per_g,
        depleted_volume_um3=radiation.depleted_volume_um3,
        temperature_c=config.instrument.chip_temperature_c,
        annealed_s=MAX_ANNEALING_S,
    )
    return replace(instrument, detector=detector)


def stars_of(scene: DatasetScene, frame: int) -> SkyField:
    """Stars in the field at mid-exposure; `SkyField.row` are rows of ``scene.sky``."""
    return scene.sky.field(scene.simulator.view, plan_frame(scene.plan, frame).attitude)


def _no_star_message(catalogue: StarCatalog, config: CatalogueConfig) -> str:
    magnitude = catalogue.magnitude[np.isfinite(catalogue.magnitude)]
    if not len(magnitude):
        return f"catalogue {catalogue.name} has no magnitude for any of its {len(catalogue)} stars; name another column"
    return (
        f"catalogue.faintest_mag = {config.faintest_mag:g}: the brightest star of catalogue {catalogue.name} has "
        f"{magnitude.min():.2f} mag; raise it"
    )


def _check_temperatures(scene: DatasetScene) -> None:
    """Refuse stars too cold or too hot for the pass band, before rendering."""
    catalogue, temperature_k = scene.catalogue, scene.sky.temperature_k
    for star in (np.argmin(temperature_k), np.argmax(temperature_k)):
        try:
            scene.light.photon_rate(catalogue.magnitude[[star]], temperature_k[[star]])
        except DomainError as error:
            raise DomainError(f"catalogue {catalogue.name}, star {catalogue.id[star]}: {error}") from None


def _checked_displacement_px(plan: Plan, instrument: Instrument) -> float:
    """Largest displacement of a star from the middle of the exposure; refuses images that leave the frame."""
    cross_rad_per_s, roll_rad_per_s = fastest_rad_per_s(plan)
    cross_deg_per_s = cross_rad_per_s * RAD_DEG
    camera, config = instrument.camera, plan.config.instrument
    jitter_rad = np.zeros(3) if plan.jitter is None else plan.jitter.rms_arcsec * ARCSEC_RAD * JITTER_SIGMA
    motion = image_motion(
        across_rad_per_s=cross_rad_per_s,
        about_rad_per_s=roll_rad_per_s,
        jitter_rad=jitter_rad,
        exposure_s=config.exposure_s,
        duration_s=plan.duration_s,
        pixel_rad=instrument.pixel_arcsec * ARCSEC_RAD,
        size_px=(camera.width_px, camera.height_px),
    )
    if motion.trail_px > motion.most_px:
        raise DomainError(
            f"at {cross_deg_per_s:g} deg/s stars move by {motion.trail_px:.0f} px in "
            f"instrument.exposure_s = {config.exposure_s:g} s and leave the frame of {camera.width_px} x "
            f"{camera.height_px} px; at most {cross_deg_per_s * motion.most_px / motion.trail_px:.3g} deg/s is "
            "possible"
        )
    if motion.drift_px > motion.corner_px:
        raise DomainError(
            f"at {cross_deg_per_s:g} deg/s stars move by {2 * motion.drift_px:.0f} px while rows are read "
            f"(instrument.line_time_us = {config.line_time_us:g} us), more than the diagonal of "
            f"{2 * motion.corner_px:.0f} px; take a lower rate or line time"
        )
    if motion.jitter_px > motion.most_px:
        raise DomainError(
            f"jitter of {motion.jitter_px / JITTER_SIGMA:.4g} px RMS across the boresight moves stars out of the frame "
            f"of {camera.width_px} x {camera.height_px} px; lower jitter.psd_x_arcsec2_per_hz, psd_y_arcsec2_per_hz"
        )
    return motion.reach_px


def _check_stars(scene: DatasetScene) -> None:
    """Refuse a dataset without a star in any frame; single frames may be empty."""
    if isinstance(scene.config.pointing, SkyPointing) or scene.config.background.moon_planets:
        return  # random attitudes over the sky may always contain a star, and planets are point sources too
    if any(len(stars_of(scene, frame)) for frame in range(min(scene.config.frames, MAX_CHECKED_FRAMES))):
        return
    raise DomainError(
        f"no frame contains a star to catalogue.faintest_mag = {scene.config.catalogue.faintest_mag:g} mag; raise it "
        "or point elsewhere"
    )


def _check_sun(scene: DatasetScene) -> None:
    """Refuse zodiacal light for attitudes nearer to the Sun than its tables reach."""
    direction_to_sun = earth_observer(scene.config.catalogue.epoch_year).to_sun
    min_elongation_deg = CLOSEST_DEG + float(np.degrees(scene.simulator.view.radius_rad)) + SUN_MARGIN_DEG
    pointing = scene.config.pointing
    reason = f"background.zodiacal: the light within {CLOSEST_DEG:g} deg of the Sun is not known"
    if isinstance(pointing, SkyPointing):
        if pointing.sun_exclusion_deg < min_elongation_deg:
            raise DomainError(f"{reason}; set pointing.sun_exclusion_deg to at least {np.ceil(min_elongation_deg):g}")
        return
    for frame in range(min(scene.config.frames, MAX_CHECKED_FRAMES)):
        boresight = plan_frame(scene.plan, frame).attitude.as_matrix()[2]
        elongation_deg = float(np.degrees(np.arccos(np.clip(boresight @ direction_to_sun, -1.0, 1.0))))
        if elongation_deg < min_elongation_deg:
            raise DomainError(
                f"{reason}, frame {frame} looks {elongation_deg:.1f} deg from it and its corners "
                f"{min_elongation_deg - CLOSEST_DEG:.1f} deg farther; change catalogue.epoch_year, the attitudes, "
                "or leave it out"
            )
