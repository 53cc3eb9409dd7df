"""The command line that all experiments share: options, run, output folder, terminal."""

from __future__ import annotations

import contextlib
import inspect
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import click
from click.shell_completion import CompletionItem

from experiments.harness.config import ExperimentConfig, load_config
from experiments.harness.experiment import Experiment
from experiments.harness.interrupts import EXIT_FAILED, EXIT_GOOD, interrupts, invoke
from experiments.harness.outputs import RECORD, OutputFolder
from experiments.harness.progress import Progress, terminal_progress
from experiments.harness.registry import version_option
from experiments.harness.summary import Criterion
from experiments.harness.system import one_thread
from optics.errors import ConfigError
from optics.validate import parse_model

if TYPE_CHECKING:
    from experiments.harness.quantities import Outcome
    from experiments.harness.tables import Table

__all__ = ["Main", "Options", "Run", "command", "configuration_file", "finished", "perform"]


class Output(Protocol):
    """Where an experiment writes; `experiments.harness.outputs.OutputFolder` is the usual kind."""

    @property
    def shown(self) -> str:
        """The folder as the user named it."""
        ...

    @property
    def interrupted(self) -> str:
        """What to say after an interrupt."""
        ...

    def writing(self) -> contextlib.AbstractContextManager[Path]:
        """Folder for the files that are written at the end."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """What a command line asks for."""

    sensor: tuple[str, ...] = ()
    file: str | None = None
    settings: tuple[str, ...] = ()
    short: Mapping[str, str] = field(default_factory=dict)
    seed: int | None = None
    backend: str = "auto"
    out: str | None = None  # None writes nothing
    force: bool = False
    quick: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A finished run, ready to be written."""

    experiment: Experiment
    outcome: Outcome
    criteria: Sequence[Criterion]
    tables: Mapping[str, Table]
    variant: str | None
    quick: bool
    times_s: Mapping[str, float]


class Main(click.Group):
    """An experiment as a command; a call runs it and gives the exit status. It may have subcommands."""

    def __init__(self, experiment: Experiment) -> None:
        super().__init__(
            experiment.name,
            help=_help(experiment),
            params=_options(experiment),
            callback=click.pass_context(self._run),
            invoke_without_command=True,
            subcommand_metavar="",
            context_settings={"max_content_width": 100, "help_option_names": ["-h", "--help"]},
        )
        self.experiment = experiment

    def __call__(self, argv: Sequence[str] | None = None, *, own_process: bool | None = None) -> int:
        """Run a command line; ``own_process``: whether the process ends with it, as it does without ``argv``."""
        alone = argv is None if own_process is None else own_process
        return invoke(self, argv, prog=f"python -m experiments.{self.name}", alone=alone)

    def _run(
        self, context: click.Context, schema: bool = False, defaults: str | None = None, **options: Any
    ) -> int | None:
        if context.invoked_subcommand is not None:
            return None
        if schema:
            click.echo(json.dumps(self.experiment.config.model_json_schema(), indent=2, ensure_ascii=False))
            return None
        given = {name: options.pop(_parameter(name)) for name in _shorts(self.experiment)}
        short = {name: _text(value) for name, value in given.items() if value not in (None, ())}
        chosen = Options(short=short, **options)
        if defaults is not None:
            click.echo(_defaults(self.experiment, chosen, whole=defaults == "all"), nl=False)
            return None
        run, folder = perform(self.experiment, chosen, terminal_progress())
        assert folder is not None
        _show(run, folder.shown)
        return EXIT_GOOD if all(criterion.passed for criterion in run.criteria) else EXIT_FAILED


def command(experiment: Experiment) -> Main:
    """Turn an experiment into a command."""
    return Main(experiment)


def _options(experiment: Experiment) -> list[click.Parameter]:
    sensor = "TOML file of a star sensor, taken by every experiment."
    sensor += "" if experiment.comparison is None else " Repeatable: sensors side by side."
    text = "Print what the other options make of the defaults, as a commented file for --sensor (all: for --config)."
    path = click.Path(readable=False)
    return [
        click.Option(["--sensor"], metavar="FILE", type=path, multiple=True, help=sensor),
        click.Option(
            ["--config", "file"], metavar="FILE", type=path, help="TOML file with any part of the configuration."
        ),
        click.Option(
            ["--set", "settings"],
            metavar="KEY=VALUE",
            multiple=True,
            help="One setting, dotted keys; repeatable.",
            shell_complete=lambda context, parameter, incomplete: _keys(experiment, incomplete),
        ),
        click.Option(["--seed"], type=click.IntRange(min=0), help="Seed of all random streams."),
        click.Option(["--backend"], type=click.Choice(["auto", "llvm", "cuda"]), default="auto", show_default=True),
        click.Option(
            ["--out"],
            metavar="DIR",
            type=path,
            default=f"out/{experiment.name}",
            show_default=True,
            help="Output folder.",
        ),
        click.Option(["--force"], is_flag=True, help="Replace the output of a run with other settings."),
        click.Option(["--quick"], is_flag=True, help="A small run that shows all parts in seconds."),
        click.Option(
            ["--defaults"], type=click.Choice(["sensor", "all"]), is_flag=False, flag_value="sensor", help=text
        ),
        version_option(),
        click.Option(["--schema"], is_flag=True, help="Print the JSON schema of the configuration and stop."),
        *(_short(experiment, name, *short) for name, short in _shorts(experiment).items()),
    ]


