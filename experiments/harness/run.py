"""A run of an experiment, by command or from Python: settings, work, output."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, Literal

from experiments.harness.config import ExperimentConfig, load_config
from experiments.harness.experiment import Experiment
from experiments.harness.interrupts import interrupts
from experiments.harness.outputs import RECORD, OutputFolder
from experiments.harness.progress import Progress
from experiments.harness.registry import declared
from experiments.harness.summary import Criterion
from experiments.harness.system import one_thread
from optics.errors import ConfigError, unknown_name
from optics.validate import parse_model

if TYPE_CHECKING:
    import xarray as xr
    from astropy.table import Table as AstropyTable
    from matplotlib.figure import Figure

    from experiments.harness.quantities import Outcome
    from experiments.harness.tables import Table


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Options of a command line."""

    sensor: tuple[str, ...] = ()
    file: str | None = None
    settings: tuple[str, ...] = ()
    short: Mapping[str, str] = field(default_factory=dict)  # Name of an option of the experiment -> ``key=value``
    seed: int | None = None
    backend: str = "auto"
    out: str | None = None  # None writes nothing
    force: bool = False
    quick: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ExperimentRun:
    """A finished run of an experiment.

    Attributes
    ----------
    experiment : Experiment
        Declaration.
    outcome : Outcome
        Settings, result and quantities.
    criteria : tuple of Criterion
        Verdicts.
    tables : mapping of str to Table
        Tables of the report by name; `table` gives them to astropy.
    variant : str or None
        Mitsuba's variant, where something was rendered.
    quick : bool
        Whether it is the small run.
    times_s : mapping of str to float
        Seconds of each stage.
    """

    experiment: Experiment
    outcome: Outcome
    criteria: tuple[Criterion, ...]
    tables: Mapping[str, Table]
    variant: str | None = None
    quick: bool = False
    times_s: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        failed = [criterion.name for criterion in self.criteria if criterion.failed]
        met = f"{len(self.criteria)} criteria met" if self.criteria else "no criteria"
        verdict = f"not met: {', '.join(failed)}" if failed else met
        return f"<{self.experiment.name}: tables {', '.join(self.tables)}; {verdict}>"

    @property
    def config(self) -> Any:
        """The settings of the run."""
        return self.outcome.config

    @property
    def result(self) -> Any:
        """Results of the experiment: section -> record or records."""
        return self.outcome.result

    @property
    def data(self) -> xr.Dataset:
        """Every number of the report with its dimensions, label and unit, as ``results.nc`` holds it."""
        return self.outcome.data

    def table(self, name: str) -> AstropyTable:
        """A table of the report by name, as an `astropy.table.Table`."""
        from experiments.harness.tables import to_astropy

        if name not in self.tables:
            raise unknown_name("table", name, self.tables)
        table = to_astropy(self.tables[name])
        for column in table.itercols():
            if column.dtype.kind == "f":
                column.info.format = ".4g"
        return table

    def draw(self, name: str, *arguments: Any) -> Figure:
        """A figure of the report by name."""
        from experiments.harness.plotting import house_style

        with house_style():
            figure: Figure = self.experiment.draw(self.outcome, name, *arguments)
        return figure

    def write(self, folder: Path) -> None:
        """Write summary, tables, dataset, report and provenance."""
        from experiments.harness.document import render_document
        from experiments.harness.plotting import house_style
        from experiments.harness.provenance import collect, file_digests, without_paths
        from experiments.harness.quantities import to_coordinates, to_results, write_netcdf
        from experiments.harness.summary import dumps, summary
        from experiments.harness.tables import write_ecsv

        experiment, outcome = self.experiment, self.outcome
        data = outcome.data
        content = summary(experiment.name, outcome.config, to_results(data), to_coordinates(data), self.criteria)
        content["config"] = without_paths(content["config"])
        (folder / "summary.json").write_text(dumps(content), encoding="utf-8")
        for name, table in experiment.make_tables(outcome, every=True).items():
            write_ecsv(table, folder / f"{name}.ecsv")
        write_netcdf(data, folder / "results.nc")
        if experiment.files is not None:
            experiment.part(experiment.files)(outcome.result, folder)
        name, config = experiment.name, content["config"]
        with house_style():
            origin = collect(name, config, variant=self.variant, quick=self.quick, times_s=self.times_s)
            page = render_document(
                experiment.template,
                outcome,
                tables=self.tables,
                draw=partial(experiment.draw, outcome),
                criteria=self.criteria,
                provenance=origin,
                judged=experiment.judged,
            )
        (folder / "report.html").write_text(page, encoding="utf-8")
        origin["files"] = file_digests(folder)
        (folder / RECORD).write_text(dumps(origin), encoding="utf-8")


def finished(experiment: Experiment, config: ExperimentConfig, result: Any, **about: Any) -> ExperimentRun:
    """A result with its quantities, tables and criteria; ``about``: further fields of `ExperimentRun`."""
    outcome = experiment.outcome(config, result)
    criteria, tables = tuple(experiment.judge(outcome)), experiment.make_tables(outcome)
    return ExperimentRun(experiment=experiment, outcome=outcome, criteria=criteria, tables=tables, **about)


