"""Calibrating and evaluating with the same data, many times on coordinates: what 2 (n - 1) degrees of freedom miss.

The camera *is* the calibrated model here, so that nothing but noise and the number of unknowns makes a difference.
Every run draws images and readings, calibrates them jointly (S100) and evaluates star vectors three ways: the same data
with 2 (n - 1) degrees of freedom, the same data with 2 n minus the unknowns, and as many vectors of a second
acquisition that the calibration has not seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.attitude.star_vectors import initial_frame_vectors
from calib.cameras.base import CameraModel
from calib.directional.fisher import mean_and_chords
from experiments.fisher.acquire import Motion
from experiments.fisher.predict import (
    calibration_of_rows,
    predict_independent,
    predict_same_data,
    table_covariance_px2,
    tangent_maps,
)
from experiments.laboratory.single_star.bench import Bench, aim
from experiments.laboratory.single_star.reduce import Data, calibrated_bench, reduce_data
from optics.arrays import FloatArray
from render.engine.random import Streams

__all__ = ["SameDataPoint", "VarianceRatio", "same_data_sweep"]


INSET = 0.03
"""Distance of the outermost places from the edge, as a part of the side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VarianceRatio:
    """Estimated over true variance, mean over runs, with its standard error; `root`: as standard deviations."""

    value: float
    error: float

    @property
    def root(self) -> float:
        """Ratio of standard deviations."""
        return float(np.sqrt(self.value))

    @property
    def root_error(self) -> float:
        """Its standard error."""
        return self.error / (2.0 * self.root)


@dataclass(frozen=True, slots=True, kw_only=True)
class SameDataPoint:
    """One number of places."""

    count: int  # Star vectors; unknowns of the calibration
    unknowns: int  # Star vectors; unknowns of the calibration
    naive: VarianceRatio  # Estimated variance over that of the noise
    corrected: VarianceRatio  # Estimated variance over that of the noise
    independent: VarianceRatio  # Estimated variance over that of the noise
    predicted_naive: float  # The same from covariances
    predicted_independent: float  # The same from covariances
    effective_degrees: float  # Degrees of freedom of the same data that would make it unbiased
    lost: int  # Calibrations that did not converge


def same_data_sweep(
    model: CameraModel,
    bench: Bench,
    sigma_px: float,
    sides: Sequence[int],
    runs: int,
    streams: Streams,
    *,
    rolls_rad: Sequence[float] = (0.0,),
    advance: Callable[[], None],
) -> list[SameDataPoint]:
    """Vary the number of places."""
    points = []
    for side in sides:
        points.append(_same_point(model, bench, sigma_px, side, runs, rolls_rad, streams.child("same data", side)))
        advance()
    return points


def _places_px(model: CameraModel, side: int) -> FloatArray:
    size = np.array([model.geometry.width_px, model.geometry.height_px], dtype=np.float64)
    steps = np.linspace(INSET, 1.0 - INSET, side)
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * size - 0.5


def _same_point(
    model: CameraModel,
    bench: Bench,
    sigma_px: float,
    side: int,
    runs: int,
    rolls_rad: Sequence[float],
    streams: Streams,
) -> SameDataPoint:
    angle = aim(bench, model.unproject(_places_px(model, side)), np.resize(rolls_rad, side * side))
    centroid = np.broadcast_to(np.eye(2) * sigma_px**2, (len(angle), 2, 2))
    maps, rows = tangent_maps(model, bench, angle), calibration_of_rows(model, bench, angle)
    noise = centroid + table_covariance_px2(model, bench, angle, Motion())
    same = predict_same_data(maps, noise, rows)
    scale = np.linalg.norm(rows.reshape(-1, rows.shape[2]), axis=0)
    scaled = rows / scale
    covariance = np.linalg.inv(np.einsum("nia,nij,njb->ab", scaled, np.linalg.inv(noise), scaled))
    other = predict_independent(maps, noise, rows, covariance / np.outer(scale, scale))
    exact = model.project(bench.seen(angle))
    sums: list[list[float]] = []
    for run in range(runs):

        def draw(name: str, call: int, run: int = run) -> Data:
            normal = streams.generator(name, run).standard_normal(exact.shape)
            reading = bench.table.read(angle, streams, call=2 * run + call)
            return Data(pixel_px=exact + sigma_px * normal, covariance_px2=np.array(centroid), reading_rad=reading)

        first, second = draw("first", 0), draw("second", 1)
        calibration = reduce_data(first, bench.table, model, leans=True, start_star=np.array(bench.star))
        if calibration.converged:
            found = calibrated_bench(calibration, bench.table)
            sums.append([_chord_sum(calibration.model, found, data) for data in (first, second)])
    count, unknowns = len(angle), rows.shape[2]
    values = np.array(sums).reshape(-1, 2) / same.noise_rad2
    return SameDataPoint(
        count=count,
        unknowns=unknowns,
        naive=_mean(values[:, 0] / (2 * (count - 1))),
        corrected=_mean(values[:, 0] / (2 * count - unknowns)),
        independent=_mean(values[:, 1] / (2 * (count - 1))),
        predicted_naive=same.effective_degrees / (2 * (count - 1)),
        predicted_independent=other.effective_degrees / (2 * (count - 1)),
        effective_degrees=same.effective_degrees,
        lost=runs - len(values),
    )


def _chord_sum(model: CameraModel, bench: Bench, data: Data) -> float:
    vectors = initial_frame_vectors(
        model,
        data.pixel_px,
        installation=bench.installation,
        table_rotation=bench.table.rotation(data.reading_rad),
    )
    return float(mean_and_chords(vectors[None])[1].sum())


def _mean(values: FloatArray) -> VarianceRatio:
    if len(values) < 2:
        return VarianceRatio(value=float("nan"), error=float("nan"))
    return VarianceRatio(value=float(values.mean()), error=float(values.std(ddof=1) / np.sqrt(len(values))))