def _short(experiment: Experiment, name: str, key: str, text: str) -> click.Option:
    """An option that stands for ``--set KEY=...``: a switch, a repeatable one for a list of text, or text."""
    known = experiment.config.model_fields.get(key)
    words = [f"--{name}", _parameter(name)]
    if known is not None and known.annotation is bool:
        return click.Option(words, flag_value="true", default=None, help=f"{text} Short for --set {key}=true.")
    if known is not None and known.annotation == tuple[str, ...]:
        return click.Option(words, metavar="TEXT", multiple=True, help=f"{text} Repeatable.")
    return click.Option(words, metavar="TEXT", help=f"{text} Short for --set {key}=TEXT.")


def _keys(experiment: Experiment, incomplete: str) -> list[CompletionItem]:
    """Keys of ``--set`` that begin so, for the completion of shells."""
    from experiments.harness.range import leaf_keys

    fields = leaf_keys(experiment.config).items()
    return [CompletionItem(f"{key}=", help=one.description) for key, one in fields if key.startswith(incomplete)]


def _shorts(experiment: Experiment) -> dict[str, tuple[str, str]]:
    """Short options of an experiment; ``--frames`` is the number of frames wherever there is such a number."""
    known = experiment.config.model_fields.get("frames")
    common = {"frames": ("frames", f"Number of {known.description}.")} if known and known.annotation is int else {}
    return {**common, **experiment.options}


def _parameter(option: str) -> str:
    return f"short_{option.replace('-', '_')}"


