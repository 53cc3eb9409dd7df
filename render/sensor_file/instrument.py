"""The instrument under test, as configuration: lens, detector, focus, temperature."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from optics.errors import DomainError
from optics.glass.absolute_index import Environment
from optics.lens.heated_lens import Housing, Mount, ThermalState, heated_lens
from optics.lens.ideal_lens import ideal_lens
from optics.lens.sag_map import read_map
from optics.lens.system import LensSystem
from optics.lens_file import load_lens
from optics.light.band_file import load_band
from optics.rays.distortion import plate_scale_mm
from optics.rays.paraxial import stopped_down
from optics.response import Response
from optics.waves.measured_wavefront import with_wavefront
from optics.waves.wavefront import PathMap, zernike_map
from render.detector.spec import Detector, load_detector
from render.sensor import StarSensor, build_star_sensor
from render.sensor_file.filters import open_band
from render.sensor_file.housing import HousingConfig, expansion_per_k
from render.sensor_file.tables import InstrumentConfig, PassbandConfig
from render.sky.star_light import star_light

NODES = 6
"""Wavelengths of a pass band."""
STAR_K = 5800.0
"""Temperature of the star that is in focus."""
REFOCUSED, NEAR_MM = 6, 1e-4
"""Most steps towards the best focus, and the last one's length."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Instrument(StarSensor):
    """A star sensor that was configured; its focal length is that of the configured lens, perturbed or not."""

    config: InstrumentConfig


def stated_lens(config: InstrumentConfig) -> LensSystem:
    """The lens of a configuration before any other key is applied."""
    ideal = config.lens
    if isinstance(ideal, str):
        return load_lens(ideal)
    transmission: float | Response = ideal.transmission
    if ideal.transmission_file:
        curve = load_band(ideal.transmission_file)
        transmission = Response(
            name=curve.name, source=curve.source, wavelength_nm=curve.wavelength_nm, value=curve.value
        )
    return ideal_lens(
        focal_length_mm=ideal.focal_length_mm,
        f_number=ideal.f_number,
        spot_um=ideal.spot_um,
        psf_fwhm_px=ideal.psf_fwhm_px,
        transmission=transmission,
        design_wavelength_nm=ideal.design_wavelength_nm,
        max_field_deg=ideal.max_field_deg,
        name=ideal.label,
    )


def housing_of(table: HousingConfig) -> Housing:
    """The housing of a configuration (``instrument.housing``)."""
    return Housing(
        expansion_per_k=expansion_per_k(table.material),
        diameter_mm=table.diameter_mm or None,
        mounted_z_mm=table.mounted_z_mm,
        mounts={name: Mount(front_radius_mm=f, back_radius_mm=b) for name, (f, b) in table.rims_mm.items()},
        spacers_per_k={name: expansion_per_k(material) for name, material in table.spacers.items()},
        poisson_ratio=table.poisson_ratio,
    )


def configured_lens(config: InstrumentConfig) -> LensSystem:
    """The lens of a configuration: stopped down, at its temperature with its housing, with its measured error."""
    lens = stated_lens(config)
    try:
        if config.f_number is not None:
            lens = stopped_down(lens, config.f_number)
    except DomainError as error:
        raise DomainError(f"instrument.{error}") from None
    if config.lens_temperature_c is not None:
        try:
            kelvin = Environment(temperature_c=config.lens_temperature_c).temperature_c - lens.environment.temperature_c
            lens = heated_lens(lens, ThermalState(mean_k=kelvin), housing_of(config.housing))
        except DomainError as error:
            raise DomainError(f"instrument.lens_temperature_c = {config.lens_temperature_c:g} C: {error}") from None
    return _with_measured_wavefront(lens, config)


def _with_measured_wavefront(lens: LensSystem, config: InstrumentConfig) -> LensSystem:
    key = "wavefront_zernike_nm" if config.wavefront_zernike_nm else f"wavefront_map = {config.wavefront_map}"
    try:
        if config.wavefront_zernike_nm:
            return with_wavefront(lens, zernike_map(config.wavefront_zernike_nm))
        if config.wavefront_map:
            values = read_map(Path(config.wavefront_map))
            x, y = (np.linspace(-1.0, 1.0, count) for count in (values.shape[-1], len(values)))
            return with_wavefront(lens, PathMap(x=x, y=y, error_nm=values))
    except DomainError as fault:
        raise DomainError(f"instrument.{key}: {fault}") from None
    return lens


def configured_detector(config: InstrumentConfig) -> Detector:
    """The detector of a configuration, with its gain; the whole detector, with any read-out window."""
    detector = load_detector(config.detector)
    return detector if config.gain_dn_per_e is None else replace(detector, gain_dn_per_e=config.gain_dn_per_e)


def build_instrument(
    config: InstrumentConfig, lens: LensSystem | None = None, detector: Detector | None = None
) -> Instrument:
    """Instrument of a configuration, cut to the window that is read out."""
    nominal, defocus_mm = configured_lens(config), config.defocus_mm
    sensor = build_star_sensor(
        nominal if lens is None else lens,
        configured_detector(config) if detector is None else detector,
        defocus_mm=best_defocus_mm(config, PassbandConfig()) if isinstance(defocus_mm, str) else defocus_mm,
        coating_nm=config.coating_nm,
        absorption=config.absorption,
        diffraction=config.diffraction,
    )
    chip = sensor.detector
    try:
        sensor = sensor.windowed(config.width_px or chip.width_px, config.height_px or chip.height_px)
    except DomainError as error:
        raise DomainError(f"instrument.{error}") from None
    return Instrument(
        config=config,
        exposure_s=config.exposure_s,
        temperature_c=config.chip_temperature_c,
        camera=sensor.camera,
        detector=sensor.detector,
        focal_length_mm=plate_scale_mm(replace(sensor.camera, lens=nominal).focused_lens),
    )


def best_defocus_mm(config: InstrumentConfig, passband: PassbandConfig) -> float:
    """Defocus of the least mean square spot over the detector, for a star of 5800 K through the pass band."""
    instrument = build_instrument(config.model_copy(update={"defocus_mm": 0.0}))
    camera = instrument.camera
    if camera.lens.measured is not None:
        return 0.0
    light = star_light([open_band(passband, instrument)], nodes=NODES)
    wave = light.wavelength_nm[0]
    rate = light.photon_rate(np.zeros(1), np.array([STAR_K]))[0, 0] * camera.response_at(wave)
    defocus_mm = 0.0
    for _ in range(REFOCUSED):  # the corners of the detector see another field in another focus
        step_mm = float(instrument.focus_curve(wave, rate / rate.sum()).best_mm)
        defocus_mm += step_mm
        if abs(step_mm) < NEAR_MM:
            break
        instrument = build_instrument(config.model_copy(update={"defocus_mm": defocus_mm}))
    return round(defocus_mm, 5)
