"""Predicted performance of a star sensor: lens, light, detection, centroids, attitude over the sky.

Stars are at rest or trail uniformly (`slew`), alone in their window; the camera's geometry is calibrated without error.
Errors of a laboratory (marking error of a target, its survey) belong to the laboratory's budget (experiment
``budget``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from calib.attitude.predicted import attitude_covariance
from calib.measure.centroid import centroider_class
from calib.measure.centroid_prediction import (
    SCALE_FREE,
    CentroidErrors,
    CentroidResponse,
    phase_windows,
    predict_centroids,
    psf_mismatch,
)
from calib.measure.crlb import matched_snr
from calib.measure.detection_statistics import (
    clipped_noise,
    detection_probability,
    false_alarms,
    threshold_for_false_alarms,
)
from calib.records import NoiseModel
from experiments.harness.sections import col
from experiments.laboratory.bench.checks import focus_remark
from experiments.laboratory.optical_state import COLD_K, HOT_K, OpticalState, optical_state
from experiments.laboratory.settings.prediction import PredictedSensorConfig
from experiments.laboratory.sky_view import SkyView, sky_view
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import RAD_ARCSEC
from render.detector.noise import PixelNoise, damage_steps
from render.detector.spec import Detector
from render.records import EffectivePsf
from render.sensor_file.detector import overridden
from render.sensor_file.instrument import configured_detector

FLUX_KNOTS = 14
PLAIN = NoiseModel(read_noise_e=10.0)
"""For centroiders that take no notice of the noise."""
FAINTEST_E, BRIGHTEST_E = 20.0, 1e6
FOUND_KNOTS, FOUND_RANGE = 32, (0.2, 8.0)
DEEPER_MAG = 1.0
"""Magnitudes below the limiting magnitude to which the sky is searched."""
BRIGHTEST_MAG = -1.5
"""No star is brighter (Sirius: V = -1.46 mag)."""
WORST = 0.01
"""Share of the sky that its worst part is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Processing:
    """Processing of frames, and its noise."""

    detector: Detector  # With the changes of the configuration, cut to the window
    pixel: PixelNoise  # Of a pixel in one exposure
    noise: NoiseModel  # Of a frame minus the mean dark frame, without the even light: what an estimator is told
    background_e: float  # Even light in a pixel
    empty_e2: float  # Temporal variance of a pixel without star
    threshold_sigma: float  # Detection limit, in the noise that an image is estimated to have
    estimated: float  # That noise over the root mean square one
    fwhm_px: float  # Width of the detection filter
    noise_spread: float  # Standard deviation over the pixels of the variance, relative
    top_e: float  # Electrons at which a pixel saturates

    @property
    def false_alarms(self) -> float:
        """Expected in a frame."""
        return float(self.false_alarms_at(np.array(self.threshold_sigma)))

    def false_alarms_at(self, threshold_sigma: FloatArray) -> FloatArray:
        """The same for other detection limits."""
        pixels, limit = self.detector.width_px * self.detector.height_px, threshold_sigma * self.estimated
        return false_alarms(limit, pixels, fwhm_px=self.fwhm_px, noise_spread=self.noise_spread)


