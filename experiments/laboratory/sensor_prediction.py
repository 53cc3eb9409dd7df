"""Predicted performance of a star sensor: lens, light, detection, centroids, attitude over the sky.

Stars are at rest or trail uniformly (`slew`), alone in their window; the camera's geometry is calibrated without error.
Errors of a laboratory (marking error of a target, its survey) belong to the laboratory's budget (experiment
``budget``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.accuracy.attitude_forecast import AttitudeForecast, Sightings, attitude_forecast
from calib.accuracy.star_errors import DetectionLimit, FrameNoise, StarErrors, colour_distance, mean_snr, star_errors
from calib.attitude.tracker import GuideCatalogue, guide_catalogue
from calib.measure.centroiding.registry import get_centroider
from calib.measure.detection.false_alarms import clipped_noise
from calib.records import NoiseModel
from experiments.harness.config import load_config
from experiments.harness.sections import col
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.checks import focus_remark
from experiments.laboratory.settings.prediction import PredictedSensorConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import RAD_ARCSEC
from render.catalogue.record import StarCatalog
from render.catalogue.temperature import star_temperature
from render.detector.noise import PixelNoise, damage_steps
from render.detector.spec import Detector
from render.engine.random import Streams
from render.field_response import FieldResponse, field_response
from render.sensor_file.catalogue import load_catalogue
from render.sensor_file.detector import DetectorConfig, overridden
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import build_instrument, configured_detector
from render.sensor_file.tables import CatalogueConfig, InstrumentConfig, PassbandConfig
from render.sky.field import FieldOfView, field_of_view
from render.sky.view import SkyView, expected_stars, sky_view

FAINT_MARGIN_MAG = 1.0
"""The catalogue is used to this margin beyond the limiting magnitude."""
DEPTH_STEP_MAG = 0.5
"""Steps of the catalogue's depth, so that similar sensors share a cached sky."""
BRIGHTEST_MAG = -1.5
"""No star is brighter (Sirius: V = -1.46 mag)."""
WORST_FRACTION = 0.01
"""Fraction of the sky that the worst attitudes and star counts refer to."""
SAMPLED_STARS = 400_000
"""Stars in all sampled fields together; limits the number of attitudes for wide fields."""
MIN_ATTITUDES = 100
"""Smallest number of sampled attitudes."""
CACHE_SIZE = 64
"""Number of settings with results in memory."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraPrediction:
    """All results of a prediction."""

    config: Any  # PredictedSensorConfig, or the configuration of an experiment with all its keys
    state: FieldResponse  # Response of lens, pass band and detector over the field
    detector: Detector  # Detector as overridden by the configuration, cut to the window
    pixel: PixelNoise  # Noise of a pixel in one exposure
    processing: DetectionLimit  # Noise of frames and detection
    stars: StarErrors  # Centroid errors and detection probability against electrons
    view: SkyView  # Stars of the sampled fields
    attitude: AttitudeForecast  # Predicted attitude errors of the sampled fields
    limits_mag: Mapping[float, float]  # Fraction of stars detected -> magnitude

    @cached_property
    def records(self) -> tuple[Optics, StarAccuracy, SkyPerformance]:
        """Single numbers."""
        return summarise_optics(self), summarise_star_accuracy(self), summarise_sky(self)

    @cached_property
    def numbers(self) -> Mapping[str, float]:
        """Single numbers by name, the same names for every sensor (`records`)."""
        return {name: value for record in self.records for name, value in asdict(record).items()}

    def value(self, name: str) -> float:
        """A number by name."""
        return self.numbers[name]

    @property
    def saturated(self) -> bool:
        """Whether the quoted star saturates, so that its accuracy is undefined."""
        return self.config.star.magnitude_mag < self.value("saturation_mag")

    @property
    def catalogue_ends(self) -> bool:
        """Whether the sensor detects stars below the faintest of the catalogue."""
        return self.view.depth_mag < self.value("limiting_magnitude_mag")

    @property
    def radii_px(self) -> FloatArray:
        """Distances (n,) from the centre of a uniform grid over the detector."""
        return detector_radii(self.state)

    @property
    def axis_e(self) -> float:
        """Electrons of the quoted star on the axis."""
        star = self.config.star
        return float(self.electrons(np.array([star.magnitude_mag]), star.temperature_k)[0])

    @property
    def fill(self) -> float:
        """Charge of the quoted star's brightest pixel over the saturation charge."""
        return float(self.stars.centroid.peak.max()) * self.axis_e / max(self.processing.frame.saturation_e, 1e-9)

    def electrons(self, magnitude: FloatArray, temperature_k: float, radius_px: FloatArray | float = 0.0) -> FloatArray:
        """Electrons in one exposure of stars of magnitudes (n,)."""
        magnitude = np.atleast_1d(np.asarray(magnitude, float))
        kelvin = np.full(len(magnitude), float(temperature_k))
        radius = np.broadcast_to(np.asarray(radius_px, float), magnitude.shape)
        return self.state.electrons_per_s(magnitude, kelvin, radius) * exposed_s(self.config)

    def guide_stars(
        self,
        stars: StarCatalog,
        direction: FloatArray,
        *,
        brightest_mag: float,
        faintest_mag: float,
        throughput: float = 1.0,
    ) -> GuideCatalogue:
        """Guide stars among ``stars`` at unit vectors (n, 3); magnitudes of quoted stars of the same electrons."""
        axis = np.zeros(len(stars))
        kelvin = star_temperature(stars, self.config.catalogue.temperature)
        rate = self.state.electrons_per_s(stars.magnitude, kelvin, axis) * throughput
        zero = self.state.electrons_per_s(np.zeros(1), np.array([self.config.star.temperature_k]), np.zeros(1))[0]
        return guide_catalogue(
            stars.id,
            direction,
            -2.5 * np.log10(rate / zero),
            faintest_mag=faintest_mag,
            brightest_mag=brightest_mag,
            apart_rad=self.config.window_px * self.state.pixel_arcsec / RAD_ARCSEC,
        )


