"""Accuracy of star vectors by the Fisher distribution (FISHER23, S400 and S500), and by the pixel-residual method.

S400 estimates the concentration of star vectors in the table's frame at zero angles (`calib.attitude.star_vectors`),
S500 converts it to a standard deviation per axis. FISHER23's usual method: the residuals of the images against the
reprojected star, as a standard deviation in pixels, times one angle per pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.directional.fisher import FisherFit, fit_fisher
from calib.directional.fisher_checks import (
    Exponential,
    Isotropy,
    effective_degrees,
    exponential_check,
    fisher_outliers,
    isotropy_check,
)
from calib.directional.pixel_method import residual_sigma_px
from optics.arrays import FloatArray
from optics.records import freeze
from optics.units import RAD_ARCSEC

CONFIDENCE = 0.95
"""Of the intervals that are reported."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VectorAccuracy:
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

    def effective_interval_arcsec(self) -> tuple[float, float]:
        """The interval by the degrees of freedom that the vectors themselves show."""
        low, high = self.fit.sigma_interval_rad(CONFIDENCE, effective=self.effective_degrees)
        return low * RAD_ARCSEC, high * RAD_ARCSEC

    def pixel_method_arcsec(self, resolution_arcsec: float) -> float:
        """Standard deviation from pixel residuals, with one angle per pixel."""
        return residual_sigma_px(self.residual_px[~self.outlier]) * resolution_arcsec


def vector_accuracy(
    vectors: ArrayLike,
    residual_px: ArrayLike,
    *,
    outlier_probability: float | None = 0.01,
    degrees_of_freedom: float | None = None,
) -> VectorAccuracy:
    """Accuracy of star vectors (n, 3), in the table's frame at zero angles, that should all be equal.

    ``residual_px`` (n, 2) are images minus the reprojected star; ``outlier_probability`` is the false-alarm probability
    of the outlier test, None for no test; ``degrees_of_freedom`` are 2 (n - 1) unless the calibration used the same
    data. Raises `DomainError` as `calib.directional.fisher.fit_fisher` and its checks.
    """
    directions, residual = np.asarray(vectors, np.float64), np.asarray(residual_px, np.float64)
    outlier = np.zeros(len(directions), dtype=bool)
    if outlier_probability is not None:
        outlier = fisher_outliers(directions, level=outlier_probability)
    inliers = directions[~outlier]
    freedom = None if degrees_of_freedom is None else degrees_of_freedom - 2 * float(outlier.sum())
    return VectorAccuracy(
        vectors=directions,
        outlier=outlier,
        fit=fit_fisher(inliers, degrees_of_freedom=freedom),
        isotropy=isotropy_check(inliers),
        tails=exponential_check(inliers),
        effective_degrees=effective_degrees(inliers),
        residual_px=residual,
    )