def perform(experiment: Experiment, options: Options, progress: Progress) -> tuple[ExperimentRun, Any]:
    """Run an experiment and write its results: the run, and its output folder (None if none is named)."""
    with one_thread(unless_set=True):
        experiment, config = _chosen(experiment, options)
        interrupts.at_once = False
        folder = _output_folder(experiment, options, config) if options.out is not None else None
        variant = None
        if experiment.renders(config):
            from render.engine import Engine

            with interrupts.leaving():
                variant = Engine.start(options.backend).variant
        if folder is not None:
            interrupts.message = lambda: folder.interrupted
        for note in config.notes():
            progress.note(fill(note, 80))
        output = {"output": folder} if experiment.output is not None else {}
        result = experiment.part(experiment.run)(config, progress=progress, **output)
        with progress.stage("write"):
            about = {"variant": variant, "quick": options.quick, "times_s": progress.times_s}
            run = finished(experiment, config, result, **about)
            if folder is not None:
                with folder.writing() as staging:
                    run.write(staging)
    return run, folder


def _chosen(experiment: Experiment, options: Options) -> tuple[Experiment, ExperimentConfig]:
    """Experiment to run, and its configuration; several sensors are a configuration each."""
    if len(options.sensor) < 2:
        config = configuration(experiment, options)
        return (experiment.instead(config) if experiment.instead is not None else None) or experiment, config
    if experiment.comparison is None:
        raise ConfigError(f"--sensor is given {len(options.sensor)} times: {experiment.name} takes one sensor")
    sensors = [configuration(experiment, replace(options, sensor=(file,))) for file in options.sensor]
    values = {"seed": sensors[0].seed, "sensors": sensors}
    return experiment.comparison, parse_model(experiment.comparison.config, values, "several --sensor")


def configuration(experiment: Experiment, options: Options) -> Any:
    """The configuration of an experiment for at most one sensor."""
    return load_config(
        experiment.config,
        quick=experiment.quick if options.quick else None,
        sensor=options.sensor[0] if options.sensor else None,
        file=configuration_file(options.file),
        settings=options.settings,
        options=options.short,
        seed=options.seed,
    )


def configuration_file(name: str | None) -> str | Path | None:
    """A path as it is, or the file of a bare name that comes with the program (``experiments/data``)."""
    shipped = Path(__file__).parents[1] / "data" / f"{name}.toml"
    if name is None or Path(name).suffix or len(Path(name).parts) > 1 or not os.path.isfile(shipped):
        return name
    return shipped


def _output_folder(experiment: Experiment, options: Options, config: ExperimentConfig) -> Any:
    """The output folder; a folder of another run is refused without ``--force``."""
    if options.out is None or not options.out.strip():
        raise ConfigError("--out is empty: name a folder")
    if experiment.output is not None:
        if options.force:
            raise ConfigError(
                f"--force: {experiment.name} extends its folder and never replaces it; remove the folder to start anew"
            )
        return experiment.part(experiment.output)(options.out, config)
    if "://" in options.out:
        raise ConfigError(f"--out {options.out}: a folder is needed; only datasets are written to URLs")
    folder = OutputFolder(options.out)
    if not options.force:
        from experiments.harness.provenance import without_paths

        folder.refuse_other_run(experiment.name, without_paths(config.model_dump(mode="json")))
    return folder


def run_experiment(
    name: str | Experiment,
    settings: Mapping[str, Any] | None = None,
    *,
    sensor: str | Path | Sequence[str | Path] | None = None,
    quick: bool = False,
    seed: int | None = None,
    out: str | Path | None = None,
    backend: Literal["auto", "llvm", "cuda"] = "auto",
) -> ExperimentRun:
    """Run an experiment as its command does.

    Parameters
    ----------
    name : str or Experiment
        A name of ``python -m experiments --names``, or a declaration.
    settings : mapping, optional
        Keys, dotted or short, and their values as for ``--set``: ``{"frames": 10, "instrument.exposure_s": 0.2}``.
    sensor : path or several, optional
        Sensor file, what ``--sensor`` takes.
    quick : bool
        The small run.
    seed : int, optional
        Seed; by default of the configuration.
    out : path, optional
        Folder to write, report included; by default nothing is written (a dataset needs a folder).
    backend : {"auto", "llvm", "cuda"}
        Backend of rendering, chosen once per process.

    Returns
    -------
    ExperimentRun
        Numbers, tables, figures, verdicts.

    Raises
    ------
    StarbenchError
        Input that the command refuses in one line.
    """
    experiment: Experiment = name if isinstance(name, Experiment) else declared(name)
    if experiment.output is not None and out is None:
        raise ConfigError(f"the experiment {experiment.name!r} writes during the run: name a folder, out=")
    options = Options(
        sensor=(str(sensor),) if isinstance(sensor, str | Path) else tuple(map(str, sensor or ())),
        settings=tuple(f"{key}={_text(value)}" for key, value in (settings or {}).items()),
        seed=seed,
        backend=backend,
        out=None if out is None else str(out),
        quick=quick,
    )
    return perform(experiment, options, Progress())[0]


def _text(value: Any) -> str:
    """A value as ``--set`` takes it."""
    return str(value) if isinstance(value, str | Path) else json.dumps(value, ensure_ascii=False)