def overridden_detector(config: PredictedSensorConfig) -> Detector:
    """The detector with the changes of the configuration."""
    return overridden(configured_detector(config.instrument), config.detector)


def exposed_s(config: PredictedSensorConfig) -> float:
    """Exposure time, reduced by the unexplained loss of light."""
    return config.instrument.exposure_s * config.throughput_fraction


def detector_radii(state: FieldResponse) -> FloatArray:
    """Distances (n,) [px] from the centre of a uniform 16 x 16 grid over the detector."""
    camera = state.sensor.camera
    fraction = (np.arange(16) + 0.5) / 16.0 - 0.5
    x, y = np.meshgrid(fraction * camera.width_px, fraction * camera.height_px)
    return np.hypot(x, y).ravel()


# --- The prediction


def predict_sensor(file: str | Path, *settings: str) -> CameraPrediction:
    """What the star sensor of a sensor file will do, without frames.

    Parameters
    ----------
    file : path
        Sensor file (TOML).
    *settings : str
        Further settings of `experiments.camera`, such as ``"false_alarms_per_frame=0.1"``, ``"star.magnitude_mag=5"``
        or ``"slew.rate_deg_per_s=0.5"``.

    Returns
    -------
    CameraPrediction
        ``numbers`` by name (electrons, signal-to-noise ratio, NEA, limiting magnitude, stars per frame, attitude);
        curves and attitudes below ``stars`` and ``attitude``.

    Raises
    ------
    StarbenchError
        A file or setting that is not allowed, a sensor that detects no star.
    """
    return predict_camera(load_config(PredictedSensorConfig, sensor=file, settings=settings))


