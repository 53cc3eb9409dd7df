"""What a star sensor will do, by prediction alone: lens, light, detection, centroids, attitude over the sky.

Everything is for stars at rest, alone in their window, and a camera whose geometry was calibrated without error: what a
laboratory adds (marking error of a target, its survey) belongs to the budget of the laboratory (experiment ``budget``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from calib.attitude.predicted import attitude_covariance
from calib.measure.centroid_prediction import CentroidErrors, phase_windows, predict_centroids
from calib.measure.crlb import matched_snr
from calib.measure.detection_statistics import detection_probability, false_alarms, threshold_for_false_alarms
from calib.records import NoiseModel
from experiments.camera.optical_state import OpticalState, optical_state
from experiments.camera.settings import Config
from experiments.camera.sky import SkyView, sky_view
from experiments.laboratory.detector_changes import overridden
from experiments.laboratory.instrument import configured_detector
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC
from render.detector.noise import PixelNoise
from render.detector.spec import Detector

__all__ = ["CameraPrediction", "Processing", "Scalar", "StarErrors", "predict_camera"]


FLUX_KNOTS = 14
FAINTEST_E = 20.0
DEEPER_MAG = 1.0
"""Stars that the sky is searched for are so much fainter than what half of the time is found."""
WORST = 0.01
"""Share of the sky that counts as its worst part."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scalar:
    """One number of a prediction.

    Attributes
    ----------
    value : float
        NaN where there is none.
    unit, label, format : str
        For tables.
    """

    value: float
    unit: str
    label: str
    format: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Processing:
    """How frames are measured, and the noise that counts there.

    Attributes
    ----------
    detector : Detector
        With the changes of the configuration, cut to the window.
    pixel : PixelNoise
        Of a pixel in one exposure.
    noise : NoiseModel
        Of a frame minus the mean dark frame, without the even light.
    background_e : float
        Even light in a pixel.
    empty_e2 : float
        Temporal variance of a pixel without star.
    threshold_sigma : float
        Detection limit.
    fwhm_px : float
        Width of the detection filter.
    noise_spread : float
        Standard deviation over the pixels of the variance, relative.
    top_e : float
        Electrons at which a pixel saturates.
    """

    detector: Detector
    pixel: PixelNoise
    noise: NoiseModel
    background_e: float
    empty_e2: float
    threshold_sigma: float
    fwhm_px: float
    noise_spread: float
    top_e: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StarErrors:
    """Errors and detection against the electrons of a star, at f distances from the middle of the detector.

    Attributes
    ----------
    radius_px : (f,)
        Distances.
    centroid : CentroidErrors
        Noise, patterns, pixel phase.
    found : (f, k)
        Probability of a detection.
    """

    radius_px: FloatArray
    centroid: CentroidErrors
    found: FloatArray

    def at(self, values: FloatArray, electrons: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Values (f, k) at stars (n,), linear in distance and in the logarithm of the electrons."""
        from scipy.ndimage import map_coordinates

        log = np.log(self.centroid.electrons)
        k = np.interp(np.log(np.maximum(electrons, 1e-9)), log, np.arange(len(log)))
        r = np.interp(radius_px, self.radius_px, np.arange(len(self.radius_px)))
        return np.asarray(map_coordinates(values, np.stack([r, k]), order=1, mode="nearest"))

    def sigma_at(self, sigma_px: FloatArray, electrons: FloatArray, radius_px: FloatArray) -> FloatArray:
        """The same for positive values that follow powers of the electrons: interpolated in their logarithm."""
        return np.exp(self.at(np.log(np.maximum(sigma_px, 1e-12)), electrons, radius_px))


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeForecast:
    """Over f attitudes of the sky.

    Attributes
    ----------
    stars : (f,)
        Expected number of stars that are found and fit.
    noise_arcsec, total_arcsec : (f, 3)
        One standard deviation about x, y (across) and z (roll): by temporal noise; with patterns, pixel phase and star
        colours. Infinite where too few stars are seen.
    """

    stars: FloatArray
    noise_arcsec: FloatArray
    total_arcsec: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraPrediction:
    """Everything that was predicted.

    Attributes
    ----------
    config : Config
        For which sensor.
    state : OpticalState
        Lens and light.
    processing : Processing
        Detector and noise.
    stars : StarErrors
        Errors against electrons.
    view : SkyView
        Sky.
    attitude : AttitudeForecast
        Attitudes.
    scalars : mapping of str to Scalar
        Single numbers by name, the same names for every sensor.
    """

    config: Config
    state: OpticalState
    processing: Processing
    stars: StarErrors
    view: SkyView
    attitude: AttitudeForecast
    scalars: Mapping[str, Scalar]

    def value(self, name: str) -> float:
        """A scalar by name."""
        return self.scalars[name].value

    def electrons(self, magnitude: FloatArray, temperature_k: float, radius_px: FloatArray | float = 0.0) -> FloatArray:
        """Electrons in one exposure of stars of magnitudes (n,)."""
        m = np.atleast_1d(np.asarray(magnitude, float))
        kelvin, radius = np.full(len(m), float(temperature_k)), np.broadcast_to(np.asarray(radius_px, float), m.shape)
        return self.state.electrons_per_s(m, kelvin, radius) * exposed_s(self.config)


def exposed_s(config: Config) -> float:
    """Exposure time, shortened by light that is lost where nobody knows."""
    return config.instrument.exposure_s * config.throughput_fraction


def predict_camera(config: Config) -> CameraPrediction:
    """Predict a sensor.

    What lens, pass band and detector do is kept from call to call, so that sweeps over exposure, noise or processing
    cost a fraction of a second per point.

    Parameters
    ----------
    config : Config
        The sensor.

    Raises
    ------
    StarbenchError
        Whatever the configuration does not go together with: see `optical_state`, `sky_view`, `predict_centroids`.
    """
    state = optical_state(config)
    processing = _processing(config, state)
    stars = _star_errors(config, state, processing)
    limit = _limits(config, state, stars)
    view = sky_view(config, limit[0.5] + DEEPER_MAG)
    attitude = _attitude(config, state, processing, stars, view)
    prediction = CameraPrediction(
        config=config,
        state=state,
        processing=processing,
        stars=stars,
        view=view,
        attitude=attitude,
        scalars={},
    )
    scalars = _lens_scalars(prediction) | _star_scalars(prediction, limit) | _sky_scalars(prediction)
    return replace(prediction, scalars=MappingProxyType(scalars))


def _processing(config: Config, state: OpticalState) -> Processing:
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
    threshold = config.threshold_sigma
    if config.false_alarms_per_frame is not None:
        threshold = threshold_for_false_alarms(
            config.false_alarms_per_frame, pixels, fwhm_px=state.fwhm_px, noise_spread=spread
        )
    top = min(detector.full_well_e, (detector.largest_dn - detector.offset_dn) / detector.gain_dn_per_e)
    return Processing(
        detector=detector,
        pixel=pixel,
        noise=noise,
        background_e=background,
        empty_e2=empty + background,
        threshold_sigma=threshold,
        fwhm_px=state.fwhm_px,
        noise_spread=spread,
        top_e=float(top - background - pixel.dark_e),
    )


def _star_errors(config: Config, state: OpticalState, processing: Processing) -> StarErrors:
    electrons = np.geomspace(FAINTEST_E, 30.0 * max(processing.top_e, FAINTEST_E), FLUX_KNOTS)
    pixel = processing.pixel
    errors = predict_centroids(
        config.centroid,
        state.psfs,
        electrons,
        noise=processing.noise,
        background_e=processing.background_e,
        prnu=pixel.prnu,
        offset_e=float(np.sqrt(pixel.floor_e2 / config.dark_frames)),  # the mean dark frame is the same in all frames
        window_px=config.window_px,
    )
    windows = phase_windows(state.psfs, max(config.window_px, 9))
    found = detection_probability(
        windows.light,
        electrons,
        empty_e2=processing.empty_e2,
        threshold_sigma=processing.threshold_sigma,
        fwhm_px=processing.fwhm_px,
    )
    return StarErrors(
        radius_px=state.radius_px,
        centroid=errors,
        found=found.reshape(len(electrons), len(state.psfs), -1).mean(2).T,
    )


def _detector_radii(state: OpticalState) -> FloatArray:
    """Distances from the middle of places (n,) that lie evenly over the detector."""
    camera, part = state.instrument.camera, (np.arange(16) + 0.5) / 16.0 - 0.5
    x, y = np.meshgrid(part * camera.width_px, part * camera.height_px)
    return np.hypot(x, y).ravel()


def _limits(config: Config, state: OpticalState, stars: StarErrors) -> dict[float, float]:
    """Magnitudes at which 90 % and 50 % of the stars all over the detector are found."""
    radius = _detector_radii(state)
    zero = state.electrons_per_s(np.zeros(len(radius)), np.full(len(radius), config.star.temperature_k), radius)
    magnitude = np.arange(-6.0, 20.0, 0.05)
    electrons = zero * exposed_s(config) * 10.0 ** (-0.4 * magnitude[:, None])
    share = stars.at(stars.found, electrons.ravel(), np.tile(radius, len(magnitude))).reshape(electrons.shape)
    share = np.where(electrons < stars.centroid.electrons[0], 0.0, share).mean(1)
    return {level: float(np.interp(-level, -share, magnitude)) for level in (0.9, 0.5)}


def _attitude(
    config: Config, state: OpticalState, processing: Processing, stars: StarErrors, view: SkyView
) -> AttitudeForecast:
    sample, r = view.sample, view.radius_px
    electrons = state.electrons_per_s(view.magnitude, view.temperature_k, r) * exposed_s(config)
    share = np.where(electrons < stars.centroid.electrons[0], 0.0, stars.at(stars.found, electrons, r))
    peak = np.interp(r, stars.radius_px, stars.centroid.peak)
    share = np.where(peak * electrons > processing.top_e, 0.0, share)
    # a neighbour within the window spoils both, if it is found
    beside = electrons * 10.0 ** (-0.4 * (view.neighbour_mag - view.magnitude))
    share = share * (1.0 - np.where(beside > stars.centroid.electrons[0], stars.at(stars.found, beside, r), 0.0))
    noise = stars.sigma_at(stars.centroid.noise_px, electrons, r)
    static = stars.sigma_at(np.hypot(stars.centroid.pattern_px, stars.centroid.phase_px), electrons, r)
    colour = state.colour_shift_px(view.temperature_k, r)
    variance = noise**2 + static**2 + 0.5 * colour**2
    pixel_rad = state.pixel_arcsec / RAD_ARCSEC
    spread = []
    for square in (noise**2, variance):
        covariance = attitude_covariance(
            sample.direction, square * pixel_rad**2, sample.frame, sample.frames, share=share
        )
        spread.append(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) * RAD_ARCSEC)
    return AttitudeForecast(stars=sample.summed(share), noise_arcsec=spread[0], total_arcsec=spread[1])


def _lens_scalars(prediction: CameraPrediction) -> dict[str, Scalar]:
    state, lens = prediction.state, prediction.state.performance
    camera = state.instrument.camera
    half = np.array([camera.width_px, camera.height_px]) * camera.pixel_pitch_mm / 2.0 / lens.plate_scale_mm
    wide, high = 2.0 * np.degrees(np.arctan(half))
    diagonal = 2.0 * float(np.degrees(np.arctan(np.hypot(*half))))
    pitch, rms = camera.pixel_pitch_mm, lens.white.rms_mm()
    colour = np.ptp(lens.bundle_mm, axis=1).max() / pitch
    first, last = (int(np.abs(np.log(state.temperatures_k / t)).argmin()) for t in (3500.0, 10000.0))
    stars = np.abs(state.colour_px[last] - state.colour_px[first]).max()
    axial = np.ptp(lens.axial_colour_mm) * 1e3
    return {
        "focal_length_mm": Scalar(value=lens.focal_length_mm, unit="mm", label="Focal length", format=".3f"),
        "f_number": Scalar(value=lens.f_number, unit="", label="F-number", format=".2f"),
        "pupil_mm": Scalar(
            value=abs(lens.focal_length_mm) / lens.f_number, unit="mm", label="Entrance pupil", format=".2f"
        ),
        "plate_scale_arcsec_per_mm": Scalar(
            value=RAD_ARCSEC / lens.plate_scale_mm, unit="arcsec/mm", label="Plate scale", format=".1f"
        ),
        "pixel_arcsec": Scalar(value=state.pixel_arcsec, unit="arcsec", label="Angle of a pixel", format=".3f"),
        "field_width_deg": Scalar(value=float(wide), unit="deg", label="Field, width", format=".2f"),
        "field_height_deg": Scalar(value=float(high), unit="deg", label="Field, height", format=".2f"),
        "field_deg": Scalar(value=float(min(wide, high)), unit="deg", label="Field, shorter side", format=".2f"),
        "field_diagonal_deg": Scalar(value=diagonal, unit="deg", label="Field, diagonal", format=".2f"),
        "spot_axis_um": Scalar(value=1e3 * float(rms[0]), unit="um", label="Spot radius (RMS) on axis", format=".2f"),
        "spot_um": Scalar(value=1e3 * float(rms.max()), unit="um", label="Spot radius (RMS), largest", format=".2f"),
        "spot_px": Scalar(value=float(rms.max()) / pitch, unit="px", label="Spot radius (RMS), largest", format=".3f"),
        "best_focus_um": Scalar(
            value=1e3 * lens.best_focus_mm, unit="um", label="Best focus, from the detector", format=".1f"
        ),
        "depth_of_focus_um": Scalar(
            value=1e3 * lens.depth_of_focus_mm(pitch), unit="um", label="Depth of focus, ±", format=".1f"
        ),
        "distortion_percent": Scalar(
            value=100.0 * float(np.abs(lens.distortion).max()),
            unit="percent",
            label="Distortion, largest",
            format=".3f",
        ),
        "lateral_colour_px": Scalar(
            value=float(colour), unit="px", label="Lateral colour over the pass band", format=".3f"
        ),
        "star_colour_px": Scalar(
            value=float(stars), unit="px", label="Shift of a 10 000 K against a 3500 K star", format=".3f"
        ),
        "axial_colour_um": Scalar(value=float(axial), unit="um", label="Axial colour over the pass band", format=".1f"),
        "vignetting_percent": Scalar(
            value=100.0 * float(1.0 - lens.vignetting.min()), unit="percent", label="Vignetting, largest", format=".2f"
        ),
    }


def _star_scalars(prediction: CameraPrediction, limits: Mapping[float, float]) -> dict[str, Scalar]:
    config, state, processing = prediction.config, prediction.state, prediction.processing
    star, stars, radius = config.star, prediction.stars, _detector_radii(state)
    electrons = prediction.electrons(np.full(len(radius), star.magnitude_mag), star.temperature_k, radius)
    pixel = state.pixel_arcsec

    def over_detector(sigma_px: FloatArray) -> float:
        return pixel * float(np.sqrt((stars.sigma_at(sigma_px, electrons, radius) ** 2).mean()))

    noise, pattern = over_detector(stars.centroid.noise_px), over_detector(stars.centroid.pattern_px)
    phase = over_detector(stars.centroid.phase_px) if stars.centroid.phase_px.any() else 0.0
    view = prediction.view
    seen = view.magnitude <= limits[0.5]
    shift = state.colour_shift_px(view.temperature_k[seen], view.radius_px[seen])
    colour = pixel * float(np.sqrt(0.5 * (shift**2).mean())) if seen.any() else float("nan")
    axis = float(prediction.electrons(np.array([star.magnitude_mag]), star.temperature_k)[0])
    full = float(stars.centroid.peak.max()) * axis / max(processing.top_e, 1e-9)
    pixels = processing.detector.width_px * processing.detector.height_px
    alarms = float(
        false_alarms(processing.threshold_sigma, pixels, fwhm_px=state.fwhm_px, noise_spread=processing.noise_spread)
    )
    windows = phase_windows(state.psfs[:1], config.window_px)
    snr = float(
        matched_snr(windows.light, np.full(len(windows.light), axis), processing.background_e, processing.noise).mean()
    )
    what = f"of a star of {star.magnitude_mag:g} mag"
    return {
        "electrons_e": Scalar(value=axis, unit="e-", label=f"Electrons {what}", format=".0f"),
        "snr": Scalar(value=snr, unit="", label=f"Signal-to-noise ratio {what}", format=".1f"),
        "saturation_mag": Scalar(
            value=star.magnitude_mag + 2.5 * float(np.log10(max(full, 1e-9))),
            unit="mag",
            label="Brightest star that does not saturate",
            format=".2f",
        ),
        "limiting_magnitude_mag": Scalar(
            value=limits[0.5], unit="mag", label="Limiting magnitude, half are found", format=".2f"
        ),
        "complete_magnitude_mag": Scalar(
            value=limits[0.9], unit="mag", label="Limiting magnitude, 90 % are found", format=".2f"
        ),
        "threshold_sigma": Scalar(
            value=processing.threshold_sigma, unit="sigma", label="Detection limit", format=".2f"
        ),
        "false_alarms_per_frame": Scalar(value=alarms, unit="", label="False alarms per frame", format=".3g"),
        "nea_arcsec": Scalar(value=noise, unit="arcsec", label=f"NEA {what}", format=".3f"),
        "pattern_arcsec": Scalar(value=pattern, unit="arcsec", label="Pixel patterns", format=".3f"),
        "phase_arcsec": Scalar(value=phase, unit="arcsec", label="Pixel phase", format=".3f"),
        "colour_arcsec": Scalar(value=colour, unit="arcsec", label="Star colours", format=".3f"),
        "single_star_arcsec": Scalar(
            value=float(np.sqrt(noise**2 + pattern**2 + phase**2 + np.nan_to_num(colour) ** 2)),
            unit="arcsec",
            label=f"Single-star accuracy {what}",
            format=".3f",
        ),
    }


def _sky_scalars(prediction: CameraPrediction) -> dict[str, Scalar]:
    forecast = prediction.attitude
    exposure = prediction.config.instrument.exposure_s
    found = {
        "stars_mean_per_frame": Scalar(
            value=float(forecast.stars.mean()), unit="", label="Stars per frame, mean over the sky", format=".1f"
        ),
        "stars_worst_percent_per_frame": Scalar(
            value=float(np.quantile(forecast.stars, WORST)),
            unit="",
            label="Stars per frame, worst 1 % of the sky",
            format=".1f",
        ),
        "update_rate_hz": Scalar(
            value=1.0 / exposure, unit="Hz", label="Frames per second that the exposure allows", format=".3g"
        ),
    }
    for kind, values in (("", forecast.total_arcsec), ("_noise", forecast.noise_arcsec)):
        cross = np.sqrt((values[:, :2] ** 2).mean(1))
        by = ", noise alone" if kind else ""
        for name, one, words in (("cross", cross, "across"), ("roll", values[:, 2], "roll")):
            for part, level, where in (("", 0.5, "median"), ("_worst", 1.0 - WORST, "worst 1 % of the sky")):
                found[f"attitude_{name}{part}{kind}_arcsec"] = Scalar(
                    value=float(np.quantile(one, level, method="inverted_cdf")),
                    unit="arcsec",
                    label=f"Attitude {words}, {where}{by}",
                    format=".3f",
                )
    return found
