"""Calibration of a star sensor with attitude-correlated frames (ACF17): Fig. 3 to 5 and Table 2, on star coordinates.

Star positions with noise and gyro rates are simulated as in Table 1 and calibrated by the document's method (ACC), with
a gyro of stated noise, by interstar angles (IAC, as published and fully weighted) and with free attitudes, a hundred
times each; everything stands beside the truth and the Cramer-Rao bound. Then what the document lacks: the pixel and the
number of stars that its numbers imply, from how many stars per frame on the gyro gains nothing, and the same
calibration on rendered frames (all of which is the experiment ``skycal``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from experiments.acf.settings import Config
from experiments.harness.legacy import legacy_command as command
from experiments.harness.progress import Progress

if TYPE_CHECKING:
    from experiments.acf.result import Result
    from experiments.harness.report import Report
    from experiments.harness.summary import Criterion
    from experiments.harness.tables import Table
    from experiments.skycal.result import Result as Rendered

__all__ = ["Config", "main", "report", "run", "summary", "tables"]


def run(config: Config, *, progress: Progress) -> Result:
    """Simulate, calibrate, compare.

    Raises
    ------
    StarbenchError
        On a camera that folds its image over, a motion that leaves an unknown undetermined, too few stars.
    """
    from experiments.acf.checks import check_design
    from experiments.acf.forecast import forecast
    from experiments.acf.inference import infer
    from experiments.acf.plan import make_plan, perform, runs_of
    from experiments.acf.result import Result
    from experiments.acf.simulate import build_scene
    from experiments.acf.tasks import sky_of
    from experiments.harness.provenance import peak_memory_mb, process_seconds

    scene = build_scene(config)
    check_design(config)
    with progress.stage("bounds"):
        inference = infer()
        inferred_um, inferred_stars = round(inference.best_um, 2), max(round(inference.best_stars), 2)
        plan = make_plan(config, inferred_um=inferred_um, inferred_stars=inferred_stars)
        expected = forecast(config, plan, inferred_um)
    with progress.stage("Monte Carlo", total=sum(runs_of(config, plan, point) for point in plan.points)) as stage:
        outcome = perform(config, plan, advance=stage.advance)
    rendered = _rendered(config, progress)
    return Result(
        config=config,
        scene=scene,
        stars=sky_of(config, plan.table2, 0).stars,
        plan=plan,
        outcome=outcome,
        forecast=expected,
        inference=inference,
        rendered=rendered,
        runtime_s=process_seconds(),
        peak_memory_mb=peak_memory_mb(),
    )


def _rendered(config: Config, progress: Progress) -> Rendered | None:
    """The calibration on pixels, if it is wanted."""
    if config.rendered.which == "none":
        return None
    from experiments.skycal.experiment import run as calibrate_on_pixels
    from experiments.skycal.settings import Config as PixelConfig

    wanted = PixelConfig(seed=config.seed, which=config.rendered.which, frames=config.rendered.frames)
    return calibrate_on_pixels(wanted, progress=progress)


def summary(result: Result) -> tuple[dict[str, Any], Sequence[Criterion]]:
    """What goes into ``summary.json``."""
    from experiments.acf.judge import criteria, results

    return results(result), criteria(result)


def tables(result: Result) -> Mapping[str, Table]:
    """Tables written beside the report."""
    from experiments.acf.tables import all_tables

    return all_tables(result)


def report(result: Result) -> Report:
    """What ``report.html`` shows."""
    from experiments.acf.report import build_report

    return build_report(result)


main = command(
    "acf",
    config=Config,
    run=run,
    report=report,
    summary=summary,
    tables=tables,
    show=("table2", "fig4"),
    quick={
        "rendered.which": "none",
        "runs": 12,
        "noise_px": [0.05, 0.1, 0.5],
        "bias_deg_per_h": [0.001, 0.1],
        "angle_random_walk_deg_per_sqrt_h": [0.0001, 0.01],
        "counts": [10, 20, 40],
        "sweep.stars": [3, 6, 20],
        "sweep.gyro_factor": [0.0, 1.0, 10.0],
        "sweep.skies": 12,
    },
)
