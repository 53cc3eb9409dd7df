"""Detection and centroid errors of stars against their electrons, without frames: noise, patterns, phase, colour.

The pixels are described by `FrameNoise`, the optics by PSFs at fields between the middle and the corner of the
detector. Stars are alone in their window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from calib.measure.centroid_error.cramer_rao_bound import matched_snr
from calib.measure.centroid_error.prediction import (
    SCALE_FREE,
    CentroidErrors,
    CentroidResponse,
    phase_windows,
    predict_centroids,
    psf_mismatch,
)
from calib.measure.centroiding.registry import centroider_class
from calib.measure.detection.false_alarms import detection_probability, false_alarms, threshold_for_false_alarms
from calib.records import NoiseModel
from optics.arrays import FloatArray
from optics.interpolation import bilinear
from render.records import EffectivePsf

FLUX_KNOTS = 14
PLAIN = NoiseModel(read_noise_e=10.0)
"""For centroiders that take no notice of the noise."""
FAINTEST_E, BRIGHTEST_E = 20.0, 1e6
FWHM_SIGMA = 2.3548
"""Full width at half maximum of a Gaussian, in standard deviations."""
DETECTION_KNOTS, DETECTION_RANGE = 32, (0.2, 8.0)
"""Electrons at which the detection probability is known, about those of an even chance."""
COLD_K, HOT_K = 3500.0, 10000.0
"""Stars whose PSFs are compared with that of the reference star."""
Psfs = tuple[EffectivePsf, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameNoise:
    """Noise of the pixels of a frame minus the mean of dark frames."""

    # Temporal noise of one frame without light: read noise and dark charge as ``read_noise_e``, rounding
    pixel: NoiseModel
    spread_e4: float = 0.0  # variance over the pixels of that noise's variance
    prnu: float = 0.0  # standard deviation of the response over the pixels, relative
    background_e: float = 0.0  # even light in a pixel
    dark_frames: int = 20  # dark frames that are averaged
    saturation_e: float = np.inf  # electrons of a star in a pixel at which it saturates
    # Noise that clipping finds over the root mean square (`calib.measure.detection.false_alarms.clipped_noise`)
    clipped_ratio: float = 1.0

    @property
    def empty_e2(self) -> float:
        """Temporal variance of a pixel without star, mean dark frame and even light included."""
        return self.pixel.floor_e2 * (1.0 + 1.0 / self.dark_frames) + self.background_e

    @property
    def noise(self) -> NoiseModel:
        """Noise without the even light: what an estimator is given."""
        more_e2 = self.pixel.floor_e2 / self.dark_frames
        return replace(self.pixel, read_noise_e=float(np.sqrt(self.pixel.read_noise_e**2 + more_e2)))

    @property
    def spread(self) -> float:
        """Standard deviation over the pixels of the variance of an empty pixel, relative."""
        return float(np.sqrt(self.spread_e4)) / self.empty_e2

    @property
    def dark_pattern_e(self) -> float:
        """Noise of the mean dark frame: a pattern, the same in all frames."""
        return float(np.sqrt(self.pixel.floor_e2 / self.dark_frames))


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionLimit:
    """Detection of stars in filtered frames."""

    frame: FrameNoise
    pixels: int  # Of a frame
    fwhm_px: float  # Width of the detection filter
    threshold_sigma: float  # Limit, in the noise that an image is estimated to have

    @classmethod
    def of_false_alarms(cls, count: float, *, frame: FrameNoise, pixels: int, fwhm_px: float) -> DetectionLimit:
        """Limit with an expected number of false alarms per frame."""
        threshold = threshold_for_false_alarms(count, pixels, fwhm_px=fwhm_px, noise_spread=frame.spread)
        return cls(frame=frame, pixels=pixels, fwhm_px=fwhm_px, threshold_sigma=threshold / frame.clipped_ratio)

    @property
    def noise(self) -> NoiseModel:
        """Noise that an estimator is given."""
        return self.frame.noise

    @property
    def true_sigma(self) -> float:
        """Limit in the true noise."""
        return self.threshold_sigma * self.frame.clipped_ratio

    @property
    def sigma_px(self) -> float:
        """Standard deviation of the detection filter."""
        return self.fwhm_px / FWHM_SIGMA

    @property
    def false_alarms(self) -> float:
        """Expected number in a frame."""
        return float(false_alarms(self.true_sigma, self.pixels, fwhm_px=self.fwhm_px, noise_spread=self.frame.spread))


@dataclass(frozen=True, slots=True, kw_only=True)
class StarErrors:
    """Errors and detection against the electrons of a star, at f distances from the middle of the detector."""

    radius_px: FloatArray  # (f,) Distances
    reference_k: float  # Colour of the star that the PSFs are of
    centroid: CentroidErrors  # Noise, patterns, pixel phase; k numbers of electrons
    # (f, k) By the spots of stars of another colour than the PSF's, for one of 10 000 K or 3500 K, whichever is more
    colour_px: FloatArray
    # (2, f) How much sharper spots of stars of 3500 and 10 000 K are than that of the reference star: light that shows
    # as well against the noise, relative
    sharpness: FloatArray
    detection_electrons: FloatArray  # (d,) Electrons about the detection limit
    detection: FloatArray  # (f, d) Probability of a detection

    def sigma_at(self, sigma_px: FloatArray, electrons: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Errors (f, k) at stars (n,): linear in distance, a power of the electrons between its knots."""
        return np.exp(self._at(np.log(np.maximum(sigma_px, 1e-12)), self.centroid.electrons, electrons, radius_px))

    def rms_at(self, sigma_px: FloatArray, electrons: FloatArray, radius_px: FloatArray) -> float:
        """Root mean square over stars (n,)."""
        return float(np.sqrt((self.sigma_at(sigma_px, electrons, radius_px) ** 2).mean()))

    def detected_at(self, electrons: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Probability (n,) that stars are detected."""
        probability = self._at(self.detection, self.detection_electrons, electrons, radius_px)
        return np.where(electrons < self.detection_electrons[0], 0.0, probability)

    def effective(self, electrons: FloatArray, temperature_k: FloatArray, radius_px: FloatArray) -> FloatArray:
        """Electrons of stars of the reference colour that show as well against the noise as these stars (n,)."""
        cold, hot = (np.interp(radius_px, self.radius_px, row) for row in self.sharpness)
        distance = np.minimum(colour_distance(temperature_k, self.reference_k), 2.0)
        return np.asarray(electrons * np.where(temperature_k < self.reference_k, cold, hot) ** distance)

    def limiting_magnitude(self, zero_e: FloatArray, radius_px: FloatArray, fraction: float = 0.5) -> float:
        """Magnitude at which this fraction of stars is detected.

        ``zero_e`` (n,): electrons of a star of 0 mag at places evenly over the detector, ``radius_px`` (n,).
        """
        magnitude = np.arange(-6.0, 20.0, 0.05)
        electrons = zero_e * 10.0 ** (-0.4 * magnitude[:, None])
        probability = self.detected_at(electrons.ravel(), np.tile(radius_px, len(magnitude)))
        return float(np.interp(-fraction, -probability.reshape(electrons.shape).mean(1), magnitude))

    def _at(self, values: FloatArray, knots: FloatArray, electrons: FloatArray, radius_px: FloatArray) -> FloatArray:
        positions = radius_px, np.log(np.maximum(electrons, 1e-9))
        return bilinear(values, (self.radius_px, np.log(knots)), positions)


def colour_distance(temperature_k: ArrayLike, reference_k: float) -> FloatArray:
    """How far a colour lies from the reference, 1 at 3500 or 10 000 K; in 1/T, as colours are spaced."""
    inverse, middle = 1.0 / np.asarray(temperature_k), 1.0 / reference_k
    cold, hot = max(1.0 / COLD_K - middle, 1e-6), max(middle - 1.0 / HOT_K, 1e-6)
    return np.asarray(np.where(inverse > middle, (inverse - middle) / cold, (middle - inverse) / hot))


def star_errors(
    psfs: Psfs,
    limit: DetectionLimit,
    *,
    radius_px: ArrayLike = (0.0, 1.0),
    centroid: str = "epsf",
    window_px: int = 13,
    other_psfs: Sequence[Psfs] = (),
    reference_k: float = 5800.0,
) -> StarErrors:
    """Predict centroids and detection of stars.

    Parameters
    ----------
    psfs : tuple of EffectivePsf
        Of the reference star at f distances from the middle of the detector; a single one is that of the whole field.
    limit : DetectionLimit
        Noise of the pixels, filter and threshold.
    radius_px : (f,)
        The distances.
    centroid : str
        Centroider (`calib.list_centroiders`).
    window_px : int
        Side of its window, odd.
    other_psfs : sequence of two tuples
        PSFs of stars of 3500 K and of 10 000 K; none: spots do not depend on the colour.
    reference_k : float
        Colour of the reference star.

    Raises
    ------
    ConfigError
        A centroider that has no prediction.
    """
    psfs = psfs if len(psfs) > 1 else (psfs[0], psfs[0])
    frame = limit.frame
    top_e = frame.saturation_e if np.isfinite(frame.saturation_e) else BRIGHTEST_E
    electrons = np.geomspace(FAINTEST_E, 30.0 * max(top_e, FAINTEST_E), FLUX_KNOTS)
    response, fitted = None, centroider_class(centroid).needs_epsf
    if not fitted:
        response = _response(psfs, centroid, window_px, PLAIN if centroid in SCALE_FREE else frame.pixel)
    errors = predict_centroids(
        centroid,
        psfs,
        electrons,
        noise=frame.pixel,
        background_e=frame.background_e,
        prnu=frame.prnu,
        offset_e=frame.dark_pattern_e,
        window_px=window_px,
        response=response,
    )
    colour = np.zeros_like(errors.noise_px)
    for other in other_psfs if fitted else ():
        bias = psf_mismatch(
            psfs,
            other,
            electrons,
            noise=limit.noise,
            background_e=frame.background_e,
            window_px=window_px,
            phases=2,
        )
        colour = np.maximum(colour, bias)
    flux, detection = _detection(psfs, limit, window_px)
    return StarErrors(
        radius_px=np.asarray(radius_px, np.float64),
        reference_k=reference_k,
        centroid=errors,
        colour_px=colour,
        sharpness=np.stack([_sharpness(other, psfs) for other in other_psfs or (psfs, psfs)]),
        detection_electrons=flux,
        detection=detection,
    )


def _detection(psfs: Psfs, limit: DetectionLimit, window_px: int) -> tuple[FloatArray, FloatArray]:
    """Electrons (d,) about the limit, and the probability (f, d) of a detection."""
    windows = phase_windows(psfs, max(window_px, 9), phases=3)
    empty_e2 = limit.frame.empty_e2
    # a Gaussian of the mean width, matched: at an even chance the others lie within a factor of a few
    half = limit.threshold_sigma * np.sqrt(empty_e2 * 4.0 * np.pi) * limit.sigma_px
    flux = half * np.geomspace(*DETECTION_RANGE, DETECTION_KNOTS)
    probability = detection_probability(
        windows.light, flux, empty_e2=empty_e2, threshold_sigma=limit.true_sigma, fwhm_px=limit.fwhm_px
    )
    return flux, probability.reshape(len(flux), len(psfs), -1).mean(2).T


def _sharpness(psfs: Psfs, reference: Psfs) -> FloatArray:
    """Root of the sum of squares, relative: response of a matched filter in white noise (f,)."""
    return np.array([np.sqrt((a.values**2).sum() / (b.values**2).sum()) for a, b in zip(psfs, reference, strict=True)])


@lru_cache(maxsize=32)
def _response(psfs: Psfs, centroid: str, window_px: int, noise: NoiseModel) -> CentroidResponse:
    """Response of a centroider without a PSF; kept, as it takes longer than all the rest."""
    return CentroidResponse(centroid, psfs, (FAINTEST_E, BRIGHTEST_E), noise=noise, window_px=window_px, phases=3)


def mean_snr(psf: EffectivePsf, electrons: float, frame: FrameNoise, window_px: int) -> float:
    """Signal-to-noise ratio of a star of the PSF with matched weights, mean over the sub-pixel phases."""
    light = phase_windows((psf,), window_px).light
    snr = matched_snr(light, np.full(len(light), electrons), frame.background_e, frame.noise)
    return float(snr.mean())
