"""High spatial frequency error (ACC18 eq. 3-12): small steps of a hexapod, split by cause, predicted without frames.

A 5 x 5 point target is stepped over the pixels by 0.2 px at a time; thirty frames at every position are rendered, read
out, detected and centroided, and reduced as the document does. Response and offset patterns and bad pixels are switched
off one by one on the same random streams; the S-curve is what is left of an image without noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from experiments.harness.progress import Progress
from experiments.harness.summary import Criterion
from experiments.hsfe.settings import Config
from experiments.laboratory.point_command import point_command

if TYPE_CHECKING:
    from experiments.harness.report import Report
    from experiments.harness.tables import Table
    from experiments.hsfe.result import Result

__all__ = ["Config", "main", "report", "run", "summary", "tables"]


def run(config: Config, *, progress: Progress) -> Result:
    """Step, read out, reduce, predict.

    Parameters
    ----------
    config : Config
        Settings.
    progress : Progress
        Where to report.

    Raises
    ------
    StarbenchError
        On anything the user can mend: unknown lens or detector, target off the detector, a step larger than the window,
        points not detected or saturated, light beyond the range of the data.
    """
    from experiments.harness.provenance import peak_memory_mb, process_seconds
    from experiments.hsfe.result import Result, geometry_study, s_curves
    from experiments.laboratory.hexapod import Hexapod, turned
    from experiments.laboratory.high_frequency import StepPlan, measure_high_frequency
    from experiments.laboratory.high_frequency_model import predict_high_frequency
    from experiments.laboratory.instrument import build_instrument
    from experiments.laboratory.point_scene import point_scene
    from experiments.laboratory.point_settings import check_bench, make_bench
    from experiments.laboratory.temporal_error import target_place
    from render.detector.maps import sensor_maps
    from render.engine.random import Streams

    instrument = build_instrument(config.instrument)
    bench = make_bench(config, config.target)
    plan, hexapod = StepPlan(**config.steps.model_dump()), Hexapod(**config.hexapod.model_dump())
    plan.check(bench)
    rest = target_place(bench, instrument, config.place_px)
    streams = Streams(config.seed).child("hsfe")
    path = plan.path(instrument, hexapod, streams.generator("hexapod"))
    check_bench(bench, instrument, turned(rest, path.true_rad))
    with progress.stage("prepare"):
        scene = point_scene(bench, instrument)
        psf = scene.psfs(rest)
        defect = sensor_maps(instrument.detector).defect
    with progress.stage("before the test"):
        before = predict_high_frequency(
            bench,
            instrument,
            plan,
            psf=psf,
            hexapod=hexapod,
            place_px=config.place_px,
            subtraction=config.subtraction,
            defect=defect,
            draws=config.draws,
            seed=config.seed,
        )
    with progress.stage("steps", total=plan.positions) as stage:
        measured = measure_high_frequency(
            bench,
            instrument,
            hexapod,
            plan,
            place_px=config.place_px,
            subtraction=config.subtraction,
            streams=streams,
            scene=scene,
            advance=stage.advance,
        )
    with progress.stage("after the test"):
        # where the image stood is best read with the method that has no S-curve of its own
        without_curve = "epsf" if "epsf" in bench.methods else bench.methods[0]
        after = predict_high_frequency(
            bench,
            instrument,
            plan,
            psf=psf,
            hexapod=hexapod,
            shift_px=measured.common_shift_px(without_curve, before.place_px),
            place_px=config.place_px,
            subtraction=config.subtraction,
            defect=defect,
            draws=config.draws,
            seed=config.seed,
        )
        curves = s_curves(bench, instrument, psf, rest)
        geometry = geometry_study(bench, instrument, plan, hexapod, rest, streams)
    return Result(
        config=config,
        instrument=instrument,
        measured=measured,
        before=before,
        after=after,
        curves=curves,
        geometry=geometry,
        runtime_s=process_seconds(),
        peak_memory_mb=peak_memory_mb(),
    )


def summary(result: Result) -> tuple[dict[str, Any], list[Criterion]]:
    """What goes into ``summary.json``."""
    from experiments.hsfe.evaluate import criteria, results

    return results(result), criteria(result)


def tables(result: Result) -> Mapping[str, Table]:
    """Tables written beside the report."""
    from experiments.hsfe.tables import all_tables

    return all_tables(result)


def report(result: Result) -> Report:
    """What ``report.html`` shows."""
    from experiments.hsfe.report import build_report

    return build_report(result)


main = point_command(
    "hsfe",
    config=Config,
    run=run,
    report=report,
    summary=summary,
    tables=tables,
    show=("hsfe",),
    quick={
        "steps.positions": 6,
        "target.rows": 3,
        "target.columns": 3,
        "compare": ["gaussian", "epsf"],
    },
)
