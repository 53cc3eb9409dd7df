"""Reduction of star vectors (S300-S500), and the pixel-residual method for comparison.

S300 transforms every image to the table's frame at zero angles, S400 estimates the concentration, S500 converts it to a
standard deviation per axis. FISHER23's usual method: the residuals of the images against the reprojected star, as a
standard deviation in pixels, times one angle per pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.star_vectors import initial_frame_vectors
from calib.cameras.base import CameraModel
from calib.directional.fisher import FisherFit, fit_fisher
from calib.directional.fisher_checks import (
    Exponential,
    Isotropy,
    effective_degrees,
    exponential_check,
    fisher_outliers,
    isotropy_check,
)
from experiments.laboratory.single_star.bench import Bench
from optics.arrays import FloatArray
from optics.records import freeze
from optics.units import RAD_ARCSEC

CONFIDENCE = 0.95
"""Of the intervals that are reported."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """Accuracy of n star vectors."""

    vectors: FloatArray  # (n, 3) Unit vectors w_i in the table's frame at zero angles; outliers included
    outlier: NDArray[np.bool_]  # (n,) Taken out before fitting
    fit: FisherFit  # Of the others
    isotropy: Isotropy  # Whether they follow the distribution
    tails: Exponential
    effective_degrees: float  # Degrees of freedom that the vectors themselves show
    residual_px: FloatArray  # (n, 2) Images minus the reprojected star; outliers included

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "vectors", shape=("n", 3), sizes=sizes)
        freeze(self, "outlier", shape=("n",), dtype=np.bool_, sizes=sizes)
        freeze(self, "residual_px", shape=("n", 2), sizes=sizes)

    @property
    def sigma_arcsec(self) -> float:
        """Standard deviation of a star vector per axis."""
        return self.fit.sigma_rad * RAD_ARCSEC

    def interval_arcsec(self, level: float = CONFIDENCE) -> tuple[float, float]:
        """Confidence interval of sigma by the distribution."""
        low, high = self.fit.sigma_interval_rad(level)
        return low * RAD_ARCSEC, high * RAD_ARCSEC

    def own_interval_arcsec(self) -> tuple[float, float]:
        """The interval by the degrees of freedom that the vectors themselves show."""
        low, high = self.fit.sigma_interval_rad(CONFIDENCE, effective=self.effective_degrees)
        return low * RAD_ARCSEC, high * RAD_ARCSEC

    def baseline_arcsec(self, resolution_arcsec: float) -> float:
        """Standard deviation from pixel residuals, with one angle per pixel."""
        return baseline_px(self.residual_px[~self.outlier]) * resolution_arcsec


def baseline_px(residual_px: FloatArray) -> float:
    """Standard deviation per axis of pixel residuals (n, 2), of both axes together [px]: sigma_r / sqrt 2."""
    apart = residual_px - residual_px.mean(0)
    return float(np.sqrt(np.sum(apart**2) / (2 * (len(apart) - 1))))


def expected_px(model: CameraModel, bench: Bench, reading_rad: FloatArray) -> FloatArray:
    """Expected image of the star, (n, 2)."""
    return np.asarray(model.project(bench.seen(np.array(reading_rad))))


def evaluate(
    model: CameraModel,
    bench: Bench,
    position_px: FloatArray,
    reading_rad: FloatArray,
    *,
    outlier_probability: float | None = 0.01,
    degrees_of_freedom: float | None = None,
) -> Evaluation:
    """Steps S300 to S500."""
    pixel, angle = np.array(position_px), np.array(reading_rad)
    turn: Rotation = bench.table.rotation(angle)
    vectors = initial_frame_vectors(model, pixel, installation=bench.installation, table_rotation=turn)
    outlier = np.zeros(len(vectors), dtype=bool)
    if outlier_probability is not None:
        outlier = fisher_outliers(vectors, level=outlier_probability)
    kept = vectors[~outlier]
    freedom = None if degrees_of_freedom is None else degrees_of_freedom - 2 * float(outlier.sum())
    return Evaluation(
        vectors=vectors,
        outlier=outlier,
        fit=fit_fisher(kept, degrees_of_freedom=freedom),
        isotropy=isotropy_check(kept),
        tails=exponential_check(kept),
        effective_degrees=effective_degrees(kept),
        residual_px=pixel - expected_px(model, bench, angle),
    )
