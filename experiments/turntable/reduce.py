"""A calibration set against the traced lens."""

from __future__ import annotations

from dataclasses import dataclass

from calib.calibration.record import Calibration
from calib.cameras.line_of_sight import LineOfSightMap, line_of_sight_map
from experiments.laboratory.single_star.reduce import Data, calibrated_bench
from experiments.laboratory.turntable import Turntable
from experiments.turntable.traced import TracedMap
from optics.arrays import FloatArray

__all__ = ["Reduction", "judge"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduction:
    """One calibration, judged.

    Attributes
    ----------
    calibration : Calibration
        As the estimator gives it.
    star : (3,)
        Direction of the star in the laboratory.
    line_of_sight : LineOfSightMap
        Error against the traced lens after the best rotation, and what the covariance predicts.
    residual_px : (n, 2)
        Images minus what the calibration says at the angles as read, before any reading error is fitted.
    """

    calibration: Calibration
    star: FloatArray
    line_of_sight: LineOfSightMap
    residual_px: FloatArray

    def value(self, name: str) -> float:
        """One unknown."""
        return float(self.calibration.solution.value[self.calibration.solution.index(name)])

    def sigma(self, name: str) -> float:
        """Its standard deviation."""
        return float(self.calibration.solution.sigma[self.calibration.solution.index(name)])


def judge(calibration: Calibration, data: Data, table: Turntable, traced: TracedMap) -> Reduction:
    """Set a calibration, made with ``table`` as believed, against the traced lens."""
    bench = calibrated_bench(calibration, table)
    return Reduction(
        calibration=calibration,
        star=bench.star,
        line_of_sight=line_of_sight_map(
            calibration.model, traced.direction.copy(), traced.pixel_px, covariance=calibration.covariance
        ),
        residual_px=data.pixel_px - calibration.model.project(bench.seen(data.reading_rad)),
    )