def predict_camera(config: PredictedSensorConfig) -> CameraPrediction:
    """Predict a sensor; results of lens, pass band and detector are cached for sweeps over other settings."""
    state = optical_state(config)
    chip = state.sensor.detector
    detector = replace(
        overridden_detector(config),
        chip_width_px=chip.chip_width_px,
        chip_height_px=chip.chip_height_px,
    )
    processing = detection_limit(config, detector, state.fwhm_px)
    stars = star_errors(
        state.psfs,
        processing,
        radius_px=state.radius_px,
        centroid=config.centroid,
        window_px=config.window_px,
        other_psfs=(state.cold_psfs, state.hot_psfs),
        reference_k=config.star.temperature_k,
    )
    radius_px = detector_radii(state)
    kelvin = np.full(len(radius_px), config.star.temperature_k)
    zero_e = state.electrons_per_s(np.zeros(len(radius_px)), kelvin, radius_px) * exposed_s(config)
    limit = {level: stars.limiting_magnitude(zero_e, radius_px, level) for level in (0.9, 0.5)}
    if limit[0.5] <= BRIGHTEST_MAG:
        remark = (
            focus_remark(state.sensor, state.light.wavelength_nm[0], state.fraction)
            or "the signal of every star is below the noise"
        )
        raise DomainError(f"half of the stars of {limit[0.5]:g} mag are not detected; {remark}")
    view = sky_of(config, limit[0.5] + FAINT_MARGIN_MAG)
    return CameraPrediction(
        config=config,
        state=state,
        detector=detector,
        pixel=pixel_noise(config, detector),
        processing=processing,
        stars=stars,
        view=view,
        attitude=attitude_forecast(
            sightings(config, state, view),
            stars,
            processing,
            pixel_arcsec=state.pixel_arcsec,
            size_px=(detector.width_px, detector.height_px),
            window_px=config.window_px,
            bad_fraction=detector.hot_fraction + detector.dead_fraction,
        ),
        limits_mag=limit,
    )


def pixel_noise(config: PredictedSensorConfig, detector: Detector) -> PixelNoise:
    """Noise of a pixel in one exposure."""
    setting = config.instrument
    return PixelNoise.of(detector, temperature_c=setting.chip_temperature_c, exposure_s=setting.exposure_s)


def detection_limit(config: PredictedSensorConfig, detector: Detector, fwhm_px: float) -> DetectionLimit:
    """Noise of frames, and the detection limit in it."""
    setting = config.instrument
    pixel = pixel_noise(config, detector)
    background_e = config.background_e_per_s * setting.exposure_s
    undamaged = pixel_noise(config, replace(detector, damage_centres_per_px=0.0))
    undamaged_e2 = float(undamaged.temporal_e2(background_e, dark_frames=config.dark_frames))
    dark_s = detector.dark_factor(setting.chip_temperature_c) * setting.exposure_s * (1.0 + 1.0 / config.dark_frames)
    damage, fraction = damage_steps(detector)
    frame = FrameNoise(
        pixel=NoiseModel(
            read_noise_e=math.sqrt(pixel.read_e2 + pixel.dark_e),
            gain_dn_per_e=detector.gain_dn_per_e,
            offset_dn=detector.offset_dn,
            quantised=True,
        ),
        spread_e4=pixel.floor_e4,
        prnu=pixel.prnu,
        background_e=background_e,
        dark_frames=config.dark_frames,
        saturation_e=float(detector.saturation_e - background_e - pixel.dark_e),
        clipped_ratio=clipped_noise(
            math.sqrt(undamaged.floor_e4) / undamaged_e2, damage * dark_s / undamaged_e2, fraction
        ),
    )
    pixels = detector.width_px * detector.height_px
    false_alarms = config.false_alarms_per_frame
    if false_alarms is not None:
        return DetectionLimit.of_false_alarms(false_alarms, frame=frame, pixels=pixels, fwhm_px=fwhm_px)
    return DetectionLimit(frame=frame, pixels=pixels, fwhm_px=fwhm_px, threshold_sigma=config.threshold_sigma)


