"""What a star sensor will do, by prediction alone: lens, light, detection, centroids, attitude over the sky.

Everything is for stars at rest or trailing evenly (`slew`), alone in their window, and a camera whose geometry was
calibrated without error: what a laboratory adds (marking error of a target, its survey) belongs to the budget of the
laboratory (experiment ``budget``).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from calib.attitude.predicted import attitude_covariance
from calib.measure.centroid import centroider_class
from calib.measure.centroid_prediction import (
    SCALE_FREE,
    CentroidResponse,
    phase_windows,
    predict_centroids,
    psf_mismatch,
)
from calib.measure.detection_statistics import (
    clipped_noise,
    detection_probability,
    threshold_for_false_alarms,
)
from calib.records import NoiseModel
from experiments.camera.optical_state import OpticalState, optical_state
from experiments.camera.records import (
    AttitudeForecast,
    CameraPrediction,
    Processing,
    StarErrors,
    colour_distance,
    detector_radii,
    exposed_s,
)
from experiments.camera.scalars import scalars_of
from experiments.camera.settings import Config
from experiments.camera.sky import SkyView, sky_view
from experiments.laboratory.detector_changes import overridden
from experiments.laboratory.instrument import configured_detector
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC
from render.detector.noise import PixelNoise
from render.records import EffectivePsf

__all__ = ["CameraPrediction", "predict_camera"]


FLUX_KNOTS = 14
PLAIN = NoiseModel(read_noise_e=10.0)
"""For centroiders that take no notice of the noise."""
FAINTEST_E, BRIGHTEST_E = 20.0, 1e6
FOUND_KNOTS, FOUND_RANGE = 32, (0.2, 8.0)
DEEPER_MAG = 1.0
"""Stars that the sky is searched for are so much fainter than what half of the time is found."""


def predict_camera(config: Config) -> CameraPrediction:
    """Predict a sensor.

    What lens, pass band and detector do is kept from call to call, so that sweeps over exposure, noise or processing
    cost a fraction of a second per point.
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
    return replace(prediction, scalars=MappingProxyType(scalars_of(prediction, limit)))


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
    threshold, estimated = config.threshold_sigma, clipped_noise(spread)
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


def _star_errors(config: Config, state: OpticalState, processing: Processing) -> StarErrors:
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
    """Root of the sum of squares, relative: what a matched filter makes of the same light in white noise (f,)."""
    return np.array([np.sqrt((a.values**2).sum() / (b.values**2).sum()) for a, b in zip(psfs, reference, strict=True)])


@lru_cache(maxsize=32)
def _response(state: OpticalState, centroid: str, window_px: int, noise: NoiseModel) -> CentroidResponse:
    """Response of a centroider without a PSF; kept, as it takes longer than all the rest."""
    return CentroidResponse(centroid, state.psfs, (FAINTEST_E, BRIGHTEST_E), noise=noise, window_px=window_px, phases=3)


def _limits(config: Config, state: OpticalState, stars: StarErrors) -> dict[float, float]:
    """Magnitudes at which 90 % and 50 % of the stars all over the detector are found."""
    radius = detector_radii(state)
    zero = state.electrons_per_s(np.zeros(len(radius)), np.full(len(radius), config.star.temperature_k), radius)
    magnitude = np.arange(-6.0, 20.0, 0.05)
    electrons = zero * exposed_s(config) * 10.0 ** (-0.4 * magnitude[:, None])
    share = stars.found_at(electrons.ravel(), np.tile(radius, len(magnitude))).reshape(electrons.shape).mean(1)
    return {level: float(np.interp(-level, -share, magnitude)) for level in (0.9, 0.5)}


def _attitude(
    config: Config, state: OpticalState, processing: Processing, stars: StarErrors, view: SkyView
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
    )
