"""Error budget of the flight without frames: errors of guide stars, and the resulting attitude error.

A star's errors come from the camera report's prediction (noise, pixel patterns and pixel phase against its electrons)
and from ray traces (colour, residual distortion, heated lens); `calib.attitude.attitude_covariance`
turns them into errors of the attitude.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.accuracy.attitude_terms import AttitudeErrors
from calib.accuracy.star_errors import colour_distance
from calib.attitude.attitude_covariance import attitude_of_shifts, attitude_of_velocity, covariance_of_noise
from calib.attitude.tracker import GuideCatalogue, expected_guides
from calib.cameras.base import CameraModel
from calib.cameras.fit import fit_camera
from calib.measure.centroid_error.prediction import fit_bias
from calib.measure.centroiding.registry import centroider_class
from experiments.flight.scenario import Flight
from experiments.flight.settings import FlightConfig
from experiments.laboratory.sensor_prediction import CameraPrediction, detector_radii, predict_camera
from experiments.laboratory.settings.prediction import PredictedSensorConfig, SlewConfig, aged_config
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.field_map import FieldMap, fit_field_map, fit_similarity
from optics.lens.heated_lens import COMPONENTS, ThermalState, heated_lens
from optics.lens.system import LensSystem
from optics.units import RAD_ARCSEC
from render.motion.trajectory import trail_of_rate
from render.records import EffectivePsf
from render.sensor_file.catalogue import load_catalogue
from render.sensor_file.instrument import build_instrument, configured_lens, housing_of
from render.sky.sky import load_sky

STEP_K = {"mean_k": 1.0, "axial_k": 0.5, "transverse_x_k": 0.2, "transverse_y_k": 0.2, "radial_k": 0.5}
"""Steps of the central differences of the thermal sensitivities."""
SATURATION_MARGIN_MAG = 0.3
"""Guide stars are fainter than the saturation limit by this."""
GUIDE_MARGIN_MAG = 1.5
"""Guide stars are brighter than the limiting magnitude by this, where no limit is stated."""
SKY_ATTITUDES = 60
"""Attitudes of the prediction, of which the flight uses the star errors only."""
AZIMUTH_DEG = 22.5
"""Azimuth of the predicted PSFs about the middle of the detector."""
MIN_HEATED_K = 0.1
"""Least temperature change of the heated PSFs, to either side."""
BIAS_STAR_K = 5800.0
"""Temperature of the star whose brightness the bias of fits is computed for."""
AT_REST_PX = 0.1
"""Shorter trails are predicted as at rest."""
BACKGROUND_STEP = 1.02
"""Ratio of the backgrounds of cached predictions."""


def heated(config: FlightConfig, state_k: FloatArray) -> LensSystem:
    """The configured lens in a state (5,), in the order of `COMPONENTS`.

    Raises
    ------
    DomainError
        A lens without thermal data, or a temperature beyond that of its glasses.
    """
    lens = configured_lens(config.instrument)
    if not np.any(state_k):
        return lens
    if lens.measured is not None:
        raise DomainError(
            f"lens {lens.name!r} is a measured lens without a thermal model; set offset_k, mean_k and "
            "eclipse_k of [temperature] to 0"
        )
    try:
        return heated_lens(lens, ThermalState.of(np.asarray(state_k, float)), housing_of(config.instrument.housing))
    except DomainError as error:
        raise DomainError(f"temperature: {error}") from None


@dataclass(frozen=True, slots=True, kw_only=True)
class GuideStarErrors:
    """Centroid errors of n guide stars on the detector; standard deviations per axis."""

    noise_px: FloatArray  # (n,) Temporal noise
    pattern_px: FloatArray  # (n,) Fixed pattern of the pixels
    phase_px: FloatArray  # (n,) Pixel phase (S-curve)
    colour_phase_px: FloatArray  # (n,) Pixel phase of spots of other colours than the calibrated PSF
    shift_px: FloatArray  # (n, 2) Shift by colour and residual distortion


class Budget:
    """Calibrated sensor, guide stars, and errors at any time; see `build_budget`."""

    def __init__(self, config: FlightConfig, flight: Flight, *, old: bool = False) -> None:
        self.config, self.flight, self.old = config, flight, old
        self.sensor = _sensor(config, old)
        self.nominal: CameraPrediction = self.camera(0.0)
        state = self.nominal.state
        self.instrument: Any = state.sensor
        self._map = self.instrument.pixel_map(state.band, temperature_k=config.star_temperature_k)
        self.model: CameraModel = fit_camera(self._map).camera
        self.pixel_rad = self.model.pixel_angle_rad
        self.pixel_arcsec = self.pixel_rad * RAD_ARCSEC
        residual = self._map.pixel_px - self.model.project(self._map.direction)
        self._residual = fit_field_map(self._map.direction, residual)
        catalogue = config.catalogue
        self.sky = load_sky(
            load_catalogue(catalogue),
            faintest_mag=catalogue.faintest_mag,
            epoch_year=catalogue.epoch_year,
            temperature=catalogue.temperature,
        )
        self.guides = self._guides()

    # --- Sky

    def _guides(self) -> GuideCatalogue:
        camera = self.nominal
        limit = camera.value("limiting_magnitude_mag") - GUIDE_MARGIN_MAG
        stated = self.config.tracker.faintest_mag
        return camera.guide_stars(
            self.sky.catalog,
            self.sky.direction,
            brightest_mag=camera.value("saturation_mag") + SATURATION_MARGIN_MAG,
            faintest_mag=limit if stated is None else stated,
            throughput=self.sensor.throughput_fraction / camera.config.throughput_fraction,
        )

    # --- The camera's prediction

    def camera(self, background_e_per_s: float, rate_rad_per_s: FloatArray | None = None) -> CameraPrediction:
        """Prediction of the experiment camera for a background and for the star trails of a rate."""
        rate = np.zeros(3) if rate_rad_per_s is None else rate_rad_per_s
        level = 0.0
        if background_e_per_s > 1.0:
            level = BACKGROUND_STEP ** round(np.log(background_e_per_s) / np.log(BACKGROUND_STEP))
        return _camera(self.sensor.model_copy(update={"background_e_per_s": level}), *self._trail(rate))

    def _trail(self, rate_rad_per_s: FloatArray) -> tuple[float, float]:
        """Rate and direction of cached predictions: zero at rest, otherwise rounded to 2 digits and 5 deg."""
        rate_deg_per_s, direction_deg = trail_of_rate(rate_rad_per_s)
        pixel_rad = self.nominal.state.pixel_arcsec / RAD_ARCSEC if "nominal" in self.__dict__ else np.inf
        if np.radians(rate_deg_per_s) * self.config.instrument.exposure_s < AT_REST_PX * pixel_rad:
            return 0.0, 0.0
        return float(f"{rate_deg_per_s:.2g}"), 5.0 * round(direction_deg / 5.0)

    # --- Thermal and colour maps

    @cached_property
    def sensitivity(self) -> Mapping[str, FieldMap]:
        """Shift [px/K] of stars by each thermal state of the flight, by central differences of ray traces."""
        occurs = np.abs(self.flight.thermal.values_k).max(axis=0) > 0.0
        maps = {}
        for name, present, unit in zip(COMPONENTS, occurs, np.eye(len(COMPONENTS)), strict=True):
            if present:
                step = STEP_K[name]
                above, below = (self._traced(sign * step * unit) for sign in (1.0, -1.0))
                maps[name] = fit_field_map(self._map.direction, (above - below) / (2.0 * step))
        return maps

    def _traced(self, state_k: FloatArray) -> FloatArray:
        """Photocentres (n, 2) [px] of rays through the lens in a state, for the directions of the map."""
        warm = build_instrument(self.config.instrument, lens=heated(self.config, state_k))
        traced = warm.pixel_map(self.nominal.state.band, temperature_k=self.config.star_temperature_k)
        if traced.direction.shape != self._map.direction.shape:
            raise DomainError(
                "temperature: the heated lens loses light at the edge of the field; use smaller temperature changes"
            )
        return np.asarray(traced.pixel_px)

    @cached_property
    def _colour_bias(self) -> tuple[FloatArray, FloatArray]:
        """Bias of a fit of the calibrated PSF to stars of 3500 and 10 000 K: radial mean (2, f), RMS over phases."""
        state = self.tracked.state
        return self._fit_bias(state.cold_psfs, state.hot_psfs)

    @cached_property
    def _heat_bias(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Changes of the mean temperature (2,) [K], coldest and hottest; bias of fits of the calibrated PSF there."""
        mean_k = self.flight.thermal.values_k[:, COMPONENTS.index("mean_k")]
        extremes_k = np.array([min(mean_k.min(), -MIN_HEATED_K), max(mean_k.max(), MIN_HEATED_K)])
        if not mean_k.any():
            zero = np.zeros((2, len(self.nominal.state.radius_px)))
            return extremes_k, zero, zero
        at_c = configured_lens(self.config.instrument).environment.temperature_c
        psfs = []
        for extreme_k in extremes_k:
            warm = self.config.instrument.model_copy(update={"lens_temperature_c": at_c + float(extreme_k)})
            sensor = self.sensor.model_copy(update={"instrument": warm})
            psfs.append(_camera(sensor, *self._trail(self._tracked_rate)).state.psfs)
        return extremes_k, *self._fit_bias(*psfs)

    @property
    def _tracked_rate(self) -> FloatArray:
        return np.asarray(self.flight.trajectory.rate(float(self.flight.segments_s[0])))

    @cached_property
    def tracked(self) -> CameraPrediction:
        """Prediction for the trails of the first segment, for which the PSFs of the tracker are calibrated."""
        return self.camera(0.0, self._tracked_rate)

    def _fit_bias(self, *psf_sets: tuple[EffectivePsf, ...]) -> tuple[FloatArray, FloatArray]:
        """Bias of noiseless fits to k other sets of PSFs: radial mean and RMS over pixel phases (k, f) [px]."""
        if not centroider_class(self.config.centroid).needs_epsf:
            zero = np.zeros((len(psf_sets), len(self.nominal.state.radius_px)))
            return zero, zero
        magnitude = np.array([np.median(self.guides.magnitude)])
        electrons = float(self.nominal.electrons(magnitude, BIAS_STAR_K)[0])
        calibrated = self.tracked.state.psfs
        noise = self.nominal.processing.noise
        window_px = self.config.window_px
        bias = np.array(
            [
                fit_bias(self.config.centroid, calibrated, psfs, electrons, noise=noise, window_px=window_px)
                for psfs in psf_sets
            ]
        )
        azimuth = np.radians(AZIMUTH_DEG)
        return bias.mean(axis=2) @ np.array([np.cos(azimuth), np.sin(azimuth)]), np.sqrt(bias.var(axis=2).mean(-1))

    def colour_px(self, temperature_k: FloatArray, radius_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radial shift (n,) of centroids by the colour of stars, and its RMS over pixel phases."""
        distance = colour_distance(temperature_k, self.config.star_temperature_k)
        cold, radius = temperature_k < self.config.star_temperature_k, self.nominal.state.radius_px
        bias, spot = (
            np.where(cold, *(np.interp(radius_px, radius, row) for row in rows)) for rows in self._colour_bias
        )
        shift = self.nominal.state.colour_shift_px(temperature_k, radius_px)
        return np.asarray(shift + distance * bias), np.asarray(distance * spot)

    def heat_px(self, mean_k: float, radius_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radial bias (n,) of the fit through a warmer lens, and its RMS over pixel phases."""
        extremes_k, bias_px, phase_px = self._heat_bias
        extreme = int(mean_k > 0.0)  # 0: coldest, 1: hottest
        fraction = abs(mean_k) / abs(extremes_k[extreme])
        field_px = self.nominal.state.radius_px
        return (
            np.asarray(fraction * np.interp(radius_px, field_px, bias_px[extreme])),
            np.asarray(fraction * np.interp(radius_px, field_px, phase_px[extreme])),
        )

    # --- Stars of an attitude

    def expected(self, attitude: Rotation, velocity: FloatArray | None) -> tuple[NDArray[np.int64], FloatArray]:
        """Guide stars of a tracker, rows of `guides`, and their directions in the camera frame."""
        rows, apparent, _ = expected_guides(
            self.guides,
            self.model,
            attitude,
            velocity_km_per_s=velocity,
            margin_px=self.config.window_px // 2 + 1.0,
            most=self.config.tracker.most,
        )
        return rows, np.asarray(attitude.apply(apparent)).reshape(-1, 3)

    def errors(self, time_s: float, *, state_k: FloatArray | None = None) -> AttitudeErrors:
        """Errors of the attitude at a time; ``state_k`` in place of the thermal state of that time."""
        trajectory = self.flight.trajectory
        return self.errors_of(trajectory.attitude(time_s), np.asarray(trajectory.rate(time_s)), time_s, state_k=state_k)

    def errors_of(
        self, attitude: Rotation, rate_rad_per_s: FloatArray, time_s: float, *, state_k: FloatArray | None = None
    ) -> AttitudeErrors:
        """Errors as `errors`, for a stated attitude (camera from ICRS) and rate instead of the trajectory's."""
        flight, config = self.flight, self.config
        rows, v = self.expected(attitude, flight.velocity_km_per_s(time_s))
        # a window without a defective pixel gives a usable centroid
        usable_probability = (1.0 - self._defect_fraction) ** (config.window_px**2)
        stars = len(rows) * usable_probability
        if stars < config.tracker.fewest or flight.blinded(time_s, attitude):
            vectors = [name for name in AttitudeErrors.__slots__ if name.endswith(("arcsec", "arcsec2"))]
            none = dict.fromkeys(vectors, np.full(3, np.nan))
            return AttitudeErrors(time_s=time_s, available=False, stars=stars, **none)
        background = float(flight.background_e_per_s(time_s, attitude))
        star = self.star_errors(background, rate_rad_per_s, rows, v)
        thermal_px, focus_px = self._thermal_shift(flight.thermal.at(time_s) if state_k is None else state_k, v)
        weight = 1.0 / (star.noise_px**2 + self.unmodelled_px2(rows, v))

        def variance_arcsec2(sigma_px: FloatArray) -> FloatArray:
            covariance_px2 = covariance_of_noise(v, weight, sigma_px**2, probability=usable_probability)
            return np.asarray(self.pixel_arcsec**2 * np.diag(covariance_px2))

        def error_arcsec(shift_px: FloatArray) -> FloatArray:
            return np.asarray(RAD_ARCSEC * attitude_of_shifts(v, weight, self._direction_change(v, shift_px)))

        return AttitudeErrors(
            time_s=time_s,
            available=True,
            stars=stars,
            noise_arcsec2=variance_arcsec2(star.noise_px),
            pixel_arcsec2=variance_arcsec2(star.pattern_px),
            spot_arcsec2=variance_arcsec2(np.hypot(star.phase_px, star.colour_phase_px)),
            focus_arcsec2=variance_arcsec2(focus_px),
            fov_arcsec=error_arcsec(star.shift_px),
            thermal_arcsec=error_arcsec(thermal_px),
            aberration_arcsec=self.aberration_arcsec(time_s, attitude),
        )

    @property
    def _defect_fraction(self) -> float:
        detector = self.nominal.detector
        return detector.hot_fraction + detector.dead_fraction

    def star_errors(
        self, background_e_per_s: float, rate_rad_per_s: FloatArray, rows: NDArray[np.int64], v: FloatArray
    ) -> GuideStarErrors:
        """Centroid errors of guide stars, rows of `guides`, in directions ``v`` (n, 3) of the camera frame."""
        camera = self.camera(background_e_per_s, rate_rad_per_s)
        offset_px = self._offset_px(v)
        radius_px = np.hypot(*offset_px.T)
        temperature_k = self.sky.temperature_k[self.guides.row[rows]]
        rate_e_per_s = camera.state.electrons_per_s(self.sky.magnitude[self.guides.row[rows]], temperature_k, radius_px)
        electrons = rate_e_per_s * self.config.instrument.exposure_s * self.sensor.throughput_fraction
        star = camera.stars
        effective_e = star.effective(electrons, temperature_k, radius_px)
        colour_px, colour_phase_px = self.colour_px(temperature_k, radius_px)
        return GuideStarErrors(
            noise_px=star.sigma_at(star.centroid.noise_px, effective_e, radius_px),
            pattern_px=star.sigma_at(star.centroid.pattern_px, electrons, radius_px),
            phase_px=star.sigma_at(star.centroid.phase_px, electrons, radius_px),
            colour_phase_px=colour_phase_px,
            shift_px=_radial_shift(colour_px, offset_px) + self._residual.at(v),
        )

    def _thermal_shift(self, state_k: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Shift of stars by the heated lens (n, 2), and RMS over pixel phases by its defocus (n,) [px]."""
        offset_px = self._offset_px(v)
        bias_px, phase_px = self.heat_px(float(state_k[0]), np.hypot(*offset_px.T))
        shift_px = _radial_shift(bias_px, offset_px)
        for name, component_k in zip(COMPONENTS, state_k, strict=True):
            if name in self.sensitivity:
                shift_px += component_k * self.sensitivity[name].at(v)
        return shift_px, phase_px

    def _direction_change(self, v: FloatArray, shift_px: FloatArray) -> FloatArray:
        """Shifts on the detector as changes of direction (n, 3) by the camera model."""
        position_px = self.model.project(v)
        return np.asarray(self.model.unproject(position_px + shift_px) - self.model.unproject(position_px))

    def aberration_arcsec(self, time_s: float, attitude: Rotation) -> FloatArray:
        """Error (3,) by the difference of the true and the tracker's velocity."""
        known = self.flight.known_velocity_km_per_s(time_s)
        unknown = self.flight.velocity_km_per_s(time_s) - (np.zeros(3) if known is None else known)
        return RAD_ARCSEC * attitude_of_velocity(attitude.apply(unknown))

    def _offset_px(self, v: FloatArray) -> FloatArray:
        """Positions (n, 2) [px] of directions relative to the middle of the detector."""
        return np.asarray(self.model.project(v) - self.model.geometry.centre_px)

    def unmodelled_px2(self, rows: NDArray[np.int64], v: FloatArray) -> FloatArray:
        """Variance (n,) per axis that the tracker adds to the noise of guide stars, rows of `guides`."""
        scale_px2 = 0.5 * self.scale_error**2 * (self._offset_px(v) ** 2).sum(1)  # a radial shift, half per axis
        return np.asarray(self.star_error_px[rows] ** 2 + scale_px2)

    @cached_property
    def star_error_px(self) -> FloatArray:
        """Error per axis of every guide star without noise and scale, RMS over field and flight, by colour."""
        radius, kelvin = detector_radii(self.nominal.state), self.sky.temperature_k[self.guides.row]
        temperature, index = np.unique(kelvin.round(-1), return_inverse=True)
        colour, spot = self.colour_px(np.repeat(temperature, len(radius)), np.tile(radius, len(temperature)))
        colour2 = (0.5 * colour**2 + spot**2).reshape(len(temperature), -1).mean(1)[index]
        return np.asarray(np.sqrt(colour2 + self._common_error[0]))

    @property
    def scale_error(self) -> float:
        """Relative error of the image scale by temperature, RMS over the flight."""
        return self._common_error[1]

    @cached_property
    def _common_error(self) -> tuple[float, float]:
        """Terms common to all colours: variance per axis without noise and scale [px^2], RMS error of the scale."""
        squares, scales = [0.0], [0.0]
        for time in self.flight.segments_s:
            rows, v = self.expected(self.flight.trajectory.attitude(float(time)), None)
            if len(rows) <= 2:
                continue
            rate = np.asarray(self.flight.trajectory.rate(float(time)))
            star = self.star_errors(0.0, rate, rows, v)
            thermal_px, focus_px = self._thermal_shift(self.flight.thermal.at(float(time)), v)
            # the attitude absorbs shift and roll
            (*_, scale_change), residual_px = fit_similarity(self._offset_px(v), thermal_px)
            residual_px = residual_px + self._residual.at(v)
            squares += list(star.pattern_px**2 + star.phase_px**2 + focus_px**2 + 0.5 * (residual_px**2).sum(1))
            scales.append(scale_change)
        return float(np.mean(squares)), float(np.sqrt(np.mean(np.square(scales))))

    def bias_arcsec(self) -> FloatArray:
        """Error (3,) of the alignment on ground."""
        return np.array(self.config.tracker.alignment_arcsec)


def _radial_shift(shift_px: FloatArray, offset_px: FloatArray) -> FloatArray:
    """Shifts (n, 2) of the sizes (n,), away from the centre of the detector; 0 in the centre."""
    radius_px = np.hypot(*offset_px.T)
    return np.asarray(shift_px[:, None] * offset_px / np.maximum(radius_px, 1e-9)[:, None])


def _sensor(config: FlightConfig, old: bool) -> PredictedSensorConfig:
    """Prediction for a configuration, at the beginning or the end of its life."""
    common = {key: value for key, value in config.model_dump().items() if key in PredictedSensorConfig.model_fields}
    star, sky = {"temperature_k": config.star_temperature_k}, {"attitudes": SKY_ATTITUDES}
    sensor = PredictedSensorConfig.model_validate({**common, "star": star, "sky": sky})
    return aged_config(sensor, 1.0) if old else sensor


def _camera(sensor: PredictedSensorConfig, rate_deg_per_s: float, direction_deg: float) -> CameraPrediction:
    slew = SlewConfig(rate_deg_per_s=rate_deg_per_s, direction_deg=direction_deg)
    return _cached(sensor.model_copy(update={"slew": slew}).model_dump_json())


@lru_cache(maxsize=512)
def _cached(text: str) -> CameraPrediction:
    return predict_camera(PredictedSensorConfig.model_validate_json(text))


def build_budget(config: FlightConfig, flight: Flight, *, old: bool = False) -> Budget:
    """Prediction at the beginning of life, or of the ``old`` sensor.

    Raises
    ------
    StarbenchError
        As the camera report; a lens without thermal data in a flight with temperatures.
    """
    budget = Budget(config, flight, old=old)
    _ = budget.sensitivity  # refuses lenses and temperatures before anything is rendered
    for extreme in (flight.thermal.values_k.min(axis=0), flight.thermal.values_k.max(axis=0)):
        heated(config, extreme)
    return budget
