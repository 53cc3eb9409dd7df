"""Stars through a sensor over its field, without frames: electrons, PSFs and image shifts by colour.

Everything here depends neither on exposure nor on noise. Fields lie between the middle and the corner of the detector;
the lens is taken as one of revolution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from optics.arrays import FloatArray
from optics.interpolation import bilinear
from optics.light.band import Band
from optics.rays.performance import LensPerformance, lens_performance
from optics.rays.polychromatic_spots import PolychromaticSpots
from optics.rays.spots import Spots, trace_spots, weighted_mean
from render.camera import Camera
from render.records import EffectivePsf
from render.sensor import FIELD_FRACTIONS, StarSensor
from render.sky.star_light import StarLight, star_light
from render.tracing.measured.images import measured_psfs
from render.tracing.psf import ray_epsf, trailed, wave_images

NODES = 6
"""Wavelengths at which the pass band is sampled."""
RAYS = (32, 64)
"""Rings and azimuths of the pupil."""
AREA_FRACTIONS = np.linspace(0.0, 1.0, 25)
AREA_RAYS = (16, 32)
"""Fields and rays for the collecting area, which has a kink where an aperture begins to cut."""
OVERSAMPLING = 8
AZIMUTH_DEG = 22.5
"""Direction in which PSFs lie from the middle: halfway between the axes and the diagonals of the pixels."""
COLD_K, HOT_K = 3500.0, 10000.0
"""Stars whose spots are compared with that of the reference star."""
AIRY_SIGMA = 0.42
"""Standard deviation of the Gaussian nearest to an Airy pattern, in wavelengths times F-number (Zhang et al. 2007,
Appl. Opt. 46, 1819, table 1: 0.21 wavelengths over the sine of the cone's half angle)."""
_FWHM = 2.0 * math.sqrt(2.0 * math.log(2.0))
"""Of a Gaussian, in standard deviations."""
PsfsOf = Callable[[FloatArray], tuple[EffectivePsf, ...]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FieldResponse:
    """Made by `field_response`; f fields, w wavelengths, c colours."""

    sensor: StarSensor  # Camera and detector
    band: Band  # Pass band
    light: StarLight  # Star light at its w wavelength nodes, in the magnitudes of the catalogue
    response: FloatArray  # (w,) Electrons per photon at the nodes
    fraction: FloatArray  # (w,) Fraction of each node in the electrons of the reference star
    radius_px: FloatArray  # (f,) Distance of the fields from the middle of the detector
    performance: LensPerformance  # Of the focused lens at these fields
    # (a,) Distance from the middle of the detector; collecting area of the lens there for the reference star
    area_radius_px: FloatArray
    area_field_deg: FloatArray  # (a,) Field angles there
    area_mm2: FloatArray
    psfs: tuple[EffectivePsf, ...]  # (f) Of the reference star
    cold_psfs: tuple[EffectivePsf, ...]  # (f) The same of stars of 3500 and 10 000 K
    hot_psfs: tuple[EffectivePsf, ...]
    # Width of the mean spot on the pixels, and so of the detection filter; with diffraction that of its core
    fwhm_px: float
    # (2,) From the first to the last place of a star in an exposure, in which PSFs are drawn out; columns and rows
    trail_px: FloatArray
    # (c, f) Mean of the light of stars of `temperatures_k` on the detector, radial, from that of the reference star
    colour_px: FloatArray
    temperatures_k: FloatArray  # (c,) Increasing

    @property
    def pixel_arcsec(self) -> float:
        """Angle of a pixel on the axis."""
        return self.sensor.pixel_arcsec

    @property
    def field_of_view_deg(self) -> tuple[float, float, float]:
        """Width, height and diagonal of the field, distortion and all."""
        camera = self.sensor.camera
        size = np.array([camera.width_px, camera.height_px, np.hypot(camera.width_px, camera.height_px)])
        tangent = np.interp(size / 2.0, self.area_radius_px, np.tan(np.radians(self.area_field_deg)))
        width, height, diagonal = 2.0 * np.degrees(np.arctan(tangent))
        return float(width), float(height), float(diagonal)

    @property
    def hot_against_cold_px(self) -> float:
        """Largest shift over the field of a star of 10 000 K against a star of 3500 K."""
        cold, hot = (int(np.abs(np.log(self.temperatures_k / kelvin)).argmin()) for kelvin in (COLD_K, HOT_K))
        return float(np.abs(self.colour_px[hot] - self.colour_px[cold]).max())

    def blurred_psfs(self, images: PolychromaticSpots, points: Sequence[int]) -> tuple[EffectivePsf, ...]:
        """PSFs of images by rays at some of their field points; diffraction blurs as a Gaussian."""
        camera, pitch = self.sensor.camera, self.sensor.camera.pixel_pitch_mm
        blur_px = float(np.hypot(camera.blur_px, _airy_px(camera, self.performance)))
        return tuple(
            ray_epsf(
                images.x_mm[k].ravel() / pitch,
                -images.y_mm[k].ravel() / pitch,
                images.weight[k].ravel(),
                diffusion_px=blur_px,
                half_size_px=8,
            )
            for k in points
        )

    def electrons_per_s(self, magnitude: FloatArray, temperature_k: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Electrons per second of stars (n,), at distances from the middle of the detector."""
        rate = self.light.photon_rate(magnitude, temperature_k)[:, 0] * self.response  # per mm^2
        return np.asarray(rate.sum(1) * np.interp(radius_px, self.area_radius_px, self.area_mm2))

    def colour_shift_px(self, temperature_k: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Radial shift (n,) of stars by their colour, against the reference star."""
        log_k = np.log(self.temperatures_k)
        return bilinear(self.colour_px, (log_k, self.radius_px), (np.log(temperature_k), radius_px))

    def moving(self, trail_px: FloatArray) -> FieldResponse:
        """The response to stars whose images trail by (2,) px, columns and rows, during an exposure."""
        psfs, cold, hot = (
            tuple(trailed(psf, trail_px) for psf in still) for still in (self.psfs, self.cold_psfs, self.hot_psfs)
        )
        fwhm_px = _fwhm((self.fwhm_px / _FWHM) ** 2 + float(trail_px @ trail_px) / 24.0)
        return replace(self, trail_px=trail_px, fwhm_px=fwhm_px, psfs=psfs, cold_psfs=cold, hot_psfs=hot)


def field_response(
    sensor: StarSensor, band: Band | None = None, *, magnitude_system: str = "V", temperature_k: float = 5800.0
) -> FieldResponse:
    """Trace a sensor over its field, for magnitudes V or G and a reference star of a black body's colour.

    ``band`` is the light that reaches the lens; the sensor's if left out, or all that lens and detector are known for.
    `DomainError` where the detector covers more than the field of the lens.
    """
    sensor.check_field()
    band = band or sensor.band or sensor.passband()
    camera, lens = sensor.camera, sensor.camera.focused_lens
    light = _light(band, magnitude_system)  # type: ignore[arg-type]  # bands are frozen records
    wave = light.wavelength_nm[0]
    response = camera.response_at(wave)
    fraction = _fraction(light, response, temperature_k)
    corner_px = 0.5 * float(np.hypot(camera.width_px, camera.height_px))
    radius_px, area_radius_px = (corner_px * np.array(parts) for parts in (FIELD_FRACTIONS, AREA_FRACTIONS))
    field_deg, area_field_deg = (sensor.radial_field_deg(r) for r in (radius_px, area_radius_px))
    spots = trace_spots(lens, field_deg, np.zeros_like(field_deg), wave, order=RAYS)
    performance = lens_performance(lens, field_deg, wave, fraction, spots=spots)
    blur_mm = camera.lens_blur_px * camera.pixel_pitch_mm
    performance = replace(
        performance, white=performance.white.blurred(blur_mm), single=performance.single.blurred(blur_mm)
    )
    lit = trace_spots(lens, area_field_deg, np.zeros_like(area_field_deg), wave, order=AREA_RAYS)
    psfs_of, fwhm_px = _psf_maker(camera, spots, performance)
    kelvin = np.exp(light.log_temperature[4:-4:4])
    fractions = np.stack([_fraction(light, response, float(t)) for t in kelvin])
    area = np.nan_to_num(performance.area_mm2)
    means = weighted_mean(performance.bundle_mm, fractions[:, None] * area)
    return FieldResponse(
        sensor=sensor,
        band=band,
        light=light,
        response=response,
        fraction=fraction,
        radius_px=radius_px,
        performance=performance,
        area_radius_px=area_radius_px,
        area_field_deg=area_field_deg,
        area_mm2=(lit.area_mm2.sum(-1) @ fraction) * np.cos(np.radians(area_field_deg)),
        psfs=psfs_of(fraction),
        cold_psfs=psfs_of(_fraction(light, response, COLD_K)),
        hot_psfs=psfs_of(_fraction(light, response, HOT_K)),
        fwhm_px=fwhm_px,
        trail_px=np.zeros(2),
        colour_px=(means - performance.white_mm) / camera.pixel_pitch_mm,
        temperatures_k=kelvin,
    )


@lru_cache(maxsize=8)
def _light(band: Band, system: str) -> StarLight:
    return star_light([band], nodes=NODES, magnitude_system=system)  # type: ignore[arg-type]  # "V" or "G"


def _fraction(light: StarLight, response: FloatArray, temperature_k: float) -> FloatArray:
    rate = light.photon_rate(np.zeros(1), np.array([temperature_k]))[0, 0] * response
    return np.asarray(rate / rate.sum())


def _fwhm(sigma2: float) -> float:
    return float(np.clip(_FWHM * np.sqrt(sigma2), 0.8, 20.0))


def _psf_maker(camera: Camera, spots: Spots, performance: LensPerformance) -> tuple[PsfsOf, float]:
    """PSFs of all fields by the fraction of the light at each wavelength, and the width of the mean spot [px]."""
    pitch, wave, field_deg = camera.pixel_pitch_mm, performance.wavelength_nm, performance.field_deg
    rms_px = performance.white.rms_mm() / pitch
    optics_px2 = float(np.nanmean(rms_px**2)) / 2.0 - camera.lens_blur_px**2
    # farthest ray from the mean of the light of its field, which lies along x
    away_mm = np.hypot(spots.rays.x - performance.white_mm[:, None, None], spots.rays.y)
    farthest_px = float(away_mm[spots.area_mm2 > 0.0].max(initial=0.0)) / pitch + camera.blur_px
    reach_px = min(4.0 * float(np.nanmax(rms_px)), farthest_px)
    half = int(np.clip(np.ceil(reach_px) + 4, 8, 40))
    sigma2 = optics_px2 + camera.blur_px**2 + 1.0 / 12.0
    if camera.lens.measured is not None:
        turn, along = math.radians(AZIMUTH_DEG), np.tan(np.radians(field_deg))
        direction = np.stack([math.cos(turn) * along, math.sin(turn) * along, np.ones_like(along)], axis=-1)
        psfs_of = partial(measured_psfs, camera, direction, wave, oversampling=OVERSAMPLING, half_size_px=half)
        return psfs_of, _fwhm(sigma2)
    if camera.diffraction == "rays":
        return _psfs_by_rays(spots, camera, half), _fwhm(sigma2)
    images = wave_images(
        camera.focused_lens,
        field_deg,
        wave,
        pitch_mm=pitch,
        diffusion_px=camera.blur_px,
        azimuth_deg=AZIMUTH_DEG,
        oversampling=OVERSAMPLING,
        half_size_px=half,
    )
    return images.psfs, _fwhm(sigma2 + _airy_px(camera, performance) ** 2)


def _airy_px(camera: Camera, performance: LensPerformance) -> float:
    """Standard deviation of the Gaussian nearest to the Airy pattern; 0 for stars rendered as ray densities."""
    wave_mm = 1e-6 * float(performance.spectrum @ performance.wavelength_nm)
    return (camera.diffraction != "rays") * AIRY_SIGMA * wave_mm * performance.f_number / camera.pixel_pitch_mm


def _psfs_by_rays(spots: Spots, camera: Camera, half_size_px: int) -> PsfsOf:
    cos, sin = math.cos(math.radians(AZIMUTH_DEG)), math.sin(math.radians(AZIMUTH_DEG))
    x, y = spots.rays.x / camera.pixel_pitch_mm, -spots.rays.y / camera.pixel_pitch_mm

    def psfs(fraction: FloatArray) -> tuple[EffectivePsf, ...]:
        return tuple(
            ray_epsf(
                (cos * column - sin * row).ravel(),
                (sin * column + cos * row).ravel(),
                (area * fraction[:, None]).ravel(),
                diffusion_px=camera.blur_px,
                oversampling=OVERSAMPLING,
                half_size_px=half_size_px,
            )
            for column, row, area in zip(x, y, spots.area_mm2, strict=True)
        )

    return psfs
