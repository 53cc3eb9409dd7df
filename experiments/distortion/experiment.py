"""Distortion error (ACC18 eq. 17-30, Fig. 8): a surveyed 32-point grid, its residuals, the cubic, and the true map.

A grid target over the whole mosaic is rendered, read out thirty times, detected and centroided; mean centroids minus
surveyed coordinates are reduced as printed. The three numbers are labelled with what they are (found, left, removed),
predicted by ray trace, and judged by the error that the correction really has between the points.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.distortion.settings import Config
from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.laboratory.own_frames import or_own_frames

if TYPE_CHECKING:
    from experiments.distortion.result import Result

__all__ = ["Config", "experiment", "main", "run"]


def run(config: Config, *, progress: Progress) -> Result:
    """Render, read out, reduce, predict, compare with the true map."""
    from experiments.distortion.result import Result, correction_maps, forecasts
    from experiments.distortion.wide_field import wide_field
    from experiments.laboratory.distortion_error import dense_grid, measure_distortion, traced_bundles
    from experiments.laboratory.distortion_model import predict_distortion
    from experiments.laboratory.point_scene import point_laboratory, prepared_scene
    from experiments.laboratory.targets import GridTarget, grid_directions
    from render.detector.maps import sensor_maps
    from render.engine.random import Streams

    bench, instrument = point_laboratory(config)
    target = GridTarget(**config.target.model_dump())
    streams = Streams(config.seed).child("distortion")
    direction = grid_directions(target, instrument, streams.generator("target"))
    scene = prepared_scene(bench, instrument, direction[None], progress)
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
            psf=measured.light.psf,
            order=config.order,
            noise_draws=config.draws,
            defect=sensor_maps(instrument.detector).defect,
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
        wide=wide_field(config, streams.child("wide field"), progress=progress),
    )


rendered = Experiment(
    name="distortion",
    config=Config,
    run=run,
    takes="50 s (--quick: 23 s)",
    examples={
        "--quick": "a small run",
        "--set target.rows=8 --set target.columns=16 --set order=5": "more points, a higher order",
    },
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
experiment = or_own_frames(rendered)
main = command(experiment)
