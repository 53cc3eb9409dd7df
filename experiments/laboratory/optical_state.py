"""Lens, pass band and detector in one state: quantities that depend neither on exposure nor on noise, computed once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from calib.measure.centroid import get_centroider
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.settings.prediction import PredictedSensorConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.light.band import Band
from optics.rays.performance import LensPerformance, lens_performance
from optics.rays.spots import Spots, trace_spots
from render.camera import Camera
from render.records import EffectivePsf
from render.sensor_file.detector import DetectorConfig, overridden
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import PARTS, Instrument, build_instrument, configured_detector, radial_field_deg
from render.sensor_file.tables import CatalogueConfig, InstrumentConfig, PassbandConfig
from render.sky.star_light import StarLight, star_light
from render.tracing.measured.images import measured_psfs
from render.tracing.psf import ray_epsf, trailed, wave_images

NODES = 6
"""Wavelengths at which the pass band is sampled."""
RAYS = (32, 64)
"""Rings and azimuths of the pupil."""
AREA_PARTS = np.linspace(0.0, 1.0, 25)
AREA_RAYS = (16, 32)
"""Fields and rays for the collecting area, which has a kink where an aperture begins to cut."""
OVERSAMPLING = 8
AZIMUTH_DEG = 22.5
"""Direction in which PSFs lie from the middle: halfway between the axes and the diagonals of the pixels."""
COLD_K, HOT_K = 3500.0, 10000.0
"""Stars whose spots are compared with that of the star that is quoted."""
AIRY_SIGMA = 0.42
"""Standard deviation of the Gaussian nearest to an Airy pattern, in wavelengths times F-number (Zhang et al. 2007,
Appl. Opt. 46, 1819, table 1: 0.21 wavelengths over the sine of the cone's half angle)."""
_LAYERS = 64
_FWHM = 2.0 * math.sqrt(2.0 * math.log(2.0))
"""Of a Gaussian, in standard deviations."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpticalState:
    """Made by `optical_state`."""

    instrument: Instrument  # Camera and detector
    band: Band  # Pass band
    light: StarLight  # Star light at its w wavelength nodes, in the magnitudes of the catalogue
    response: FloatArray  # (w,) Electrons per photon at the nodes
    share: FloatArray  # (w,) Share of each node in the electrons of the star that is quoted
    radius_px: FloatArray  # (f,) Distance of the fields from the middle of the detector
    performance: LensPerformance  # Of the focused lens at these fields
    # (a,) Distance from the middle of the detector; collecting area of the lens there for the star that is quoted
    area_radius_px: FloatArray
    area_field_deg: FloatArray  # (a,) Field angles there
    area_mm2: FloatArray
    psfs: tuple[EffectivePsf, ...]  # Of these fields, for the star that is quoted
    cold_psfs: tuple[EffectivePsf, ...]  # The same of stars of 3500 and 10 000 K
    hot_psfs: tuple[EffectivePsf, ...]
    # Width of the mean spot on the pixels, and so of the detection filter; with diffraction that of its core
    fwhm_px: float
    # (2,) From the first to the last place of a star in an exposure, in which PSFs are drawn out; columns and rows
    trail_px: FloatArray
    # (c, f) Mean of the light of stars of `temperatures_k` on the detector, radial, from that of the quoted star
    colour_px: FloatArray
    temperatures_k: FloatArray  # (c,) Increasing

    @property
    def trail_length_px(self) -> float:
        """Length of `trail_px`."""
        return float(np.hypot(*self.trail_px))

    @property
    def pixel_arcsec(self) -> float:
        """Angle of a pixel on the axis."""
        return self.instrument.pixel_arcsec

    def electrons_per_s(self, magnitude: FloatArray, temperature_k: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Electrons per second of stars (n,), at distances from the middle of the detector."""
        rate = self.light.photon_rate(magnitude, temperature_k)[:, 0] * self.response  # per mm^2
        return np.asarray(rate.sum(1) * np.interp(radius_px, self.area_radius_px, self.area_mm2))

    def colour_shift_px(self, temperature_k: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Radial shift (n,) of stars by their colour, against the star that is quoted."""
        from scipy.ndimage import map_coordinates

        t = np.interp(np.log(temperature_k), np.log(self.temperatures_k), np.arange(len(self.temperatures_k)))
        r = np.interp(radius_px, self.radius_px, np.arange(len(self.radius_px)))
        return np.asarray(map_coordinates(self.colour_px, np.stack([t, r]), order=1, mode="nearest"))


def optical_state(config: PredictedSensorConfig) -> OpticalState:
    """State of a configuration; the last ones are kept."""
    geometry = config.instrument.model_copy(
        update={
            name: InstrumentConfig.model_fields[name].default
            for name in ("exposure_s", "chip_temperature_c", "gain_dn_per_e", "line_time_us")
        }
    )
    chip = DetectorConfig(diffusion_sigma_um=config.detector.diffusion_sigma_um)
    at_rest = _state(geometry, chip, config.passband, magnitude_system(config.catalogue), config.star.temperature_k)
    turn = math.radians(config.slew.rate_deg_per_s * config.instrument.exposure_s)
    if not turn:
        return at_rest
    longest, setting, window_px = longest_trail_px(config, at_rest)
    trail_px = turn * at_rest.performance.plate_scale_mm / at_rest.instrument.camera.pixel_pitch_mm
    if trail_px > longest:
        needed = int(np.ceil(trail_px - longest + window_px)) // 2 * 2 + 1
        raise DomainError(
            f"slew.rate_deg_per_s, instrument.exposure_s: stars trail over {trail_px:.3g} px, which is too much for "
            f"{setting} {window_px} px (at least {needed}); lower rate or exposure, or choose another one"
        )
    return _moving(at_rest, trail_px, math.radians(config.slew.direction_deg))


def longest_trail_px(config: PredictedSensorConfig, at_rest: OpticalState) -> tuple[float, str, int]:
    """Longest trail in the centroider's window; the limiting setting, and its pixels."""
    setting, window_px = _window(config)
    rms_mm = float(np.nanmax(at_rest.performance.white.rms_mm()))
    return window_px - 4.0 * rms_mm / at_rest.instrument.camera.pixel_pitch_mm, setting, window_px


@lru_cache(maxsize=_LAYERS)
def _moving(state: OpticalState, length_px: float, towards_rad: float) -> OpticalState:
    """The state with PSFs that are drawn out."""
    trail_px = length_px * np.array([np.cos(towards_rad), np.sin(towards_rad)])
    psfs, cold, hot = (
        tuple(trailed(one, trail_px) for one in still) for still in (state.psfs, state.cold_psfs, state.hot_psfs)
    )
    fwhm_px = _fwhm((state.fwhm_px / _FWHM) ** 2 + length_px**2 / 24.0)
    return replace(state, trail_px=trail_px, fwhm_px=fwhm_px, psfs=psfs, cold_psfs=cold, hot_psfs=hot)


def magnitude_system(config: CatalogueConfig) -> str:
    """Scale of the magnitudes of a catalogue."""
    from render.sensor_file.catalogue import load_catalogue

    return "G" if config.source == "gaia" else load_catalogue(config).magnitude_system


@lru_cache(maxsize=_LAYERS)
def _state(
    config: InstrumentConfig,
    chip: DetectorConfig,
    passband: PassbandConfig,
    system: str,
    temperature_k: float,
) -> OpticalState:
    instrument = build_instrument(config, detector=overridden(configured_detector(config), chip))
    try:
        instrument.check_field()
    except DomainError as error:
        raise DomainError(f"instrument.width_px, instrument.height_px: {error}") from None
    camera, lens = instrument.camera, instrument.camera.focused_lens
    band = open_band(passband, instrument)
    light = _light(band, system)
    wave = light.wavelength_nm[0]
    response = camera.response_at(wave)
    share = _share(light, response, temperature_k)
    corner_px = 0.5 * float(np.hypot(camera.width_px, camera.height_px))
    radius_px, area_radius_px = (corner_px * np.array(parts) for parts in (PARTS, AREA_PARTS))
    field_deg, area_field_deg = (radial_field_deg(instrument, r) for r in (radius_px, area_radius_px))
    spots = trace_spots(lens, field_deg, np.zeros_like(field_deg), wave, order=RAYS)
    performance = lens_performance(lens, field_deg, wave, share, spots=spots)
    blur_mm = camera.lens_blur_px * camera.pixel_pitch_mm
    performance = replace(
        performance, white=performance.white.blurred(blur_mm), single=performance.single.blurred(blur_mm)
    )
    seen = trace_spots(lens, area_field_deg, np.zeros_like(area_field_deg), wave, order=AREA_RAYS)
    pitch, diffusion_px = camera.pixel_pitch_mm, camera.blur_px
    rms_px = performance.white.rms_mm() / pitch
    optics_px2 = float(np.nanmean(rms_px**2)) / 2.0 - camera.lens_blur_px**2
    reach_px = min(4.0 * float(np.nanmax(rms_px)), _farthest_mm(spots, performance.white_mm) / pitch + camera.blur_px)
    half = int(np.clip(np.ceil(reach_px) + 4, 8, 40))
    psfs_of: Callable[[FloatArray], tuple[EffectivePsf, ...]] = _psfs_by_rays(spots, camera, half)
    sigma2 = optics_px2 + diffusion_px**2 + 1.0 / 12.0
    if lens.measured is not None:
        turn = math.radians(AZIMUTH_DEG)
        along = np.tan(np.radians(field_deg))
        direction = np.stack([math.cos(turn) * along, math.sin(turn) * along, np.ones_like(along)], axis=-1)
        psfs_of = partial(measured_psfs, camera, direction, wave, oversampling=OVERSAMPLING, half_size_px=half)
    elif config.diffraction != "rays":
        images = wave_images(
            lens,
            field_deg,
            wave,
            pitch_mm=pitch,
            diffusion_px=diffusion_px,
            azimuth_deg=AZIMUTH_DEG,
            oversampling=OVERSAMPLING,
            half_size_px=half,
        )
        psfs_of = images.psfs
        sigma2 += (AIRY_SIGMA * float(share @ wave) * 1e-6 * performance.f_number / pitch) ** 2

    kelvin = np.exp(light.log_temperature[4:-4:4])
    shares = np.stack([_share(light, response, float(t)) for t in kelvin])
    area = np.nan_to_num(performance.area_mm2)
    means = np.stack([(performance.bundle_mm * s * area).sum(1) / (s * area).sum(1) for s in shares])
    return OpticalState(
        instrument=instrument,
        band=band,
        light=light,
        response=response,
        share=share,
        radius_px=radius_px,
        performance=performance,
        area_radius_px=area_radius_px,
        area_field_deg=area_field_deg,
        area_mm2=(seen.area_mm2.sum(-1) @ share) * np.cos(np.radians(area_field_deg)),
        psfs=psfs_of(share),
        cold_psfs=psfs_of(_share(light, response, COLD_K)),
        hot_psfs=psfs_of(_share(light, response, HOT_K)),
        fwhm_px=_fwhm(sigma2),
        trail_px=np.zeros(2),
        colour_px=(means - performance.white_mm) / pitch,
        temperatures_k=kelvin,
    )


@lru_cache(maxsize=8)
def _light(band: Band, system: str) -> StarLight:
    return star_light([band], nodes=NODES, magnitude_system=system)  # type: ignore[arg-type]  # "V" or "G"


def _farthest_mm(spots: Spots, middle_mm: FloatArray) -> float:
    """Of all rays that arrive, from the mean of the light of their field, which lies along x."""
    away = np.hypot(spots.rays.x - middle_mm[:, None, None], spots.rays.y)
    return float(away[spots.area_mm2 > 0.0].max(initial=0.0))


def _window(config: PredictedSensorConfig) -> tuple[str, int]:
    """Width of the centroider's window, and its setting."""
    half = None if needs_epsf(config.centroid) else getattr(get_centroider(config.centroid), "half_width_px", None)
    if half is not None and 2 * half + 1 < config.window_px:
        return f"centroid = {config.centroid} with a window of", 2 * half + 1
    return "window_px =", config.window_px


def _fwhm(sigma2: float) -> float:
    return float(np.clip(_FWHM * np.sqrt(sigma2), 0.8, 20.0))


def _share(light: StarLight, response: FloatArray, temperature_k: float) -> FloatArray:
    rate = light.photon_rate(np.zeros(1), np.array([temperature_k]))[0, 0] * response
    return np.asarray(rate / rate.sum())


def _psfs_by_rays(spots: Spots, camera: Camera, half_size_px: int) -> Callable[[FloatArray], tuple[EffectivePsf, ...]]:
    """Function that makes PSFs of all fields of rays that are weighed by the share of each wavelength."""
    cos, sin = math.cos(math.radians(AZIMUTH_DEG)), math.sin(math.radians(AZIMUTH_DEG))
    x, y = spots.rays.x / camera.pixel_pitch_mm, -spots.rays.y / camera.pixel_pitch_mm

    def psfs(share: FloatArray) -> tuple[EffectivePsf, ...]:
        return tuple(
            ray_epsf(
                (cos * column - sin * row).ravel(),
                (sin * column + cos * row).ravel(),
                (area * share[:, None]).ravel(),
                diffusion_px=camera.blur_px,
                oversampling=OVERSAMPLING,
                half_size_px=half_size_px,
            )
            for column, row, area in zip(x, y, spots.area_mm2, strict=True)
        )

    return psfs