@dataclass(frozen=True, slots=True, kw_only=True)
class StarErrors:
    """Errors and detection against the electrons of a star, at f distances from the middle of the detector."""

    radius_px: FloatArray  # (f,) Distances
    centroid: CentroidErrors  # Noise, patterns, pixel phase; k numbers of electrons
    # (f, k) By the spots of stars of another colour than the PSF's, for one of 10 000 K or 3500 K, whichever is more
    colour_px: FloatArray
    # (2, f) How much sharper spots of stars of 3500 and 10 000 K are than that of the quoted star: light that shows
    # as well against the noise, relative
    sharpness: FloatArray
    found_electrons: FloatArray  # (d,) Electrons about the detection limit
    found: FloatArray  # (f, d) Probability of a detection

    def sigma_at(self, sigma_px: FloatArray, electrons: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Errors (f, k) at stars (n,): linear in distance, a power of the electrons between its knots."""
        log = np.log(np.maximum(sigma_px, 1e-12))
        return np.exp(self._at(log, self.centroid.electrons, electrons, radius_px))

    def found_at(self, electrons: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Probability (n,) that stars are found."""
        share = self._at(self.found, self.found_electrons, electrons, radius_px)
        return np.where(electrons < self.found_electrons[0], 0.0, share)

    def effective(
        self, electrons: FloatArray, temperature_k: FloatArray, radius_px: FloatArray, reference_k: float
    ) -> FloatArray:
        """Electrons of stars of the quoted colour that show as well against the noise as these stars (n,)."""
        cold, hot = (np.interp(radius_px, self.radius_px, row) for row in self.sharpness)
        apart = np.minimum(colour_distance(temperature_k, reference_k), 2.0)
        towards = np.where(temperature_k < reference_k, cold, hot)
        return np.asarray(electrons * towards**apart)

    def _at(self, values: FloatArray, knots: FloatArray, electrons: FloatArray, radius_px: FloatArray) -> FloatArray:
        from scipy.ndimage import map_coordinates

        k = np.interp(np.log(np.maximum(electrons, 1e-9)), np.log(knots), np.arange(len(knots)))
        r = np.interp(radius_px, self.radius_px, np.arange(len(self.radius_px)))
        return np.asarray(map_coordinates(values, np.stack([r, k]), order=1, mode="nearest"))


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeForecast:
    """Predicted attitude errors over f attitudes of the sky."""

    found: FloatArray  # (f,) Expected number of stars that are found
    found_variance: FloatArray  # (f,) Variance of that number by noise
    # (f,) Expected number of those that are fit: not saturated, whole and alone in their window, on good pixels
    stars: FloatArray
    # (f, 3) Standard deviation about x, y (across) and z (roll) by temporal noise; infinite where too few stars are fit
    noise_arcsec: FloatArray
    total_arcsec: FloatArray  # (f, 3) The same with patterns, pixel phase and star colours
    sigma_px: FloatArray  # (m,) Error of each sighting of the view, per axis, all terms
    chance: FloatArray  # (m,) That it is found


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraPrediction:
    """All results of a prediction."""

    config: Any  # For which sensor: PredictedSensorConfig, or the configuration of an experiment with all its keys
    state: OpticalState  # Lens and light
    processing: Processing  # Detector and noise
    stars: StarErrors  # Errors against electrons
    view: SkyView  # Sky
    attitude: AttitudeForecast  # Attitudes
    limits_mag: Mapping[float, float]  # Fraction of stars detected -> magnitude

    @cached_property
    def records(self) -> tuple[Optics, Accuracy, Sky]:
        """Single numbers."""
        return optics(self), accuracy(self), sky(self)

    @cached_property
    def numbers(self) -> Mapping[str, float]:
        """Single numbers by name, the same names for every sensor (`records`)."""
        return {name: value for one in self.records for name, value in asdict(one).items()}

    def value(self, name: str) -> float:
        """A number by name."""
        return self.numbers[name]

    @property
    def saturated(self) -> bool:
        """Whether the star that the accuracy is quoted for saturates: there is no accuracy then."""
        return self.config.star.magnitude_mag < self.value("saturation_mag")

    @property
    def adc_top_e(self) -> float:
        """Signal at which the converter saturates."""
        chip = self.processing.detector
        return (chip.largest_dn - chip.offset_dn) / chip.gain_dn_per_e

    @property
    def catalogue_ends(self) -> bool:
        """Whether the sensor finds stars that the catalogue does not hold."""
        return self.view.depth_mag < self.value("limiting_magnitude_mag")

    def peak_share(self, electrons: float) -> float:
        """Charge of a star's brightest pixel over what a pixel can show."""
        return float(self.stars.centroid.peak.max()) * electrons / max(self.processing.top_e, 1e-9)

    def electrons(self, magnitude: FloatArray, temperature_k: float, radius_px: FloatArray | float = 0.0) -> FloatArray:
        """Electrons in one exposure of stars of magnitudes (n,)."""
        m = np.atleast_1d(np.asarray(magnitude, float))
        kelvin, radius = np.full(len(m), float(temperature_k)), np.broadcast_to(np.asarray(radius_px, float), m.shape)
        return self.state.electrons_per_s(m, kelvin, radius) * exposed_s(self.config)


def exposed_s(config: PredictedSensorConfig) -> float:
    """Exposure time, reduced by the unexplained loss of light."""
    return config.instrument.exposure_s * config.throughput_fraction


def detector_radii(state: OpticalState) -> FloatArray:
    """Distances from the middle of places (n,) that lie evenly over the detector."""
    camera, part = state.instrument.camera, (np.arange(16) + 0.5) / 16.0 - 0.5
    x, y = np.meshgrid(part * camera.width_px, part * camera.height_px)
    return np.hypot(x, y).ravel()


def colour_distance(temperature_k: FloatArray, reference_k: float) -> FloatArray:
    """How far a colour lies from the reference, 1 at 3500 or 10 000 K; in 1/T, as colours are spaced."""
    inverse, middle = 1.0 / np.asarray(temperature_k), 1.0 / reference_k
    cold, hot = max(1.0 / COLD_K - middle, 1e-6), max(middle - 1.0 / HOT_K, 1e-6)
    return np.asarray(np.where(inverse > middle, (inverse - middle) / cold, (middle - inverse) / hot))


# --- The prediction


def predict_camera(config: PredictedSensorConfig) -> CameraPrediction:
    """Predict a sensor.

    Results of lens, pass band and detector are kept from call to call, so that sweeps over exposure, noise or
    processing cost a fraction of a second per point.
    """
    state = optical_state(config)
    processing = _processing(config, state)
    stars = _star_errors(config, state, processing)
    limit = _limits(config, state, stars)
    if limit[0.5] <= BRIGHTEST_MAG:
        remark = (
            focus_remark(state.instrument, state.light.wavelength_nm[0], state.share)
            or "the signal of every star is below the noise"
        )
        raise DomainError(f"half of the stars of {limit[0.5]:g} mag are not detected; {remark}")
    view = sky_view(config, limit[0.5] + DEEPER_MAG)
    attitude = _attitude(config, state, processing, stars, view)
    return CameraPrediction(
        config=config, state=state, processing=processing, stars=stars, view=view, attitude=attitude, limits_mag=limit
    )


def _processing(config: PredictedSensorConfig, state: OpticalState) -> Processing:
    chip = state.instrument.detector
    detector = replace(
        overridden(configured_detector(config.instrument), config.detector),
        chip_width_px=chip.chip_width_px,
        chip_height_px=chip.chip_height_px,
    )
    setting = config.instrument
    pixel = PixelNoise.of(detector, temperature_c=setting.chip_temperature_c, exposure_s=setting.exposure_s)
    background = config.background_e_per_s * setting.exposure_s
    empty = float(pixel.temporal_e2(0.0, dark_frames=config.dark_frames))
    noise = NoiseModel(
        read_noise_e=float(np.sqrt(empty - pixel.rounding_e2)),
        gain_dn_per_e=detector.gain_dn_per_e,
        offset_dn=detector.offset_dn,
        quantised=True,
    )
    spread = float(np.sqrt(pixel.floor_e4)) / (empty + background)
    pixels = detector.width_px * detector.height_px
    sound = PixelNoise.of(
        replace(detector, damage_centres_per_px=0.0),
        temperature_c=setting.chip_temperature_c,
        exposure_s=setting.exposure_s,
    )
    clean_e2 = float(sound.temporal_e2(background, dark_frames=config.dark_frames))
    dark_s = detector.dark_factor(setting.chip_temperature_c) * setting.exposure_s * (1.0 + 1.0 / config.dark_frames)
    damage, share = damage_steps(detector)
    estimated = clipped_noise(float(np.sqrt(sound.floor_e4)) / clean_e2, damage * dark_s / clean_e2, share)
    threshold = config.threshold_sigma
    if config.false_alarms_per_frame is not None:
        threshold = threshold_for_false_alarms(
            config.false_alarms_per_frame, pixels, fwhm_px=state.fwhm_px, noise_spread=spread
        )
        threshold /= estimated
    top = min(detector.full_well_e, (detector.largest_dn - detector.offset_dn) / detector.gain_dn_per_e)
    return Processing(
        detector=detector,
        pixel=pixel,
        noise=noise,
        background_e=background,
        empty_e2=empty + background,
        threshold_sigma=threshold,
        estimated=estimated,
        fwhm_px=state.fwhm_px,
        noise_spread=spread,
        top_e=float(top - background - pixel.dark_e),
    )


def _star_errors(config: PredictedSensorConfig, state: OpticalState, processing: Processing) -> StarErrors:
    electrons = np.geomspace(FAINTEST_E, 30.0 * max(processing.top_e, FAINTEST_E), FLUX_KNOTS)
    pixel = processing.pixel
    noise = replace(processing.noise, read_noise_e=float(np.sqrt(pixel.floor_e2 - pixel.rounding_e2)))
    response = None
    if not centroider_class(config.centroid).needs_epsf:
        told = PLAIN if config.centroid in SCALE_FREE else noise
        response = _response(state, config.centroid, config.window_px, told)
    errors = predict_centroids(
        config.centroid,
        state.psfs,
        electrons,
        noise=noise,
        background_e=processing.background_e,
        prnu=pixel.prnu,
        offset_e=float(np.sqrt(pixel.floor_e2 / config.dark_frames)),  # the mean dark frame is the same in all frames
        window_px=config.window_px,
        response=response,
    )
    colour = np.zeros_like(errors.noise_px)
    if centroider_class(config.centroid).needs_epsf:
        for other in (state.cold_psfs, state.hot_psfs):
            bias = psf_mismatch(
                state.psfs,
                other,
                electrons,
                noise=processing.noise,
                background_e=processing.background_e,
                window_px=config.window_px,
                phases=2,
            )
            colour = np.maximum(colour, bias)
    windows = phase_windows(state.psfs, max(config.window_px, 9), phases=3)
    # a Gaussian of the mean width, matched: at half the chance the others lie within a factor of a few
    half = processing.threshold_sigma * np.sqrt(processing.empty_e2 * 4.0 * np.pi) * processing.fwhm_px / 2.3548
    flux = half * np.geomspace(*FOUND_RANGE, FOUND_KNOTS)
    found = detection_probability(
        windows.light,
        flux,
        empty_e2=processing.empty_e2,
        threshold_sigma=processing.threshold_sigma * processing.estimated,
        fwhm_px=processing.fwhm_px,
    )
    return StarErrors(
        radius_px=state.radius_px,
        centroid=errors,
        colour_px=colour,
        sharpness=np.stack([_sharpness(other, state.psfs) for other in (state.cold_psfs, state.hot_psfs)]),
        found_electrons=flux,
        found=found.reshape(len(flux), len(state.psfs), -1).mean(2).T,
    )


def _sharpness(psfs: tuple[EffectivePsf, ...], reference: tuple[EffectivePsf, ...]) -> FloatArray:
    """Root of the sum of squares, relative: response of a matched filter in white noise (f,)."""
    return np.array([np.sqrt((a.values**2).sum() / (b.values**2).sum()) for a, b in zip(psfs, reference, strict=True)])


@lru_cache(maxsize=32)
def _response(state: OpticalState, centroid: str, window_px: int, noise: NoiseModel) -> CentroidResponse:
    """Response of a centroider without a PSF; kept, as it takes longer than all the rest."""
    return CentroidResponse(centroid, state.psfs, (FAINTEST_E, BRIGHTEST_E), noise=noise, window_px=window_px, phases=3)


def _limits(config: PredictedSensorConfig, state: OpticalState, stars: StarErrors) -> dict[float, float]:
    """Magnitudes at which 90 % and 50 % of the stars all over the detector are found."""
    radius = detector_radii(state)
    zero = state.electrons_per_s(np.zeros(len(radius)), np.full(len(radius), config.star.temperature_k), radius)
    magnitude = np.arange(-6.0, 20.0, 0.05)
    electrons = zero * exposed_s(config) * 10.0 ** (-0.4 * magnitude[:, None])
    share = stars.found_at(electrons.ravel(), np.tile(radius, len(magnitude))).reshape(electrons.shape).mean(1)
    return {level: float(np.interp(-level, -share, magnitude)) for level in (0.9, 0.5)}


def _attitude(
    config: PredictedSensorConfig, state: OpticalState, processing: Processing, stars: StarErrors, view: SkyView
) -> AttitudeForecast:
    sample, r = view.sample, view.radius_px
    electrons = state.electrons_per_s(view.magnitude, view.temperature_k, r) * exposed_s(config)
    shown = stars.effective(electrons, view.temperature_k, r, config.star.temperature_k)
    share = seen = stars.found_at(shown, r)
    # two equal Gaussians, filtered with their own width, have one maximum up to two standard deviations of the sum
    merged = view.brighter_px < 2.0 * np.sqrt(2.0) * processing.fwhm_px / 2.3548
    seen = np.where(merged, 0.0, seen)
    peak = np.interp(r, stars.radius_px, stars.centroid.peak)
    share = np.where(peak * electrons > processing.top_e, 0.0, share)
    chip = processing.detector
    edge = config.window_px // 2 - 0.5
    size = np.array([chip.width_px, chip.height_px])
    whole = ((sample.pixel_px > edge) & (sample.pixel_px < size - 1 - edge)).all(axis=1)
    share = np.where(whole, share, 0.0) * (1.0 - chip.hot_fraction - chip.dead_fraction) ** (config.window_px**2)
    # a neighbour within the window spoils both, if it is found
    beside = electrons * 10.0 ** (-0.4 * (view.neighbour_mag - view.magnitude))
    share = share * (1.0 - stars.found_at(beside, r))
    noise = stars.sigma_at(stars.centroid.noise_px, shown, r)
    static = stars.sigma_at(np.hypot(stars.centroid.pattern_px, stars.centroid.phase_px), electrons, r)
    colour = state.colour_shift_px(view.temperature_k, r)
    spot = stars.sigma_at(stars.colour_px, electrons, r) * colour_distance(
        view.temperature_k, config.star.temperature_k
    )
    variance = noise**2 + static**2 + 0.5 * colour**2 + spot**2
    pixel_rad = state.pixel_arcsec / RAD_ARCSEC
    spread = []
    for square in (noise**2, variance):
        covariance = attitude_covariance(
            sample.direction, square * pixel_rad**2, sample.frame, sample.frames, share=share
        )
        spread.append(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) * RAD_ARCSEC)
    return AttitudeForecast(
        found=sample.summed(seen),
        found_variance=sample.summed(seen * (1.0 - seen)),
        stars=sample.summed(share),
        noise_arcsec=spread[0],
        total_arcsec=spread[1],
        sigma_px=np.sqrt(variance),
        chance=seen,
    )


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
class Accuracy:
    """The star of ``[star]``, one axis, one standard deviation; NaN where it saturates."""

    electrons_e: float = col("Electrons", "e-", ".0f")
    snr: float = col("Signal-to-noise ratio", "", ".1f")
    nea_arcsec: float = col("NEA", "arcsec", ".3f")
    pattern_arcsec: float = col("Pixel patterns", "arcsec", ".3f")
    phase_arcsec: float = col("Pixel phase", "arcsec", ".3f")
    colour_arcsec: float = col("Star colours", "arcsec", ".3f")
    single_star_arcsec: float = col("Single-star accuracy", "arcsec", ".3f")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sky:
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


