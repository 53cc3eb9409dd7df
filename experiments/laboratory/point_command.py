"""The command of a test with point targets: frames are rendered, or with ``--frames FOLDER`` read from outside.

Each of the three tests brings its own ``run``, ``summary``, ``tables`` and ``report`` for rendered frames; what takes
their place for frames from outside is the same for all, and needs no renderer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from experiments.harness.cli import Main
from experiments.harness.experiment import Experiment
from experiments.harness.legacy import legacy_command as command
from experiments.harness.progress import Progress
from experiments.harness.summary import Criterion
from experiments.laboratory.point_settings import FRAMES_OPTION, PointConfig

if TYPE_CHECKING:
    from experiments.harness.report import Report
    from experiments.harness.tables import Table
    from experiments.laboratory.point_folder import Test

__all__ = ["point_command"]


def point_command(
    name: Test,
    *,
    config: type[PointConfig],
    run: Callable[..., Any],
    report: Callable[[Any], Report],
    summary: Callable[[Any], tuple[dict[str, Any], list[Criterion]]],
    tables: Callable[[Any], Mapping[str, Table]],
    show: Sequence[str],
    quick: Mapping[str, Any],
) -> Main:
    """Turn a test with point targets into a command; parameters as of `experiments.harness.cli.command`."""

    def either_run(settings: PointConfig, *, progress: Progress) -> Any:
        if settings.frames_folder is None:
            return run(settings, progress=progress)
        from experiments.laboratory.point_folder import run_folder

        return run_folder(name, settings, progress=progress)

    def either_summary(result: Any) -> tuple[dict[str, Any], list[Criterion]]:
        if result.config.frames_folder is None:
            return summary(result)
        from experiments.laboratory.point_folder import outcome

        return outcome(result)

    def either_tables(result: Any) -> Mapping[str, Table]:
        if result.config.frames_folder is None:
            return tables(result)
        from experiments.laboratory.point_folder_report import folder_tables

        return folder_tables(result)

    def either_report(result: Any) -> Report:
        if result.config.frames_folder is None:
            return report(result)
        from experiments.laboratory.point_folder_report import build_report

        return build_report(result)

    return command(
        name,
        about=run,
        config=config,
        run=either_run,
        report=either_report,
        summary=either_summary,
        tables=either_tables,
        show=show,
        quick=quick,
        options=FRAMES_OPTION,
        renders=lambda settings: settings.frames_folder is None,
    )


def frames_instead(test: Test) -> Callable[[PointConfig], Experiment | None]:
    """What takes over from a test with rendered frames when ``frames_folder`` names frames from outside."""

    def instead(settings: PointConfig) -> Experiment | None:
        if settings.frames_folder is None:
            return None
        from experiments.harness.legacy import legacy_experiment
        from experiments.laboratory.point_folder import outcome, run_folder
        from experiments.laboratory.point_folder_report import build_report, folder_tables

        return legacy_experiment(
            test,
            config=type(settings),
            run=lambda settings, *, progress: run_folder(test, settings, progress=progress),
            report=build_report,
            summary=outcome,
            tables=folder_tables,
            show=(),
            renders=False,
        )

    return instead
