"""Accuracy of star vectors: what is run, in which order, and the declaration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.fisher.settings import Config
from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.laboratory.own_frames.experiment import or_own_frames

if TYPE_CHECKING:
    from experiments.fisher.result import Result

__all__ = ["Config", "experiment", "main", "run"]


def run(config: Config, *, progress: Progress) -> Result:
    """Render, calibrate, evaluate; then the studies on coordinates."""
    import numpy as np

    from experiments.fisher.bench import run_bench
    from experiments.fisher.checks import check_config
    from experiments.fisher.coverage import DISTRIBUTIONS, coverage
    from experiments.fisher.degrees_of_freedom import same_data_sweep
    from experiments.fisher.field_of_view import field_sweep
    from experiments.fisher.precision import digits_sweep
    from experiments.fisher.result import Result
    from experiments.fisher.table_noise import table_sweep
    from render.engine.random import Streams

    instrument = check_config(config)
    streams = Streams(config.seed).child("fisher")
    bench = run_bench(config, instrument, progress)
    static = bench.cases[0]
    sigma_px = float(
        np.sqrt(np.einsum("nii->", static.acquisition.covariance_px2) / (2 * len(static.acquisition.places)))
    )
    with progress.stage("fields of view", total=len(config.field.field_deg)) as stage:
        fields = field_sweep(config.field, streams, advance=stage.advance)
    with progress.stage("coverage", total=len(DISTRIBUTIONS) * len(config.coverage.counts)) as stage:
        covered = coverage(config.coverage, streams, advance=stage.advance)
    with progress.stage("same data, coordinates", total=len(config.same_data.sides)) as stage:
        same = same_data_sweep(
            bench.model,
            bench.bench,
            sigma_px,
            config.same_data.sides,
            config.same_data.runs,
            streams,
            rolls_rad=[float(v) for v in np.radians(config.table.rolls_deg)],
            advance=stage.advance,
        )
    with progress.stage("precision, other tables"):
        digits = digits_sweep(streams)
        by_table = table_sweep(
            bench.model,
            bench.bench,
            static.acquisition.places.reading_rad,
            static.expected_arcsec["centroids"],
            sigma_px,
            streams,
        )
    return Result(
        config=config,
        instrument=instrument,
        bench=bench,
        field_sweep=fields,
        coverage=covered,
        same_data=same,
        digits=digits,
        table_sweep=by_table,
    )


rendered = Experiment(
    name="fisher",
    config=Config,
    run=run,
    takes="40 s (--quick: 23 s)",
    examples={
        "--quick": "a small run",
        "--set table.reading_noise_arcsec=[0.3,0.4]": "on the table of CUBE09",
        "--set evaluation.signal_e=10000 --set dynamic.rate_deg_per_s=0.1": "a brighter star, a faster table",
    },
    show=("accuracy", "field_of_view"),
    quick={
        "grid.columns": 9,
        "grid.rows": 5,
        "evaluation.columns": 9,
        "evaluation.rows": 5,
        "dynamic.samples": 6,
        "field.field_deg": [3.0, 12.0, 20.0, 40.0],
        "field.directions": 2000,
        "field.runs": 20,
        "coverage.counts": [5, 20, 100],
        "coverage.runs": 1500,
        "same_data.sides": [5, 8],
        "same_data.runs": 20,
    },
)
experiment = or_own_frames(rendered, "experiments.fisher.own_frames")
main = command(experiment)