def sightings(config: PredictedSensorConfig, state: FieldResponse, view: SkyView) -> Sightings:
    """Stars of the sampled fields with their electrons, neighbours and colour shifts."""
    electrons = state.electrons_per_s(view.magnitude, view.temperature_k, view.radius_px) * exposed_s(config)
    return Sightings(
        frames=view.sample.frames,
        frame=view.sample.frame,
        direction=view.sample.direction,
        pixel_px=view.sample.pixel_px,
        radius_px=view.radius_px,
        temperature_k=view.temperature_k,
        electrons=electrons,
        neighbour_e=electrons * 10.0 ** (-0.4 * (view.neighbour_mag - view.magnitude)),
        brighter_px=view.brighter_px,
        colour_shift_px=state.colour_shift_px(view.temperature_k, view.radius_px),
    )


# --- Lens and light of a configuration


def optical_state(config: PredictedSensorConfig) -> FieldResponse:
    """Lens, pass band and detector of a configuration (cached)."""
    geometry = config.instrument.model_copy(
        update={
            name: InstrumentConfig.model_fields[name].default
            for name in ("exposure_s", "chip_temperature_c", "gain_dn_per_e", "line_time_us")
        }
    )
    chip = DetectorConfig(diffusion_sigma_um=config.detector.diffusion_sigma_um)
    at_rest = _at_rest(geometry, chip, config.passband, magnitude_system(config.catalogue), config.star.temperature_k)
    turn_rad = math.radians(config.slew.rate_deg_per_s * config.instrument.exposure_s)
    if not turn_rad:
        return at_rest
    max_trail_px, setting, window_px = longest_trail_px(config, at_rest)
    trail_px = turn_rad * at_rest.performance.plate_scale_mm / at_rest.sensor.camera.pixel_pitch_mm
    if trail_px > max_trail_px:
        needed = int(np.ceil(trail_px - max_trail_px + window_px)) // 2 * 2 + 1
        raise DomainError(
            f"slew.rate_deg_per_s, instrument.exposure_s: stars trail over {trail_px:.3g} px, which is too much for "
            f"{setting} {window_px} px (at least {needed}); lower rate or exposure, or choose another one"
        )
    return _moving(at_rest, trail_px, math.radians(config.slew.direction_deg))


def longest_trail_px(config: PredictedSensorConfig, at_rest: FieldResponse) -> tuple[float, str, int]:
    """Longest trail in the centroider's window, the setting that limits it, and the side of the window."""
    setting = "window_px ="
    window_px = config.window_px
    half = None if needs_epsf(config.centroid) else getattr(get_centroider(config.centroid), "half_width_px", None)
    if half is not None and 2 * half + 1 < window_px:
        setting = f"centroid = {config.centroid} with a window of"
        window_px = 2 * half + 1
    rms_mm = float(np.nanmax(at_rest.performance.white.rms_mm()))
    return window_px - 4.0 * rms_mm / at_rest.sensor.camera.pixel_pitch_mm, setting, window_px


@lru_cache(maxsize=CACHE_SIZE)
def _moving(state: FieldResponse, length_px: float, towards_rad: float) -> FieldResponse:
    return state.moving(length_px * np.array([np.cos(towards_rad), np.sin(towards_rad)]))


def magnitude_system(config: CatalogueConfig) -> str:
    """Scale of the magnitudes of a catalogue."""
    return "G" if config.source == "gaia" else load_catalogue(config).magnitude_system


@lru_cache(maxsize=CACHE_SIZE)
def _at_rest(
    config: InstrumentConfig, chip: DetectorConfig, passband: PassbandConfig, system: str, temperature_k: float
) -> FieldResponse:
    sensor = build_instrument(config, detector=overridden(configured_detector(config), chip))
    try:
        sensor.check_field()
    except DomainError as error:
        raise DomainError(f"instrument.width_px, instrument.height_px: {error}") from None
    return field_response(sensor, open_band(passband, sensor), magnitude_system=system, temperature_k=temperature_k)


