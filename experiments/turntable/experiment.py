"""Run and declaration of the turntable calibration."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.laboratory.own_frames import or_own_frames
from experiments.turntable.settings import Config
from optics.errors import ConfigError

if TYPE_CHECKING:
    from experiments.laboratory.instrument import Instrument
    from experiments.turntable.result import Result

__all__ = ["Config", "experiment", "main", "run"]


def run(config: Config, *, progress: Progress) -> Result:
    """Render, read, calibrate, and judge against the traced lens."""
    from experiments.turntable.bound import field_sweep
    from experiments.turntable.case import one_table
    from experiments.turntable.lenses import lens_points
    from experiments.turntable.monte_carlo import lean_sweep, reading_sweep
    from experiments.turntable.result import Result
    from experiments.turntable.traced import traced_map
    from render.engine.random import Streams

    instrument = _prepare(config)
    streams = Streams(config.seed).child("turntable")
    with progress.stage("trace"):
        traced = traced_map(config, instrument)
    named = (("two-axis", config.two_axis), ("three-axis", config.three_axis))
    cases = [one_table(config, instrument, traced, name, table, streams, progress) for name, table in named]
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
    )


def _prepare(config: Config) -> Instrument:
    """The camera; whatever can be refused without rendering is refused here."""
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
    build_star(config, instrument)
    return instrument


rendered = Experiment(
    name="turntable",
    config=Config,
    run=run,
    takes="1 min (--quick: 20 s)",
    examples={
        "--quick": "few places and runs",
        "--set two_axis.non_orthogonality_arcsec=[20] --set two_axis.reading_noise_arcsec=[0.1]": "axes that lean "
        "more, on a table that reads better",
        "--set reduction.axes=x-y": "the reduction believes that the inner axis turns the other way: it is refused",
    },
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
experiment = or_own_frames(rendered)
main = command(experiment)
