"""Many calibrations on coordinates: test of the covariance, and reading noise equivalent to the centroid noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.calibration.record import Calibration
from calib.calibration.star_bench import (
    StarBench,
    reading_covariance_px2,
    true_unknowns,
    unknown_names,
)
from calib.calibration.table_bound import table_bound
from calib.calibration.table_reduction import PoseData, calibrate_on_table
from calib.cameras import CameraModel
from calib.cameras.line_of_sight import LineOfSightMap, line_of_sight_map
from experiments.harness.drawings import curves
from experiments.harness.sections import Section, col
from experiments.harness.summary import Measured
from experiments.laboratory.devices.turntable import Turntable
from experiments.laboratory.single_star.measure import TracedMap
from optics.arrays import FloatArray
from render.engine.random import Streams


@dataclass(frozen=True, slots=True, kw_only=True)
class Coordinates:
    """A bench whose camera is a model with true parameters."""

    model: CameraModel
    bench: StarBench  # Star, table, installation
    true_rad: FloatArray  # (n, k) True angles of the table
    covariance_px2: FloatArray  # (n, 2, 2) Covariance of the centroids
    start: CameraModel  # Start of every calibration
    start_star: FloatArray  # (3,) Start of the star's direction

    def draw(self, streams: Streams, run: int) -> PoseData:
        """A noisy data set."""
        assert isinstance(self.bench.table, Turntable)
        exact = PoseData(
            pixel_px=self.model.project(self.bench.star_in_cam(self.true_rad)),
            covariance_px2=self.covariance_px2,
            reading_rad=self.bench.table.read(self.true_rad, streams, call=run),
        )
        return exact.scattered(streams.generator("centroids", run).standard_normal(exact.pixel_px.shape))

    @property
    def truth(self) -> FloatArray:
        """True values of the estimator's unknowns."""
        return true_unknowns(self.model, self.bench, leans=True)

    def with_reading_noise(self, sigma_arcsec: float) -> Coordinates:
        """These coordinates with the same reading noise on all axes."""
        table = self.bench.table
        noise = np.full(len(table.axis), sigma_arcsec)
        return replace(self, bench=replace(self.bench, table=replace(table, reading_noise_arcsec=noise)))

    def map_bound_arcsec(self, traced: TracedMap) -> float:
        """Cramer-Rao bound of the map error, non-orthogonality of the axes unknown."""
        noise = self.covariance_px2 + reading_covariance_px2(self.model, self.bench, self.true_rad)
        return table_bound(self.model, self.bench, self.true_rad, noise, traced.direction, leans=True).map_sigma_arcsec


@dataclass(frozen=True, slots=True, kw_only=True)
class MonteCarlo:
    """Calibrations of the same bench with different noise; r runs that converged."""

    names: tuple[str, ...]  # Unknowns (q)
    truth: FloatArray  # (q,)
    error: FloatArray  # (r, q) Estimate minus truth
    pull: FloatArray  # (r, q) Error over the standard deviation stated by the fit
    map_rms_arcsec: FloatArray  # (r,) RMS length of the error of the line of sight after the best rotation
    predicted_map_arcsec: FloatArray  # (r,) Map error predicted by the covariance of the fit
    reduced_chi2: FloatArray  # (r,) Reduced chi^2 of each fit
    not_converged: int  # Number of runs that did not converge

    @property
    def runs(self) -> int:
        """Runs that converged."""
        return len(self.error)

    @property
    def rms_pull(self) -> FloatArray:
        """RMS of the pulls (q,): 1 for a correct covariance without bias."""
        return np.asarray(np.sqrt((self.pull**2).mean(0)))

    @property
    def map_arcsec(self) -> Measured:
        """RMS length of the map error over runs and field, with its standard error."""
        square = self.map_rms_arcsec**2
        count = len(square)
        rms = float(np.sqrt(square.mean())) if count else float("nan")
        error = float(square.std(ddof=1) / np.sqrt(count) / (2 * rms)) if count > 1 else float("nan")
        return Measured(value=rms, unit="arcsec", uncertainty=error, n=count)


def map_error(calibration: Calibration, traced: TracedMap) -> LineOfSightMap:
    """Error of a calibration over the field against the traced lens, and its prediction by the covariance."""
    return line_of_sight_map(calibration.model, traced.direction, traced.pixel_px, covariance=calibration.covariance)