def optics(prediction: CameraPrediction) -> Optics:
    """Numbers of the lens on this detector."""
    state, lens = prediction.state, prediction.state.performance
    camera = state.instrument.camera
    pitch, rms = camera.pixel_pitch_mm, lens.white.rms_mm()
    size = np.array([camera.width_px, camera.height_px, np.hypot(camera.width_px, camera.height_px)])
    tangent = np.interp(size / 2.0, state.area_radius_px, np.tan(np.radians(state.area_field_deg)))
    wide, high, diagonal = 2.0 * np.degrees(np.arctan(tangent))
    first, last = (int(np.abs(np.log(state.temperatures_k / t)).argmin()) for t in (COLD_K, HOT_K))
    return Optics(
        focal_length_mm=state.instrument.focal_length_mm,
        f_number=lens.f_number,
        pupil_mm=abs(lens.focal_length_mm) / lens.f_number,
        plate_scale_arcsec_per_mm=RAD_ARCSEC / lens.plate_scale_mm,
        pixel_arcsec=state.pixel_arcsec,
        field_width_deg=float(wide),
        field_height_deg=float(high),
        field_deg=float(min(wide, high)),
        field_diagonal_deg=float(diagonal),
        spot_axis_um=1e3 * float(rms[0]),
        spot_um=1e3 * float(rms.max()),
        spot_px=float(rms.max()) / pitch,
        best_focus_um=1e3 * lens.best_focus_mm,
        depth_of_focus_um=1e3 * lens.depth_of_focus_mm(pitch),
        distortion_percent=100.0 * float(np.abs(lens.distortion).max()),
        lateral_colour_px=float(np.ptp(lens.bundle_mm, axis=1).max() / pitch),
        star_colour_px=float(np.abs(state.colour_px[last] - state.colour_px[first]).max()),
        axial_colour_um=float(np.ptp(lens.axial_colour_mm) * 1e3),
        vignetting_percent=100.0 * float(1.0 - lens.vignetting.min()),
    )


