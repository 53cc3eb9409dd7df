"""A calibration set against the traced lens, and the star vectors that it makes of the images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.attitude.star_vectors import initial_frame_vectors
from calib.calibration.record import Calibration
from calib.cameras.line_of_sight import LineOfSightMap, line_of_sight_map
from experiments.laboratory.single_star.measure import Measurement
from experiments.laboratory.single_star.reduce import Data, calibrated_bench
from experiments.laboratory.turntable import Turntable
from experiments.turntable.traced import TracedMap
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC

__all__ = ["Reduction", "judge", "vector_scatter_arcsec"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduction:
    """One calibration, judged."""

    calibration: Calibration  # As the estimator gives it
    star: FloatArray  # (3,) Direction of the star in the laboratory
    # Error against the traced lens after the best rotation, and what the covariance predicts
    line_of_sight: LineOfSightMap
    # (n, 2) Images minus what the calibration says at the angles as read, before any reading error is fitted
    residual_px: FloatArray

    @property
    def correlation(self) -> FloatArray:
        """Correlations (q, q) of the unknowns, of the estimator's own covariance."""
        solution = self.calibration.solution
        return np.asarray(solution.covariance / np.outer(solution.sigma, solution.sigma))


def judge(calibration: Calibration, data: Data, table: Turntable, traced: TracedMap) -> Reduction:
    """Set a calibration, made with ``table`` as believed, against the traced lens."""
    bench = calibrated_bench(calibration, table)
    return Reduction(
        calibration=calibration,
        star=bench.star,
        line_of_sight=line_of_sight_map(
            calibration.model, traced.direction, traced.pixel_px, covariance=calibration.covariance
        ),
        residual_px=data.pixel_px - calibration.model.project(bench.seen(data.reading_rad)),
    )


def vector_scatter_arcsec(reduction: Reduction, measurement: Measurement) -> FloatArray:
    """Standard deviation (2,) of the star vectors in the table's initial frame (S300), across the star [arcsec].

    Two directions: along the laboratory's X as seen from the star, and square to it.
    """
    installation = reduction.calibration.installation
    assert installation is not None
    vectors = initial_frame_vectors(
        reduction.calibration.model,
        measurement.readings.position_px,
        installation=installation,
        table_rotation=measurement.bench.table.rotation(measurement.visits.reading_rad),
    )
    mean = vectors.mean(0) / np.linalg.norm(vectors.mean(0))
    along = np.array([1.0, 0.0, 0.0]) - mean[0] * mean
    along /= np.linalg.norm(along)
    basis = np.stack([along, np.cross(mean, along)])
    return np.asarray((vectors @ basis.T).std(0, ddof=1) * RAD_ARCSEC)
