"""Records of a predicted sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.measure.centroid_prediction import CentroidErrors
from calib.measure.detection_statistics import false_alarms
from calib.records import NoiseModel
from experiments.camera.optical_state import COLD_K, HOT_K, OpticalState
from experiments.camera.settings import Config
from experiments.camera.sky import SkyView
from optics.arrays import FloatArray
from render.detector.noise import PixelNoise
from render.detector.spec import Detector

__all__ = [
    "AttitudeForecast",
    "CameraPrediction",
    "Processing",
    "Scalar",
    "StarErrors",
    "colour_distance",
    "detector_radii",
    "exposed_s",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scalar:
    """One number of a prediction."""

    value: float  # NaN where there is none
    unit: str  # For tables
    label: str  # For tables
    format: str = ""  # For tables


@dataclass(frozen=True, slots=True, kw_only=True)
class Processing:
    """How frames are measured, and the noise that counts there."""

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
    """Over f attitudes of the sky."""

    found: FloatArray  # (f,) Expected number of stars that are found, and its variance by noise
    found_variance: FloatArray  # (f,) Expected number of stars that are found, and its variance by noise
    # (f,) Expected number of those that are fit: not saturated, whole and alone in their window, on good pixels
    stars: FloatArray
    # (f, 3) One standard deviation about x, y (across) and z (roll): by temporal noise; with patterns, pixel phase
    # and star colours. Infinite where too few stars are seen
    noise_arcsec: FloatArray
    # (f, 3) One standard deviation about x, y (across) and z (roll): by temporal noise; with patterns, pixel phase
    # and star colours. Infinite where too few stars are seen
    total_arcsec: FloatArray
    sigma_px: FloatArray  # (m,) Error of each sighting of the view, per axis, all terms


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraPrediction:
    """Everything that was predicted."""

    config: Config  # For which sensor
    state: OpticalState  # Lens and light
    processing: Processing  # Detector and noise
    stars: StarErrors  # Errors against electrons
    view: SkyView  # Sky
    attitude: AttitudeForecast  # Attitudes
    scalars: Mapping[str, Scalar]  # Single numbers by name, the same names for every sensor

    def value(self, name: str) -> float:
        """A scalar by name."""
        return self.scalars[name].value

    @property
    def saturated(self) -> bool:
        """Whether the star that the accuracy is quoted for saturates: there is no accuracy then."""
        return self.config.star.magnitude_mag < self.value("saturation_mag")

    @property
    def adc_top_e(self) -> float:
        """Electrons at which the converter overruns."""
        chip = self.processing.detector
        return (chip.largest_dn - chip.offset_dn) / chip.gain_dn_per_e

    @property
    def catalogue_ends(self) -> bool:
        """Whether the sensor finds stars that the catalogue does not hold."""
        return self.view.depth_mag < self.value("limiting_magnitude_mag")

    def electrons(self, magnitude: FloatArray, temperature_k: float, radius_px: FloatArray | float = 0.0) -> FloatArray:
        """Electrons in one exposure of stars of magnitudes (n,)."""
        m = np.atleast_1d(np.asarray(magnitude, float))
        kelvin, radius = np.full(len(m), float(temperature_k)), np.broadcast_to(np.asarray(radius_px, float), m.shape)
        return self.state.electrons_per_s(m, kelvin, radius) * exposed_s(self.config)


def exposed_s(config: Config) -> float:
    """Exposure time, shortened by light that is lost where nobody knows."""
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