# --- Sky of a configuration


def sky_of(config: PredictedSensorConfig, limit_mag: float) -> SkyView:
    """Stars to a magnitude or to the end of the catalogue, for the lens as designed (cached)."""
    stepped_mag = DEPTH_STEP_MAG * float(np.ceil(limit_mag / DEPTH_STEP_MAG))
    geometry = {name: getattr(config.instrument, name) for name in ("lens", "detector", "width_px", "height_px")}
    # the field of view depends on neither coatings nor absorption, for which a lens may have no data
    lossless = InstrumentConfig(**geometry, defocus_mm=0.0, absorption=False, coating_nm=0.0)
    depth_mag = min(stepped_mag, config.catalogue.faintest_mag)
    return _sky_of(lossless, config.catalogue, config.window_px, depth_mag, config.sky.attitudes, config.seed)


@lru_cache(maxsize=CACHE_SIZE)
def _field_of_view(config: InstrumentConfig) -> FieldOfView:
    return field_of_view(build_instrument(config).camera, margin_px=0.0)


@lru_cache(maxsize=CACHE_SIZE)
def _sky_of(
    instrument: InstrumentConfig,
    catalogue: CatalogueConfig,
    window_px: int,
    depth_mag: float,
    attitudes: int,
    seed: int,
) -> SkyView:
    full = load_catalogue(catalogue)
    bright = np.flatnonzero(full.magnitude <= depth_mag)
    if not len(bright):
        brightest = float(np.nanmin(full.magnitude))
        raise DomainError(
            f"no star of catalogue {full.name} is brighter than the sensor's limiting magnitude of {depth_mag:g} mag; "
            f"the brightest has {brightest:.2f} mag"
        )
    stars = full.select(bright)
    view = _field_of_view(instrument)
    count = int(np.clip(SAMPLED_STARS / expected_stars(len(bright), view), min(MIN_ATTITUDES, attitudes), attitudes))
    rotations = Rotation.random(count, rng=Streams(seed).child("camera").generator("attitudes"))
    kelvin = star_temperature(stars, catalogue.temperature)
    return sky_view(stars, kelvin, view, rotations, window_px=window_px, depth_mag=depth_mag)


# --- The single numbers, the same names for every sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Optics:
    """Lens and detector."""

    focal_length_mm: float = col("Focal length", "mm", ".3f")
    f_number: float = col("F-number", "", ".2f")
    pupil_mm: float = col("Entrance pupil", "mm", ".2f")
    plate_scale_arcsec_per_mm: float = col("Plate scale", "arcsec/mm", ".1f")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec", ".3f")
    field_width_deg: float = col("Field, width", "deg", ".2f")
    field_height_deg: float = col("Field, height", "deg", ".2f")
    field_deg: float = col("Field, shorter side", "deg", ".2f", shown=False)
    field_diagonal_deg: float = col("Field, diagonal", "deg", ".2f")
    spot_axis_um: float = col("Spot radius (RMS) on axis", "um", ".2f")
    spot_um: float = col("Spot radius (RMS), largest", "um", ".2f")
    spot_px: float = col("Spot radius (RMS), largest", "px", ".3f")
    best_focus_um: float = col("Best focus, from the detector", "um", ".1f")
    depth_of_focus_um: float = col("Depth of focus, ±", "um", ".1f")
    distortion_percent: float = col("Distortion, largest", "percent", ".3f")
    lateral_colour_px: float = col("Lateral colour over the pass band", "px", ".3f")
    star_colour_px: float = col("Shift of a 10 000 K against a 3500 K star", "px", ".3f")
    axial_colour_um: float = col("Axial colour over the pass band", "um", ".1f")
    vignetting_percent: float = col("Vignetting, largest", "percent", ".2f")