def monte_carlo(
    coordinates: Coordinates,
    traced: TracedMap,
    streams: Streams,
    runs: int,
    *,
    advance: Callable[[], None] = lambda: None,
) -> MonteCarlo:
    """Calibrations with independent noise; the truth is the model, not the traced lens."""
    nominal = coordinates.bench.table.nominal
    traced_model = TracedMap(direction=traced.direction, pixel_px=coordinates.model.project(traced.direction))
    names = unknown_names(coordinates.model, coordinates.bench, leans=True)
    errors, pulls, maps = [], [], []
    for run in range(runs):
        data = coordinates.draw(streams, run)
        calibration = calibrate_on_table(
            data, nominal, coordinates.start, leans=True, start_star=coordinates.start_star
        )
        solution = calibration.solution
        if solution.converged:
            line_of_sight = map_error(calibration, traced_model)
            errors.append(solution.value - coordinates.truth)
            pulls.append(errors[-1] / solution.sigma)
            maps.append((line_of_sight.rms_arcsec, line_of_sight.predicted_rms_arcsec, solution.reduced_chi2))
        advance()
    map_rms, predicted, chi2 = np.array(maps, float).reshape(-1, 3).T
    return MonteCarlo(
        names=names,
        truth=coordinates.truth,
        error=np.array(errors, float).reshape(-1, len(names)),
        pull=np.array(pulls, float).reshape(-1, len(names)),
        map_rms_arcsec=map_rms,
        predicted_map_arcsec=predicted,
        reduced_chi2=chi2,
        not_converged=runs - len(maps),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingPoint:
    """Map error at a noise of the mean reading of a position, the same on all axes, with unchanged centroids."""

    reading_noise_arcsec: float = col("Noise of the mean reading", "arcsec", "g")
    measured_arcsec: Measured = col("Map error", "arcsec")
    bound_arcsec: float = col("Cramér–Rao bound", "arcsec", ".4f")
    rms_pull: float = col("RMS pull", "", ".3f")  # RMS over all unknowns and runs
    runs: int = col("Runs that converged")


def reading_sweep(
    coordinates: Coordinates,
    traced: TracedMap,
    streams: Streams,
    noises_arcsec: Sequence[float],
    runs: int,
    *,
    advance: Callable[[], None],
) -> list[ReadingPoint]:
    """Monte Carlo at every reading noise. It starts at the true camera, because it tests errors, not convergence."""
    started_at_truth = replace(coordinates, start=coordinates.model)
    points = []
    for noise in noises_arcsec:
        noisy = started_at_truth.with_reading_noise(noise)
        result = monte_carlo(noisy, traced, streams.child(f"{noise:g}"), runs)
        points.append(
            ReadingPoint(
                reading_noise_arcsec=noise,
                measured_arcsec=result.map_arcsec,
                bound_arcsec=noisy.map_bound_arcsec(traced),
                rms_pull=float(np.sqrt((result.pull**2).mean())) if result.runs else float("nan"),
                runs=result.runs,
            )
        )
        advance()
    return points


def equal_reading_noise_arcsec(points: Sequence[ReadingPoint], centroid_bound_arcsec: float) -> float:
    """Reading noise, the same on all axes, that doubles the variance of the map against centroids alone.

    The bound is b^2 = b0^2 + (s r)^2 to first order in the reading noise r; s is taken at the largest r. NaN if the
    readings do not contribute.
    """
    largest = max(points, key=lambda point: point.reading_noise_arcsec)
    readings2 = largest.bound_arcsec**2 - centroid_bound_arcsec**2
    if readings2 <= 0:
        return float("nan")
    return float(centroid_bound_arcsec * largest.reading_noise_arcsec / np.sqrt(readings2))


READINGS = Section(
    record=ReadingPoint,
    dim="reading",
    along="reading_noise_arcsec",
    table="reading_sweep",
    caption="Map error against the reading noise, two-axis table.",
    figures={
        "reading_curves": curves(
            "reading", points="measured_arcsec", lines="bound_arcsec", log="xy", y="Map error, RMS length"
        )
    },
)
