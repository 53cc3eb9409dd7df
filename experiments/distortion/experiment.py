"""Distortion error (ACC18 eq. 17-30, Fig. 8): a surveyed 32-point grid, its residuals, the cubic, and the true map.

A grid target over the whole mosaic is rendered, read out thirty times, detected and centroided; mean centroids minus
surveyed coordinates are reduced as printed. The three numbers are labelled with what they are (found, left, removed),
predicted by ray trace, and judged by the error that the correction really has between the points.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from experiments.distortion.settings import Config
from experiments.harness.progress import Progress
from experiments.harness.summary import Criterion
from experiments.laboratory.point_command import point_command

if TYPE_CHECKING:
    from experiments.distortion.result import Result
    from experiments.harness.report import Report
    from experiments.harness.tables import Table

__all__ = ["Config", "main", "report", "run", "summary", "tables"]


def run(config: Config, *, progress: Progress) -> Result:
    """Render, read out, reduce, predict, compare with the true map.

    Parameters
    ----------
    config : Config
        Settings.
    progress : Progress
        Where to report.

    Raises
    ------
    StarbenchError
        On anything the user can mend: unknown lens or detector, target off the detector, points not detected or
        saturated, too few points for the polynomial, light beyond the range of the data.
    """
    from experiments.distortion.result import Result, correction_maps, forecasts
    from experiments.harness.provenance import peak_memory_mb, process_seconds
    from experiments.laboratory.distortion_error import dense_grid, measure_distortion, traced_bundles
    from experiments.laboratory.distortion_model import predict_distortion
    from experiments.laboratory.instrument import build_instrument
    from experiments.laboratory.point_scene import point_scene
    from experiments.laboratory.point_settings import check_bench, make_bench
    from experiments.laboratory.settings import TargetConfig
    from experiments.laboratory.targets import GridTarget, grid_directions
    from render.engine.random import Streams

    instrument = build_instrument(config.instrument)
    bench = make_bench(config, TargetConfig())  # a multi-star target that this test does not use
    target = GridTarget(**config.target.model_dump())
    streams = Streams(config.seed).child("distortion")
    direction = grid_directions(target, instrument, streams.generator("target"))
    check_bench(bench, instrument, direction[None])
    with progress.stage("prepare"):
        scene = point_scene(bench, instrument)
    with progress.stage("frames", total=2) as stage:
        measured = measure_distortion(
            bench,
            instrument,
            target,
            order=config.order,
            surveys=config.surveys,
            streams=streams,
            scene=scene,
            advance=stage.advance,
        )
    with progress.stage("prediction"):
        predicted = predict_distortion(
            bench,
            instrument,
            target,
            direction,
            psf=scene.psfs(direction),
            order=config.order,
            draws=config.draws,
            seed=config.seed,
        )
    with progress.stage("map"):
        grid = (config.map_rows, 2 * config.map_rows - 1)
        traced = traced_bundles(bench, instrument, dense_grid(instrument, *grid))
        maps = correction_maps(bench, measured, config, traced, grid)
        point_error = float((predicted.point_px[config.methods[0]] ** 2).mean() ** 0.5)
        forecast = forecasts(bench, instrument, target, config, point_error, traced, grid)
    return Result(
        config=config,
        instrument=instrument,
        measured=measured,
        predicted=predicted,
        maps=maps,
        forecast=forecast,
        runtime_s=process_seconds(),
        peak_memory_mb=peak_memory_mb(),
    )


def summary(result: Result) -> tuple[dict[str, Any], list[Criterion]]:
    """What goes into ``summary.json``."""
    from experiments.distortion.evaluate import criteria, results

    return results(result), criteria(result)


def tables(result: Result) -> Mapping[str, Table]:
    """Tables written beside the report."""
    from experiments.distortion.tables import all_tables

    return all_tables(result)


def report(result: Result) -> Report:
    """What ``report.html`` shows."""
    from experiments.distortion.report import build_report

    return build_report(result)


main = point_command(
    "distortion",
    config=Config,
    run=run,
    report=report,
    summary=summary,
    tables=tables,
    show=("distortion",),
    quick={
        "compare": ["cog"],
        "surveys": 50,
        "draws": 60,
        "map_rows": 9,
        "dark_frames": 50,
        "study.rows": [4, 8],
        "study.orders": [1, 3, 5],
    },
)
