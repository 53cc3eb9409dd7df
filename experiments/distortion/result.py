"""Record of the distortion test, and the maps that judge a correction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from experiments.distortion.settings import Config
from experiments.distortion.wide_field import WideField
from experiments.laboratory.bench import Bench
from experiments.laboratory.distortion_error import DenseMap, DistortionMeasurement, dense_map
from experiments.laboratory.distortion_model import DistortionPrediction, MapForecast, forecast_map
from experiments.laboratory.distortion_statistics import REFERENCES, Reference
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.targets import GridTarget
from optics.arrays import FloatArray

__all__ = ["CorrectionMap", "Result", "correction_maps", "forecasts"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectionMap:
    """True error of a correction between the points."""

    first: DenseMap  # With the survey that counts
    rms_px: FloatArray  # (q, 2) RMS map error of every survey


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Everything the run found."""

    config: Config  # Settings
    instrument: Instrument  # The camera
    measured: DistortionMeasurement  # The test, and what it should give
    predicted: DistortionPrediction  # The test, and what it should give
    maps: Mapping[Reference, CorrectionMap]  # True map errors, first method
    forecast: tuple[MapForecast, ...]  # Map errors to be expected of other targets and polynomials
    wide: WideField  # The test with a lens whose distortion decides its numbers

    @property
    def scale(self) -> float:
        """From px, 1 sigma, to arcsec, 3 sigma."""
        return self.measured.arcsec_3sigma

    @property
    def terms(self) -> int:
        """Terms of the polynomial, per axis."""
        return (self.config.order + 1) * (self.config.order + 2) // 2

    @property
    def forecast_here(self) -> MapForecast:
        """The forecast of the configured target and order."""
        wanted = (self.config.target.rows * self.config.target.columns, self.config.order)
        return next(one for one in self.forecast if (one.points, one.order) == wanted)


def correction_maps(
    bench: Bench, measured: DistortionMeasurement, config: Config, traced_px: FloatArray, grid: tuple[int, int]
) -> dict[Reference, CorrectionMap]:
    """Map errors of every reference and survey, first method."""
    out: dict[Reference, CorrectionMap] = {}
    for reference in REFERENCES:
        every = []
        for copy in range(len(measured.surveyed)):
            camera, polynomial = measured.correction(config.methods[0], reference, copy)
            every.append(
                dense_map(
                    bench,
                    measured.instrument,
                    camera,
                    polynomial,
                    reference=reference,
                    order=config.order,
                    rows=grid[0],
                    columns=grid[1],
                    traced_px=traced_px,
                )
            )
        out[reference] = CorrectionMap(first=every[0], rms_px=np.stack([one.rms_px for one in every]))
    return out


def forecasts(
    bench: Bench,
    instrument: Instrument,
    target: GridTarget,
    config: Config,
    point_error_px: float,
    traced_px: FloatArray,
    grid: tuple[int, int],
) -> tuple[MapForecast, ...]:
    """Map errors to be expected; the configured target and order are always among them."""
    sizes = sorted({(rows, 2 * rows) for rows in config.study.rows} | {(target.rows, target.columns)})
    found = [
        forecast_map(
            bench,
            instrument,
            replace(target, rows=rows, columns=columns),
            order=order,
            point_error_px=point_error_px,
            traced_px=traced_px,
            grid=grid,
        )
        for rows, columns in sizes
        for order in sorted({*config.study.orders, config.order})
    ]
    return tuple(one for one in found if one is not None)
