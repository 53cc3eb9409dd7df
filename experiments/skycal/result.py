"""What the calibration under the sky found, as records."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.skycal.calibrate import CalibratedMap, map_probability, rms
from experiments.skycal.evaluate import Evaluation
from experiments.skycal.match import Matched
from experiments.skycal.measure import Recording
from experiments.skycal.scene import Scene
from experiments.skycal.settings import Config
from optics.arrays import FloatArray

__all__ = ["CameraResult", "Result"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraResult:
    """One camera."""

    scene: Scene  # What it saw, and what came of it
    recording: Recording  # What it saw, and what came of it
    matched: Matched  # What it saw, and what came of it
    evaluation: Evaluation  # What it saw, and what came of it

    @property
    def name(self) -> str:
        """ "narrow" or "wide"."""
        return self.scene.name

    @property
    def short(self) -> str:
        """Focal length, as a name for tables."""
        focal = self.scene.instrument.focal_length_mm
        return f"{focal:.0f} mm" if focal >= 100 else f"{focal:.1f} mm"

    @property
    def total(self) -> CalibratedMap:
        """The calibration that counts: measured centroids, free attitudes, the configured model."""
        return self.evaluation.maps["free", self.scene.config.model, "measured"]

    def of(self, data: str, *, method: str = "free", model: str | None = None) -> CalibratedMap:
        """A calibration; the configured model if none is named."""
        return self.evaluation.maps[method, model or self.scene.config.model, data]

    @property
    def stars_per_frame(self) -> float:
        """Mean number of stars that are calibrated with."""
        return float(self.evaluation.used.sum()) / self.scene.frames

    @property
    def noise_map_arcsec(self) -> FloatArray:
        """What noise alone does to the map of the colour-corrected centroids (n, 2)."""
        return np.asarray(self.of("corrected").error_arcsec - self.evaluation.clean.error_arcsec)

    @property
    def noise_map_rms_arcsec(self) -> float:
        """Its RMS."""
        return rms(self.noise_map_arcsec)

    @property
    def noise_map_probability(self) -> float:
        """Probability of a noise map as far from the predicted size."""
        return map_probability(self.noise_map_arcsec, self.of("corrected").spectrum_arcsec2)

    @property
    def linked_map_probability(self) -> float:
        """The same for attitudes linked by the gyro of stated noise."""
        linked = self.of("corrected", method="linked")
        return map_probability(linked.error_arcsec - self.evaluation.clean.error_arcsec, linked.spectrum_arcsec2)

    @property
    def noise_sigma_px(self) -> FloatArray:
        """Standard deviation per axis (k, 2) that the centroider states."""
        diagonal = np.diagonal(self.matched.covariance_px2[self.evaluation.used], axis1=1, axis2=2)
        return np.asarray(np.sqrt(diagonal))


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Result of a run."""

    config: Config  # Settings
    cameras: dict[str, CameraResult]  # By name
