"""Error budget of a star camera: predicted without frames, measured on rendered ones, beside the published (ACC18).

From one instrument (lens, detector, light, centroider, stars) every term is predicted by noise analysis, PSF sampling
and ray trace, and measured by running the virtual laboratory; both add up by eq. 31-32. Then: the budget against any
parameter (--sweep defocus_mm=-0.2:0.2:9), sensitivities, lenses as built, and the attitude from N stars.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from experiments.budget.settings import Config
from experiments.harness.legacy import legacy_command as command
from experiments.harness.progress import Progress
from experiments.harness.summary import Criterion

if TYPE_CHECKING:
    from experiments.budget.result import Result
    from experiments.harness.report import Report
    from experiments.harness.tables import Table

__all__ = ["Config", "main", "report", "run", "summary", "tables"]


def run(config: Config, *, progress: Progress) -> Result:
    """Predict, measure, vary.

    Parameters
    ----------
    config : Config
        Settings.
    progress : Progress
        Where to report.

    Raises
    ------
    StarbenchError
        On anything the user can mend: unknown lens, detector or element, target off the detector, points not detected
        or saturated, wavelengths that no data cover.
    """

    from experiments.budget.attitude import StarErrors, attitude_study
    from experiments.budget.combine import published
    from experiments.budget.laboratory import build_laboratory
    from experiments.budget.result import Result
    from experiments.budget.sweep import check_full_well, predict_sweep, predict_tornado, tornado_size
    from experiments.budget.terms import Psfs, measure_terms, predict_terms, steps_of
    from experiments.budget.tolerances import tolerance_study
    from experiments.budget.tune import differences
    from experiments.harness.provenance import peak_memory_mb, process_seconds
    from experiments.laboratory.checks import check_light
    from experiments.laboratory.target import corner_directions
    from render.engine.random import Streams

    lab = build_laboratory(config)
    check_light(lab.filtered, lab.instrument, corner_directions(config.target, lab.instrument))
    check_full_well(lab)
    psfs, streams, sweep_range = Psfs(), Streams(config.seed).child("budget"), config.sweep_range()
    with progress.stage("predict"):
        predicted = predict_terms(lab, psfs=psfs)
    with progress.stage("measure", total=steps_of(lab)) as stage:
        measured = measure_terms(lab, advance=stage.advance)
    sweep, tornado = None, None
    if sweep_range is not None:
        with progress.stage("sweep", total=len(sweep_range.values)) as stage:
            sweep = predict_sweep(config, sweep_range, psfs, advance=stage.advance)
    if config.tornado.parameters:
        with progress.stage("tornado", total=tornado_size(config)) as stage:
            tornado = predict_tornado(config, psfs, advance=stage.advance)
    with progress.stage("built lenses", total=config.tolerances.draws) as stage:
        tolerances = tolerance_study(lab, streams.child("tolerances"), advance=stage.advance)
    with progress.stage("attitude", total=len(config.attitude.counts)) as stage:
        errors = StarErrors.of(measured.budget)
        attitude = attitude_study(
            lab.instrument, errors, config.attitude, streams.child("attitude"), advance=stage.advance
        )
    return Result(
        config=config,
        lab=lab,
        predicted=predicted,
        measured=measured,
        published=published(),
        sweep=sweep,
        tornado=tornado,
        tolerances=tolerances,
        attitude=attitude,
        changed=differences(config),
        runtime_s=process_seconds(),
        peak_memory_mb=peak_memory_mb(),
    )


def summary(result: Result) -> tuple[dict[str, Any], list[Criterion]]:
    """What goes into ``summary.json``."""
    from experiments.budget.evaluate import criteria, results

    return results(result), criteria(result)


def tables(result: Result) -> Mapping[str, Table]:
    """Tables written beside the report."""
    from experiments.budget.tables import all_tables

    return all_tables(result)


def report(result: Result) -> Report:
    """What ``report.html`` shows."""
    from experiments.budget.report import build_report

    return build_report(result)


main = command(
    "budget",
    config=Config,
    run=run,
    report=report,
    summary=summary,
    tables=tables,
    show=("budget",),
    options={"sweep": ("sweep", "The budget against a parameter, e.g. defocus_mm=-0.2:0.2:9.")},
    quick={
        "frames": 10,
        "dark_frames": 30,
        "target.rows": 3,
        "target.columns": 3,
        "steps.places": 1,
        "steps.positions": 6,
        "sweep": "instrument.defocus_mm=0:0.02:3",
        "tornado.parameters": ["source.signal_e", "detector.read_noise_e", "instrument.defocus_mm"],
        "tolerances.draws": 30,
        "attitude.trials": 500,
        "attitude.counts": [2, 5, 10, 30],
    },
)
