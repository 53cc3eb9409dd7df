"""Many runs on coordinates: does the covariance say the truth, which error dominates, what do leaning axes cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.attitude.link import angles_of_rotation
from calib.calibration.record import Calibration
from calib.cameras import CameraModel
from experiments.laboratory.single_star.bench import Bench
from experiments.laboratory.single_star.derivatives import reading_covariance_px2
from experiments.laboratory.single_star.reduce import Data, reduce_data
from experiments.laboratory.single_star.star import star_angles_deg
from experiments.turntable.bound import bound
from experiments.turntable.evaluation import judge
from experiments.turntable.traced import TracedMap
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD, DEG_RAD
from render.engine.random import Streams

__all__ = [
    "Coordinates",
    "LeanPoint",
    "MonteCarlo",
    "ReadingPoint",
    "equal_reading_noise_arcsec",
    "lean_sweep",
    "monte_carlo",
    "reading_sweep",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Coordinates:
    """A bench whose camera *is* a model, so that its parameters have a truth."""

    model: CameraModel  # The camera
    bench: Bench  # Star, table, installation
    true_rad: FloatArray  # (n, k) Angles
    covariance_px2: FloatArray  # (n, 2, 2) Of the centroids
    start: CameraModel  # Where every calibration starts
    start_star: FloatArray  # (3,) Start of the star's direction

    def draw(self, streams: Streams, run: int) -> Data:
        """One noisy data set."""
        deviation = np.linalg.cholesky(self.covariance_px2)
        normal = streams.generator("centroids", run).standard_normal((len(self.true_rad), 2))
        exact = self.model.project(self.bench.seen(self.true_rad))
        return Data(
            pixel_px=exact + np.einsum("nij,nj->ni", deviation, normal),
            covariance_px2=self.covariance_px2,
            reading_rad=self.bench.table.read(self.true_rad, streams, call=run),
        )

    def truth(self, names: Sequence[str]) -> FloatArray:
        """True values of the estimator's unknowns."""
        known = dict(zip(self.model.parameter_names, self.model.parameters, strict=True))
        azimuth, elevation = star_angles_deg(self.bench.star) * DEG_RAD
        known |= {"star_azimuth_rad": azimuth, "star_elevation_rad": elevation}
        angles = angles_of_rotation(self.bench.installation)
        known |= {f"theta{i + 1}_rad": angle for i, angle in enumerate(angles)}
        leans = self.bench.table.non_orthogonality_arcsec * ARCSEC_RAD
        known |= {f"lean{i + 1}_rad": lean for i, lean in enumerate(leans)}
        return np.array([known[name] for name in names])

    def with_reading_noise(self, sigma_arcsec: float) -> Coordinates:
        """The same with one reading noise on all axes."""
        table = self.bench.table
        noise = np.full(len(table.axis), sigma_arcsec)
        return replace(self, bench=replace(self.bench, table=replace(table, reading_noise_arcsec=noise)))

    def with_leans(self, lean_arcsec: float) -> Coordinates:
        """The same with one non-orthogonality between all neighbours."""
        table = self.bench.table
        lean = np.full(len(table.axis) - 1, lean_arcsec)
        return replace(self, bench=replace(self.bench, table=replace(table, non_orthogonality_arcsec=lean)))

    def map_bound_arcsec(self, traced: TracedMap) -> float:
        """Cramer-Rao bound of the map error, axes' leans unknown."""
        noise = self.covariance_px2 + reading_covariance_px2(self.model, self.bench, self.true_rad)
        found = bound(self.model, self.bench, self.true_rad, noise, traced.direction, leans=True)
        return found.map_sigma_arcsec


@dataclass(frozen=True, slots=True, kw_only=True)
class MonteCarlo:
    """Many calibrations of the same bench; r runs that converged."""

    names: tuple[str, ...]  # Unknowns (q)
    truth: FloatArray  # (q,) Their true values
    error: FloatArray  # (r, q) Estimate minus truth
    pull: FloatArray  # (r, q) The same over the estimator's own standard deviation
    map_rms_arcsec: FloatArray  # (r,) RMS length of the error of the line of sight after the best rotation
    predicted_map_arcsec: FloatArray  # (r,) What each run's covariance says of it
    reduced_chi2: FloatArray  # (r,) Of each fit
    lost: int  # Runs that did not converge

    @property
    def runs(self) -> int:
        """Runs that converged."""
        return len(self.error)

    @property
    def pull_std(self) -> FloatArray:
        """RMS of the pulls (q,): 1 if the covariance says the truth and nothing is biased."""
        return np.asarray(np.sqrt((self.pull**2).mean(0)))

    @property
    def map_arcsec(self) -> float:
        """RMS length of the map error over runs and field."""
        return float(np.sqrt((self.map_rms_arcsec**2).mean()))


