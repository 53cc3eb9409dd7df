"""One table from the rendering to the Monte-Carlo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from experiments.harness.progress import Progress
from experiments.laboratory.instrument import Instrument
from experiments.laboratory.single_star.derivatives import reading_covariance_px2
from experiments.laboratory.single_star.measure import Measurement, measure
from experiments.laboratory.single_star.reduce import Data, check_fit, check_parity, reduce_data, start_model
from experiments.laboratory.single_star.settings import TableConfig
from experiments.laboratory.single_star.setup import averaged, build_table
from experiments.laboratory.single_star.star import star_direction
from experiments.laboratory.turntable import Turntable
from experiments.turntable.bound import Bound, bound, knowledge, noise_shares
from experiments.turntable.evaluation import Reduction, judge
from experiments.turntable.monte_carlo import Coordinates, MonteCarlo, monte_carlo
from experiments.turntable.settings import Config
from experiments.turntable.traced import TracedMap
from optics.errors import DomainError
from render.engine.random import Streams

__all__ = ["Case", "one_table"]


LEAST_RUNS = 10
"""Converged runs of a Monte-Carlo below which it says nothing."""
ADVICE = (
    "the axes (reduction.axes), the start of the star (reduction.star_deg), the reading noise or the camera model are "
    "wrong, or too little of the field is visited"
)
"""What to look at when a calibration does not fit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One table."""

    name: str  # "two-axis" or "three-axis"
    config: TableConfig  # Its settings
    measurement: Measurement  # The rendered run
    # ``estimated``: non-orthogonality an unknown; ``ignored``: table taken as square; ``known``: taken as it is
    reductions: Mapping[str, Reduction]
    # Reductions of data with one error at a time. ``model``: true images and angles, leans known, so that only the
    # camera model can err; ``centroids``: rendered ones; ``readings``: noisy ones; ``leans``: taken as zero;
    # ``everything``, leans estimated
    split: Mapping[str, Reduction]
    # The bench with the model of ``split["model"]`` as its camera: the truth of the Monte-Carlo
    coordinates: Coordinates
    bound: Bound  # Cramer-Rao bound, leans unknown
    knowledge: Mapping[str, Bound]  # Bounds if something were known that is not
    shares: Mapping[str, float]  # Map error that each cause of noise makes [arcsec, RMS length]; squares add up
    monte_carlo: MonteCarlo  # Many runs on coordinates


def one_table(
    config: Config,
    instrument: Instrument,
    traced: TracedMap,
    name: str,
    table: TableConfig,
    streams: Streams,
    progress: Progress,
) -> Case:
    """One table from the rendering to the Monte-Carlo."""
    own = streams.child(name)
    with progress.stage(f"{name} table", total=5) as stage:
        measurement = measure(config, instrument, table, own, advance=stage.advance)
        reductions, split = _calibrate(config, instrument, traced, name, table, measurement)
        stage.advance()
    model = split["model"].calibration.model
    real = measurement.bench
    bench, angle = replace(real, table=averaged(real.table, config.frames)), np.array(measurement.visits.true_rad)
    centroid_px2 = np.array(measurement.readings.covariance_px2)
    coordinates = Coordinates(
        model=model,
        bench=bench,
        true_rad=angle,
        covariance_px2=centroid_px2,
        start=start_model(instrument, config.reduction.focal_length_mm),
        start_star=star_direction(*config.reduction.star_deg),
    )
    noise = centroid_px2 + reading_covariance_px2(model, bench, angle)
    with progress.stage(f"{name} Monte-Carlo", total=config.study.runs) as stage:
        found = monte_carlo(coordinates, traced, own.child("Monte-Carlo"), config.study.runs, advance=stage.advance)
    if found.runs < LEAST_RUNS:
        raise DomainError(
            f"{name} table: {found.lost} of {config.study.runs} calibrations of the Monte-Carlo did not converge; "
            "start nearer to the truth (reduction.star_deg, reduction.focal_length_mm) or visit more of the field"
        )
    return Case(
        name=name,
        config=table,
        measurement=measurement,
        reductions=reductions,
        split=split,
        coordinates=coordinates,
        bound=bound(model, bench, angle, noise, traced.direction, leans=True),
        knowledge=knowledge(model, bench, angle, noise, traced.direction),
        shares=noise_shares(model, bench, angle, centroid_px2, traced.direction),
        monte_carlo=found,
    )


def _calibrate(
    config: Config,
    instrument: Instrument,
    traced: TracedMap,
    name: str,
    table: TableConfig,
    measurement: Measurement,
) -> tuple[dict[str, Reduction], dict[str, Reduction]]:
    """Reductions of the rendered run, and of data with one error at a time."""
    start = start_model(instrument, config.reduction.focal_length_mm)
    real = averaged(measurement.bench.table, config.frames)
    believed = averaged(build_table(table, config.reduction.axes if name == "two-axis" else None), config.frames)
    square, quiet = believed.nominal, replace(real, reading_noise_arcsec=np.zeros(len(real.axis)))
    readings, visits = measurement.readings, measurement.visits
    images = {"seen": readings.position_px, "true": measurement.bundle_px}
    angles = {"read": visits.reading_rad, "true": visits.true_rad}
    ahead = star_direction(*config.reduction.star_deg)

    def one(image: str, angle: str, taken: Turntable, *, leans: bool = False) -> Reduction:
        data = Data(
            pixel_px=np.array(images[image]),
            covariance_px2=np.array(readings.covariance_px2),
            reading_rad=np.array(angles[angle]),
        )
        return judge(reduce_data(data, taken, start, leans=leans, start_star=ahead), data, taken, traced)

    check_parity(Data.of(measurement), square, start, ahead)
    estimated = one("seen", "read", square, leans=True)
    check_fit(estimated.calibration, f"{name} table", ADVICE)
    reductions = {
        "estimated": estimated,
        "ignored": one("seen", "read", square),
        "known": one("seen", "read", believed),
    }
    split = {
        "model": one("true", "true", quiet),
        "centroids": one("seen", "true", quiet),
        "readings": one("true", "read", real),
        "leans": one("true", "true", quiet.nominal),
        "everything": estimated,
    }
    check_fit(split["model"].calibration, f"{name} table, camera model against noise-free rays", ADVICE)
    return reductions, split