@dataclass(frozen=True, slots=True, kw_only=True)
class StarAccuracy:
    """The star of ``[star]``, one axis, one standard deviation; NaN where it saturates."""

    electrons_e: float = col("Electrons", "e-", ".0f")
    snr: float = col("Signal-to-noise ratio", "", ".1f")
    nea_arcsec: float = col("NEA", "arcsec", ".3f")
    pattern_arcsec: float = col("Pixel patterns", "arcsec", ".3f")
    phase_arcsec: float = col("Pixel phase", "arcsec", ".3f")
    colour_arcsec: float = col("Star colours", "arcsec", ".3f")
    single_star_arcsec: float = col("Single-star accuracy", "arcsec", ".3f")


@dataclass(frozen=True, slots=True, kw_only=True)
class SkyPerformance:
    """Detection, and attitudes over the sky, one standard deviation."""

    saturation_mag: float = col("Brightest star that does not saturate", "mag", ".2f")
    limiting_magnitude_mag: float = col("Limiting magnitude, half detected", "mag", ".2f")
    complete_magnitude_mag: float = col("Limiting magnitude, 90 % detected", "mag", ".2f")
    threshold_sigma: float = col("Detection limit", "sigma", ".2f")
    false_alarms_per_frame: float = col("False alarms per frame", "", ".3g")
    stars_mean_per_frame: float = col("Stars per frame, mean over the sky", "", ".1f")
    stars_worst_per_frame: float = col("Stars per frame, worst 1 % of the sky", "", ".1f")
    update_rate_hz: float = col("Update rate", "Hz", ".3g")
    latency_s: float = col("Age of an attitude at its output", "s", ".3g")
    attitude_cross_arcsec: float = col("Attitude across, median", "arcsec", ".3f")
    attitude_cross_worst_arcsec: float = col("Attitude across, worst 1 % of the sky", "arcsec", ".3f")
    attitude_roll_arcsec: float = col("Attitude roll, median", "arcsec", ".3f")
    attitude_roll_worst_arcsec: float = col("Attitude roll, worst 1 % of the sky", "arcsec", ".3f")
    attitude_cross_noise_arcsec: float = col("Attitude across, median, noise alone", "arcsec", ".3f", shown=False)
    attitude_cross_worst_noise_arcsec: float = col(
        "Attitude across, worst 1 %, noise alone", "arcsec", ".3f", shown=False
    )
    attitude_roll_noise_arcsec: float = col("Attitude roll, median, noise alone", "arcsec", ".3f", shown=False)
    attitude_roll_worst_noise_arcsec: float = col("Attitude roll, worst 1 %, noise alone", "arcsec", ".3f", shown=False)


def summarise_optics(prediction: CameraPrediction) -> Optics:
    """Numbers of the lens on this detector."""
    state = prediction.state
    lens = state.performance
    pitch = state.sensor.camera.pixel_pitch_mm
    rms = lens.white.rms_mm()
    width, height, diagonal = state.field_of_view_deg
    return Optics(
        focal_length_mm=state.sensor.focal_length_mm,
        f_number=lens.f_number,
        pupil_mm=abs(lens.focal_length_mm) / lens.f_number,
        plate_scale_arcsec_per_mm=RAD_ARCSEC / lens.plate_scale_mm,
        pixel_arcsec=state.pixel_arcsec,
        field_width_deg=width,
        field_height_deg=height,
        field_deg=min(width, height),
        field_diagonal_deg=diagonal,
        spot_axis_um=1e3 * float(rms[0]),
        spot_um=1e3 * float(rms.max()),
        spot_px=float(rms.max()) / pitch,
        best_focus_um=1e3 * lens.best_focus_mm,
        depth_of_focus_um=1e3 * lens.depth_of_focus_mm(pitch),
        distortion_percent=100.0 * float(np.abs(lens.distortion).max()),
        lateral_colour_px=float(np.ptp(lens.bundle_mm, axis=1).max() / pitch),
        star_colour_px=state.hot_against_cold_px,
        axial_colour_um=float(np.ptp(lens.axial_colour_mm) * 1e3),
        vignetting_percent=100.0 * float(1.0 - lens.vignetting.min()),
    )


