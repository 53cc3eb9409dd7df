"""Accuracy of star vectors by the Fisher distribution (FISHER23): the bench, its interval, and the pixel method.

A single star is rendered through the lens while a table carries its image over the whole detector, at rest and on the
move. A joint calibration (S100) on frames of its own gives camera, star and installation; with it the images of single
frames become vectors in the table's frame at zero angles (S200-S300), their concentration a standard deviation per axis
with a confidence interval (S400-S500). Beside it the usual method, pixel residuals times an angle per pixel; the bias
of that over the field of view; how often the interval holds the truth; and what calibrating and evaluating with the
same data does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from experiments.fisher.settings import Config
from experiments.harness.legacy import legacy_command as command
from experiments.harness.progress import Progress
from experiments.harness.summary import Criterion

if TYPE_CHECKING:
    from experiments.fisher.result import Result
    from experiments.harness.report import Report
    from experiments.harness.tables import Table

__all__ = ["Config", "main", "report", "run", "summary", "tables"]


def run(config: Config, *, progress: Progress) -> Result:
    """Render, calibrate, evaluate; then the studies on coordinates.

    Parameters
    ----------
    config : Config
        Settings.
    progress : Progress
        Where to report.

    Raises
    ------
    StarbenchError
        On anything the user can mend: too few places or too little of the detector covered, the star off the detector,
        not seen or saturated, a streak longer than its window.
    """
    import numpy as np

    from experiments.fisher.bench import run_bench
    from experiments.fisher.coverage import KINDS, coverage
    from experiments.fisher.field import field_sweep
    from experiments.fisher.limits import digits_sweep, table_sweep
    from experiments.fisher.prepare import prepare
    from experiments.fisher.result import Result
    from experiments.fisher.same import same_data_sweep
    from experiments.harness.provenance import peak_memory_mb, process_seconds
    from render.engine.random import Streams

    instrument = prepare(config)
    streams = Streams(config.seed).child("fisher")
    bench = run_bench(config, instrument, progress)
    static = bench.cases[0]
    sigma_px = float(
        np.sqrt(np.einsum("nii->", static.acquisition.covariance_px2) / (2 * len(static.acquisition.places)))
    )
    with progress.stage("fields of view", total=len(config.field.field_deg)) as stage:
        fields = field_sweep(config.field, streams, advance=stage.advance)
    with progress.stage("coverage", total=len(KINDS) * len(config.coverage.counts)) as stage:
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
    with progress.stage("limits"):
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
        runtime_s=process_seconds(),
        peak_memory_mb=peak_memory_mb(),
    )


def summary(result: Result) -> tuple[dict[str, Any], Sequence[Criterion]]:
    """What goes into ``summary.json``."""
    from experiments.fisher.evaluate import criteria, results

    return results(result), criteria(result)


def tables(result: Result) -> Mapping[str, Table]:
    """Tables written beside the report."""
    from experiments.fisher.tables import all_tables

    return all_tables(result)


def report(result: Result) -> Report:
    """What ``report.html`` shows."""
    from experiments.fisher.report import build_report

    return build_report(result)


main = command(
    "fisher",
    config=Config,
    run=run,
    report=report,
    summary=summary,
    tables=tables,
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