def accuracy(prediction: CameraPrediction) -> Accuracy:
    """Numbers of the star that is quoted, mean over the detector."""
    config, state, processing = prediction.config, prediction.state, prediction.processing
    star, stars, radius = config.star, prediction.stars, detector_radii(state)
    electrons = prediction.electrons(np.full(len(radius), star.magnitude_mag), star.temperature_k, radius)
    pixel = state.pixel_arcsec

    def over_detector(sigma_px: FloatArray) -> float:
        return pixel * float(np.sqrt((stars.sigma_at(sigma_px, electrons, radius) ** 2).mean()))

    view = prediction.view
    bright = view.magnitude <= prediction.limits_mag[0.5]
    shift = state.colour_shift_px(view.temperature_k[bright], view.radius_px[bright])
    spot = over_detector(stars.colour_px) if stars.colour_px.any() else 0.0
    apart = colour_distance(view.temperature_k[bright], star.temperature_k)
    colour = float("nan")
    if bright.any():
        colour = float(np.hypot(pixel * np.sqrt(0.5 * (shift**2).mean()), spot * np.sqrt((apart**2).mean())))
    axis = float(prediction.electrons(np.array([star.magnitude_mag]), star.temperature_k)[0])
    quoted = 1.0 if prediction.peak_share(axis) <= 1.0 else float("nan")  # clipped spots have no predicted centroid
    noise = quoted * over_detector(stars.centroid.noise_px)
    pattern = quoted * over_detector(stars.centroid.pattern_px)
    phase = quoted * over_detector(stars.centroid.phase_px) if stars.centroid.phase_px.any() else quoted * 0.0
    light = phase_windows(state.psfs[:1], config.window_px).light
    snr = matched_snr(light, np.full(len(light), axis), processing.background_e, processing.noise)
    return Accuracy(
        electrons_e=axis,
        snr=quoted * float(snr.mean()),
        nea_arcsec=noise,
        pattern_arcsec=pattern,
        phase_arcsec=phase,
        colour_arcsec=colour,
        single_star_arcsec=float(np.sqrt(noise**2 + pattern**2 + phase**2 + np.nan_to_num(colour) ** 2)),
    )


