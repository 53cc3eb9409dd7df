"""Joint calibration on a turntable with a single star (FISHER23, S100-S200): camera, star direction, installation.

A single-star simulator is rendered through the lens prescription while a table of two, then of three axes carries its
image over the whole detector; windows are read out with noise and centroided. From the images and the readings of the
table one joint calibration finds the camera, the direction of the star, the installation and how far the axes are from
square. The truth is the traced lens. Then, on coordinates: whether the covariance is honest, which reading error
dominates, what leaning axes cost, and why the principal point is not known though the line of sight is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.harness.legacy import legacy_command as command
from experiments.harness.progress import Progress
from experiments.harness.summary import Criterion
from experiments.laboratory.single_star.settings import TableConfig
from experiments.turntable.settings import Config
from optics.errors import ConfigError, DomainError

if TYPE_CHECKING:
    from experiments.harness.report import Report
    from experiments.harness.tables import Table
    from experiments.laboratory.instrument import Instrument
    from experiments.laboratory.single_star.measure import Measurement
    from experiments.turntable.reduce import Reduction
    from experiments.turntable.result import Case, Result
    from experiments.turntable.traced import TracedMap
    from render.engine.random import Streams

__all__ = ["Config", "main", "report", "run", "summary", "tables"]


LEAST_RUNS = 10
"""Converged runs of a Monte-Carlo below which it says nothing."""
ADVICE = (
    "the axes (reduction.axes), the start of the star (reduction.star_deg), the reading noise or the camera model are "
    "wrong, or too little of the field is visited"
)
"""What to look at when a calibration does not fit."""


def run(config: Config, *, progress: Progress) -> Result:
    """Render, read, calibrate, and judge against the traced lens.

    Parameters
    ----------
    config : Config
        Settings.
    progress : Progress
        Where to report.

    Raises
    ------
    StarbenchError
        On anything the user can mend: too few places or too little of the detector covered, the star off the detector
        or not seen, a table with one axis, axes that turn the other way than believed.
    """

    from experiments.harness.provenance import peak_memory_mb, process_seconds
    from experiments.turntable.bound import field_sweep
    from experiments.turntable.lenses import lens_points
    from experiments.turntable.result import Result
    from experiments.turntable.study import lean_sweep, reading_sweep
    from experiments.turntable.traced import traced_map
    from render.engine.random import Streams

    instrument = _prepare(config)
    streams = Streams(config.seed).child("turntable")
    with progress.stage("trace"):
        traced = traced_map(config, instrument)
    named = (("two-axis", config.two_axis), ("three-axis", config.three_axis))
    cases = [_case(config, instrument, traced, name, table, streams, progress) for name, table in named]
    study, setup = config.study, cases[0].coordinates
    near = replace(setup, start=setup.model)  # the sweeps ask for errors, not for convergence
    with progress.stage("reading noise", total=len(study.reading_noise_arcsec)) as stage:
        by_reading = reading_sweep(
            near,
            traced,
            streams.child("reading sweep"),
            study.reading_noise_arcsec,
            study.sweep_runs,
            advance=stage.advance,
        )
    with progress.stage("leaning axes", total=len(study.non_orthogonality_arcsec)) as stage:
        by_lean = lean_sweep(
            near,
            traced,
            streams.child("lean sweep"),
            study.non_orthogonality_arcsec,
            study.sweep_runs,
            advance=stage.advance,
        )
    with progress.stage("field of view"):
        sigma = float(np.sqrt(np.einsum("nii->", setup.covariance_px2) / (2 * len(setup.covariance_px2))))
        by_field = field_sweep(study.field_deg, sigma)
    with progress.stage("other lenses"):
        lenses = lens_points(config, instrument, traced)
    return Result(
        config=config,
        instrument=instrument,
        traced=traced,
        cases=cases,
        reading_sweep=by_reading,
        lean_sweep=by_lean,
        centroid_bound_arcsec=setup.with_reading_noise(0.0).map_bound_arcsec(traced),
        field_sweep=by_field,
        field_sigma_px=sigma,
        lenses=lenses,
        runtime_s=process_seconds(),
        peak_memory_mb=peak_memory_mb(),
    )


def _prepare(config: Config) -> Instrument:
    """The camera; whatever can be refused without rendering is refused here."""
    from experiments.laboratory.checks import check_wavelengths
    from experiments.laboratory.single_star.reduce import check_count
    from experiments.laboratory.single_star.setup import (
        build_star,
        build_table,
        camera_under_test,
        check_table,
        grid_px,
    )
    from experiments.laboratory.turntable import axis_directions

    check_table("two_axis", config.two_axis, 2)
    check_table("three_axis", config.three_axis, 3)
    if config.reduction.axes is not None and len(axis_directions(config.reduction.axes)) != 2:
        raise ConfigError(f"reduction.axes = {config.reduction.axes!r}: two axes are needed")
    for table in (config.two_axis, config.three_axis):
        check_count(config.grid.columns * config.grid.rows, build_table(table))
    instrument = camera_under_test(config)
    grid_px(config, instrument)
    check_wavelengths(instrument, [("star.passband_nm", build_star(config).band)])
    return instrument


def _case(
    config: Config,
    instrument: Instrument,
    traced: TracedMap,
    name: str,
    table: TableConfig,
    streams: Streams,
    progress: Progress,
) -> Case:
    """One table from the rendering to the Monte-Carlo."""
    from experiments.laboratory.collimator import star_direction
    from experiments.laboratory.single_star.derivatives import reading_covariance_px2
    from experiments.laboratory.single_star.measure import measure
    from experiments.laboratory.single_star.reduce import start_model
    from experiments.laboratory.single_star.setup import averaged
    from experiments.turntable.bound import bound, knowledge, noise_shares
    from experiments.turntable.result import Case
    from experiments.turntable.study import Coordinates, monte_carlo

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
    from experiments.laboratory.collimator import star_direction
    from experiments.laboratory.single_star.reduce import Data, check_fit, check_parity, reduce_data, start_model
    from experiments.laboratory.single_star.setup import averaged, build_table
    from experiments.turntable.reduce import judge

    start = start_model(instrument, config.reduction.focal_length_mm)
    real = averaged(measurement.bench.table, config.frames)
    believed = averaged(build_table(table, config.reduction.axes if name == "two-axis" else None), config.frames)
    square, quiet = believed.nominal, replace(real, reading_noise_arcsec=np.zeros(len(real.axis)))
    readings, visits = measurement.readings, measurement.visits
    images = {"seen": readings.position_px, "true": measurement.bundle_px}
    angles = {"read": visits.reading_rad, "true": visits.true_rad}

    ahead = star_direction(*config.reduction.star_deg)

    def one(image: str, angle: str, taken: Any, *, leans: bool = False) -> Reduction:
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


def summary(result: Result) -> tuple[dict[str, Any], Sequence[Criterion]]:
    """What goes into ``summary.json``."""
    from experiments.turntable.evaluate import criteria, results

    return results(result), criteria(result)


def tables(result: Result) -> Mapping[str, Table]:
    """Tables written beside the report."""
    from experiments.turntable.tables import all_tables

    return all_tables(result)


def report(result: Result) -> Report:
    """What ``report.html`` shows."""
    from experiments.turntable.report import build_report

    return build_report(result)


main = command(
    "turntable",
    config=Config,
    run=run,
    report=report,
    summary=summary,
    tables=tables,
    show=("unknowns_two_axis", "map_error"),
    quick={
        "grid.columns": 9,
        "grid.rows": 9,
        "study.runs": 60,
        "study.sweep_runs": 8,
        "study.reading_noise_arcsec": [0.01, 0.1, 0.3],
        "study.non_orthogonality_arcsec": [0.0, 10.0, 40.0],
        "study.field_deg": [3.0, 6.0, 12.0, 20.0, 40.0],
    },
)