def monte_carlo(
    setup: Coordinates,
    traced: TracedMap,
    streams: Streams,
    runs: int,
    *,
    leans: bool = True,
    advance: Callable[[], None] = lambda: None,
) -> MonteCarlo:
    """Calibrate fresh noise many times; the model is the truth here, not the traced lens."""
    believed = setup.bench.table.nominal
    judged = TracedMap(direction=traced.direction, pixel_px=setup.model.project(traced.direction))
    names: tuple[str, ...] = ()
    rows = []
    for run in range(runs):
        data = setup.draw(streams, run)
        calibration = reduce_data(data, believed, setup.start, leans=leans, start_star=setup.start_star)
        solution = calibration.solution
        names = solution.names
        if _usable(calibration, leans):
            line = judge(calibration, data, believed, judged).line_of_sight
            error = solution.value - setup.truth(names)
            rows.append(
                (error, error / solution.sigma, line.rms_arcsec, line.predicted_rms_arcsec, solution.reduced_chi2)
            )
        advance()
    columns: list[list[Any]] = [[row[i] for row in rows] for i in range(5)]
    error, pull = (np.array(columns[i], float).reshape(len(rows), len(names)) for i in range(2))
    return MonteCarlo(
        names=names,
        truth=setup.truth(names),
        error=error,
        pull=pull,
        map_rms_arcsec=np.array(columns[2], float),
        predicted_map_arcsec=np.array(columns[3], float),
        reduced_chi2=np.array(columns[4], float),
        lost=runs - len(rows),
    )


def _usable(calibration: Calibration, leans: bool) -> bool:
    """Converged; where the leans are ignored on purpose, the wrong model may end as it likes, with numbers."""
    solution = calibration.solution
    return solution.converged or (not leans and bool(np.isfinite(solution.sigma).all()))


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingPoint:
    """Map error at one reading noise: measured, its standard error, bound [arcsec]; RMS pull of all unknowns."""

    reading_arcsec: float
    measured_arcsec: float
    uncertainty_arcsec: float
    bound_arcsec: float
    pull_rms: float
    runs: int


def reading_sweep(
    setup: Coordinates,
    traced: TracedMap,
    streams: Streams,
    noises_arcsec: Sequence[float],
    runs: int,
    *,
    advance: Callable[[], None],
) -> list[ReadingPoint]:
    """Map error against the reading noise, the same on all axes, the centroids as they are."""
    points = []
    for noise in noises_arcsec:
        noisy = setup.with_reading_noise(noise)
        found = monte_carlo(noisy, traced, streams.child(f"{noise:g}"), runs)
        points.append(
            ReadingPoint(
                reading_arcsec=noise,
                measured_arcsec=found.map_arcsec,
                uncertainty_arcsec=_rms_error(found.map_rms_arcsec),
                bound_arcsec=noisy.map_bound_arcsec(traced),
                pull_rms=float(np.sqrt((found.pull**2).mean())) if found.runs else float("nan"),
                runs=found.runs,
            )
        )
        advance()
    return points


def equal_reading_noise_arcsec(points: Sequence[ReadingPoint], centroid_bound_arcsec: float) -> float:
    """Reading noise, the same on all axes, that doubles the variance of the map against centroids alone.

    The bound is b^2 = b0^2 + (s r)^2 to first order; s is taken where readings dominate. NaN if they nowhere count.
    """
    most = max(points, key=lambda point: point.reading_arcsec)
    slope2 = (most.bound_arcsec**2 - centroid_bound_arcsec**2) / max(most.reading_arcsec, 1e-300) ** 2
    return float(centroid_bound_arcsec / np.sqrt(slope2)) if slope2 > 0 else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class LeanPoint:
    """Map error at one non-orthogonality, ignored and estimated, with standard errors [arcsec]; chi2 if ignored."""

    lean_arcsec: float
    ignored_arcsec: float
    ignored_uncertainty_arcsec: float
    estimated_arcsec: float
    estimated_uncertainty_arcsec: float
    ignored_reduced_chi2: float
    runs: int


def lean_sweep(
    setup: Coordinates,
    traced: TracedMap,
    streams: Streams,
    leans_arcsec: Sequence[float],
    runs: int,
    *,
    advance: Callable[[], None],
) -> list[LeanPoint]:
    """Map error against the non-orthogonality of the axes, by those who know of it and by those who do not."""
    points = []
    for lean in leans_arcsec:
        leaning = setup.with_leans(lean)
        same = streams.child(f"{lean:g}")
        ignored = monte_carlo(leaning, traced, same, runs, leans=False)
        estimated = monte_carlo(leaning, traced, same, runs)
        points.append(
            LeanPoint(
                lean_arcsec=lean,
                ignored_arcsec=ignored.map_arcsec,
                ignored_uncertainty_arcsec=_rms_error(ignored.map_rms_arcsec),
                estimated_arcsec=estimated.map_arcsec,
                estimated_uncertainty_arcsec=_rms_error(estimated.map_rms_arcsec),
                ignored_reduced_chi2=float(ignored.reduced_chi2.mean()) if ignored.runs else float("nan"),
                runs=min(ignored.runs, estimated.runs),
            )
        )
        advance()
    return points


def _rms_error(values: FloatArray) -> float:
    """Standard error of the root mean square of independent values."""
    if len(values) < 2:
        return float("nan")
    square = values**2
    return float(square.std(ddof=1) / np.sqrt(len(values)) / (2 * np.sqrt(square.mean())))