def summarise_star_accuracy(prediction: CameraPrediction) -> StarAccuracy:
    """Numbers of the quoted star, mean over the detector."""
    config = prediction.config
    state = prediction.state
    stars = prediction.stars
    star = config.star
    radius = prediction.radii_px
    axis_e = prediction.axis_e
    electrons = prediction.electrons(np.full(len(radius), star.magnitude_mag), star.temperature_k, radius)
    # the centroid of a saturated spot is not predicted
    pixel_arcsec = state.pixel_arcsec if prediction.fill <= 1.0 else math.nan
    errors = stars.centroid
    noise, pattern = (
        pixel_arcsec * stars.rms_at(table, electrons, radius) for table in (errors.noise_px, errors.pattern_px)
    )
    phase = pixel_arcsec * (stars.rms_at(errors.phase_px, electrons, radius) if errors.phase_px.any() else 0.0)
    spot_px = stars.rms_at(stars.colour_px, electrons, radius) if stars.colour_px.any() else 0.0
    colour = state.pixel_arcsec * _colour_px(prediction, spot_px)
    snr = mean_snr(state.psfs[0], axis_e, prediction.processing.frame, config.window_px)
    return StarAccuracy(
        electrons_e=axis_e,
        snr=snr if prediction.fill <= 1.0 else math.nan,
        nea_arcsec=noise,
        pattern_arcsec=pattern,
        phase_arcsec=phase,
        colour_arcsec=colour,
        single_star_arcsec=math.hypot(noise, pattern, phase, float(np.nan_to_num(colour))),
    )


def _colour_px(prediction: CameraPrediction, spot_px: float) -> float:
    """Error per axis by the colours of the detected stars: shift of the photocentre, and mismatch of the PSF."""
    view = prediction.view
    bright = view.magnitude <= prediction.limits_mag[0.5]
    if not bright.any():
        return math.nan
    kelvin = view.temperature_k[bright]
    shift_px = prediction.state.colour_shift_px(kelvin, view.radius_px[bright])
    distance = colour_distance(kelvin, prediction.config.star.temperature_k)
    return math.hypot(math.sqrt(0.5 * (shift_px**2).mean()), spot_px * math.sqrt((distance**2).mean()))


def summarise_sky(prediction: CameraPrediction) -> SkyPerformance:
    """Numbers of detection and attitude."""
    config = prediction.config
    processing = prediction.processing
    forecast = prediction.attitude
    attitudes = {}
    for kind, values in (("", forecast.total_arcsec), ("_noise", forecast.noise_arcsec)):
        cross_boresight = np.sqrt((values[:, :2] ** 2).mean(1))
        for component, errors in (("cross", cross_boresight), ("roll", values[:, 2])):
            for statistic, level in (("", 0.5), ("_worst", 1.0 - WORST_FRACTION)):
                error = float(np.quantile(errors, level, method="inverted_cdf"))
                attitudes[f"attitude_{component}{statistic}{kind}_arcsec"] = error
    timing = config.timing
    exposure_s = config.instrument.exposure_s
    return SkyPerformance(
        saturation_mag=config.star.magnitude_mag + 2.5 * math.log10(max(prediction.fill, 1e-9)),
        limiting_magnitude_mag=prediction.limits_mag[0.5],
        complete_magnitude_mag=prediction.limits_mag[0.9],
        threshold_sigma=processing.threshold_sigma,
        false_alarms_per_frame=processing.false_alarms,
        stars_mean_per_frame=float(forecast.stars.mean()),
        stars_worst_per_frame=float(np.quantile(forecast.stars, WORST_FRACTION)),
        update_rate_hz=1.0 / timing.period_s(exposure_s),
        latency_s=0.5 * exposure_s + timing.readout_s + timing.processing_s,
        **attitudes,
    )