def sky(prediction: CameraPrediction) -> Sky:
    """Numbers of detection and attitude."""
    config, processing, forecast = prediction.config, prediction.processing, prediction.attitude
    axis = float(prediction.electrons(np.array([config.star.magnitude_mag]), config.star.temperature_k)[0])
    attitudes = {}
    for kind, values in (("", forecast.total_arcsec), ("_noise", forecast.noise_arcsec)):
        across = np.sqrt((values[:, :2] ** 2).mean(1))
        for name, one in (("cross", across), ("roll", values[:, 2])):
            for part, level in (("", 0.5), ("_worst", 1.0 - WORST)):
                value = float(np.quantile(one, level, method="inverted_cdf"))
                attitudes[f"attitude_{name}{part}{kind}_arcsec"] = value
    full = max(prediction.peak_share(axis), 1e-9)
    timing, exposure_s = config.timing, config.instrument.exposure_s
    return Sky(
        saturation_mag=config.star.magnitude_mag + 2.5 * float(np.log10(full)),
        limiting_magnitude_mag=prediction.limits_mag[0.5],
        complete_magnitude_mag=prediction.limits_mag[0.9],
        threshold_sigma=processing.threshold_sigma,
        false_alarms_per_frame=processing.false_alarms,
        stars_mean_per_frame=float(forecast.stars.mean()),
        stars_worst_per_frame=float(np.quantile(forecast.stars, WORST)),
        update_rate_hz=1.0 / timing.period_s(exposure_s),
        latency_s=0.5 * exposure_s + timing.readout_s + timing.processing_s,
        **attitudes,
    )