def _text(value: str | tuple[str, ...]) -> str:
    """What ``--set`` would be given: text, or a list of text as TOML writes it."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _help(experiment: Experiment) -> str:
    """What the experiment answers, how long it takes, and examples."""
    about = inspect.cleandoc(experiment.about or f"The experiment {experiment.name}.").partition("\n\n")[0]
    parts = [about]
    if experiment.takes:
        parts.append(f"Takes {experiment.takes} on two cores.")
    if experiment.examples:
        lines = [
            f"  python -m experiments.{experiment.name} {line}\n      {does}"
            for line, does in experiment.examples.items()
        ]
        parts.append("\b\n" + "\n".join(["Examples:", *lines]))
    return "\n\n".join(parts)


def _asked(declared: Experiment, options: Options) -> tuple[Experiment, ExperimentConfig]:
    """What is to be run, and its configuration; several sensors are a configuration each."""
    if len(options.sensor) < 2:
        config = _configuration(declared, options)
        return (declared.instead(config) if declared.instead is not None else None) or declared, config
    side_by_side = declared.comparison
    if side_by_side is None:
        raise ConfigError(f"--sensor is given {len(options.sensor)} times: {declared.name} takes one sensor")
    sensors = [_configuration(declared, replace(options, sensor=(file,))) for file in options.sensor]
    return side_by_side, parse_model(
        side_by_side.config, {"seed": sensors[0].seed, "sensors": sensors}, "several --sensor"
    )


def _configuration(declared: Experiment, options: Options) -> Any:
    shorts = _shorts(declared)
    short = {name: f"{shorts[name][0]}={text}" for name, text in options.short.items()}
    return load_config(
        declared.config,
        quick=declared.quick if options.quick else None,
        sensor=options.sensor[0] if options.sensor else None,
        file=configuration_file(options.file),
        settings=options.settings,
        options=short,
        seed=options.seed,
    )


def _defaults(experiment: Experiment, options: Options, *, whole: bool) -> str:
    """The configuration as a file: the sensor that it runs with, or all of it."""
    from experiments.harness.settings_text import toml_text

    if len(options.sensor) > 1:
        raise ConfigError("--defaults writes one sensor: give one --sensor")
    config = _configuration(experiment, options)
    sensor = None if whole else config.as_sensor(Path(options.sensor[0]) if options.sensor else None)
    run = f"python -m experiments.{experiment.name}"
    if sensor is None:
        return toml_text(config, f"All settings of the experiment {experiment.name}: {run} --config THIS_FILE")
    return toml_text(
        sensor,
        f"A sensor file: {run} --sensor THIS_FILE; every other experiment takes it too. Keys may be left out; "
        "docs/sensor_file.md says what holds then.",
    )


def perform(declared: Experiment, options: Options, progress: Progress) -> tuple[Run, Output | None]:
    """Run an experiment and write what it gives: the run, and the folder where one is named."""
    with one_thread(unless_told=True):
        experiment, config = _asked(declared, options)
        interrupts.at_once = False
        folder = _output_folder(experiment, options, config) if options.out is not None else None
        variant = None
        if experiment.renders(config):
            from render.engine import Engine

            with interrupts.leaving():
                variant = Engine.start(options.backend).variant
        own: dict[str, Any] = {}
        if folder is not None:
            interrupts.said = lambda: folder.interrupted
            own = {"output": folder} if experiment.output else {}
        result = experiment.part(experiment.run)(config, progress=progress, **own)
        with progress.stage("write"):
            run = finished(experiment, config, result, variant=variant, quick=options.quick, times_s=progress.times_s)
            if folder is not None:
                with folder.writing() as staging:
                    _write_run(run, staging)
    return run, folder


def _output_folder(experiment: Experiment, options: Options, config: ExperimentConfig) -> Output:
    """The output folder; that of another run is refused unless the user insists."""
    if options.out is None or not options.out.strip():
        raise ConfigError("--out is empty: name a folder")
    if experiment.output is not None:
        if options.force:
            raise ConfigError(f"--force: {experiment.name} goes on with its folder and never replaces one; remove it")
        output: Output = experiment.output(options.out, config)
        return output
    if "://" in options.out:
        raise ConfigError(f"--out {options.out}: a folder is needed; only datasets are written to URLs")
    folder = OutputFolder(options.out)
    if not options.force:
        from experiments.harness.provenance import without_paths

        folder.refuse_other_run(experiment.name, without_paths(config.model_dump(mode="json")))
    return folder


def finished(
    experiment: Experiment,
    config: ExperimentConfig,
    result: Any,
    *,
    variant: str | None = None,
    quick: bool = False,
    times_s: Mapping[str, float] | None = None,
) -> Run:
    """A result with its quantities, tables and criteria; parameters as of `experiments.harness.provenance.collect`."""
    outcome = experiment.outcome(config, result)
    criteria, tables = experiment.judge(outcome), experiment.make_tables(outcome)
    return Run(
        experiment=experiment,
        outcome=outcome,
        criteria=criteria,
        tables=tables,
        variant=variant,
        quick=quick,
        times_s=times_s or {},
    )


def configuration_file(name: str | None) -> str | Path | None:
    """The file that is meant: a path, or the bare name of one that comes with the program (``experiments/data``)."""
    shipped = Path(__file__).parents[1] / "data" / f"{name}.toml"
    if name is None or Path(name).suffix or len(Path(name).parts) > 1 or not os.path.isfile(shipped):
        return name
    return shipped


def _write_run(run: Run, folder: Path) -> None:
    from experiments.harness.plotting import house_style
    from experiments.harness.provenance import collect, file_digests, without_paths
    from experiments.harness.quantities import write_netcdf
    from experiments.harness.summary import dumps, summary
    from experiments.harness.tables import write_ecsv

    experiment, outcome = run.experiment, run.outcome
    content = summary(experiment.name, outcome.config, experiment.results(outcome), run.criteria)
    content["config"] = without_paths(content["config"])
    (folder / "summary.json").write_text(dumps(content), encoding="utf-8")
    for name, table in experiment.make_tables(outcome, every=True).items():
        write_ecsv(table, folder / f"{name}.ecsv")
    write_netcdf(outcome.data, folder / "results.nc")
    if experiment.files is not None:
        experiment.part(experiment.files)(outcome.result, folder)
    with house_style():
        origin = collect(experiment.name, content["config"], variant=run.variant, quick=run.quick, times_s=run.times_s)
        page = experiment.page(outcome, tables=run.tables, criteria=run.criteria, provenance=origin)
    (folder / "report.html").write_text(page, encoding="utf-8")
    origin["files"] = file_digests(folder)
    (folder / RECORD).write_text(dumps(origin), encoding="utf-8")


def _show(run: Run, shown: str) -> None:
    from rich.console import Console

    from experiments.harness.summary import verdict_line
    from experiments.harness.tables import Table, to_rich

    console = Console()
    for name in run.experiment.show:
        if run.tables[name].rows:
            console.print(to_rich(run.tables[name]))
    rows = [(one.name, one.value, one.demand, one.unit, "yes" if one.passed else "NO") for one in run.criteria]
    heads = ("criterion", "value", "limit", "unit", "holds")
    if rows:
        console.print(to_rich(Table(columns=heads, rows=rows, caption="Criteria")))
    for one in run.criteria:
        if one.advice and not one.passed:
            console.print(f"{one.name}: {one.advice}", style="red", highlight=False, markup=False, soft_wrap=True)
    console.print(verdict_line(run.criteria, run.experiment.judged), style="bold", highlight=False)
    console.print(f"report: {shown.rstrip('/') or ''}/report.html", highlight=False, soft_wrap=True)
