"""The command line that all experiments share: options, run, output folder, terminal."""

from __future__ import annotations

import contextlib
import inspect
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import click

from experiments.harness.completion import files, folders, setting_keys
from experiments.harness.config import ExperimentConfig, load_config
from experiments.harness.experiment import Experiment
from experiments.harness.interrupts import EXIT_FAILED, EXIT_GOOD, EXIT_INTERRUPTED, Interrupts, guarded, leave
from experiments.harness.outputs import RECORD, OutputFolder
from experiments.harness.progress import terminal_progress
from experiments.harness.summary import Criterion
from experiments.harness.system import print_anything
from experiments.harness.threads import one_thread
from optics.errors import ConfigError
from optics.validate import parse_model

if TYPE_CHECKING:
    from experiments.harness.quantities import Outcome
    from experiments.harness.tables import Table

__all__ = ["Main", "Options", "Run", "asked", "command", "configuration_file", "finished", "output_folder", "write_run"]

Main = Callable[..., int]


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

    sensor: tuple[str, ...]
    file: str | None
    settings: tuple[str, ...]
    short: Mapping[str, str]
    seed: int | None
    backend: str
    out: str
    force: bool
    quick: bool


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


def command(experiment: Experiment) -> Main:
    """Turn an experiment into a command."""
    status_of_run: list[int] = []
    interrupts = Interrupts()
    parser = _parser(experiment, status_of_run, interrupts)

    def main(argv: Sequence[str] | None = None, *, own_process: bool | None = None) -> int:
        alone = argv is None if own_process is None else own_process
        if alone:
            print_anything()
        status_of_run.clear()
        interrupts.asked.clear()
        interrupts.at_once = alone
        interrupts.said = lambda: OutputFolder.interrupted

        def work() -> None:
            with interrupts.caught():
                parser.main(argv, prog_name=f"python -m experiments.{experiment.name}", standalone_mode=False)

        status = guarded(work, interrupts)
        if status == EXIT_INTERRUPTED and alone:
            leave(status)
        return status or (status_of_run[0] if status_of_run else EXIT_GOOD)

    main.parser = parser  # type: ignore[attr-defined]  # for completion
    return main


def _parser(experiment: Experiment, status: list[int], interrupts: Interrupts) -> click.Command:
    shorts = _shorts(experiment)

    @click.command(
        help=_help(experiment), context_settings={"max_content_width": 100, "help_option_names": ["-h", "--help"]}
    )
    @click.option("--sensor", metavar="FILE", multiple=True, help=_sensor_help(experiment), shell_complete=files)
    @click.option(
        "--config", "file", metavar="FILE", help="TOML file with any part of the configuration.", shell_complete=files
    )
    @click.option(
        "--set",
        "settings",
        metavar="KEY=VALUE",
        multiple=True,
        help="One setting, dotted keys; repeatable.",
        shell_complete=setting_keys(lambda: _keys(experiment)),
    )
    @click.option("--seed", type=click.IntRange(min=0), help="Seed of all random streams.")
    @click.option("--backend", type=click.Choice(["auto", "llvm", "cuda"]), default="auto", show_default=True)
    @click.option(
        "--out",
        metavar="DIR",
        default=f"out/{experiment.name}",
        show_default=True,
        help="Output folder.",
        shell_complete=folders,
    )
    @click.option("--force", is_flag=True, help="Replace the output of a run with other settings.")
    @click.option("--quick", is_flag=True, help="A small run that shows all parts in seconds.")
    @click.option(
        "--defaults",
        type=click.Choice(["sensor", "all"]),
        is_flag=False,
        flag_value="sensor",
        help="Print what the other options make of the defaults, as a commented file for --sensor (all: for --config).",
    )
    @click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=_version)
    @click.option("--schema", is_flag=True, help="Print the JSON schema of the configuration and stop.")
    def parse(schema: bool, defaults: str | None, **options: Any) -> None:
        if schema:
            click.echo(json.dumps(experiment.config.model_json_schema(), indent=2, ensure_ascii=False))
            return
        given = {name: options.pop(_parameter(name)) for name in shorts}
        short = {name: _text(value) for name, value in given.items() if value not in (None, ())}
        chosen = Options(short=short, **options)
        if defaults is not None:
            click.echo(_defaults(experiment, chosen, whole=defaults == "all"), nl=False)
            return
        with one_thread(unless_told=True):
            status.append(_perform(experiment, chosen, interrupts))

    for name, (key, text) in shorts.items():
        if _is_switch(experiment, key):
            help_text = f"{text} Short for --set {key}=true."
            parse = click.option(f"--{name}", _parameter(name), flag_value="true", default=None, help=help_text)(parse)
            continue
        if _is_list(experiment, key):
            help_text = f"{text} Repeatable."
            parse = click.option(f"--{name}", _parameter(name), metavar="TEXT", multiple=True, help=help_text)(parse)
            continue
        help_text = f"{text} Short for --set {key}=TEXT."
        parse = click.option(f"--{name}", _parameter(name), metavar="TEXT", help=help_text)(parse)
    return parse


def _keys(experiment: Experiment) -> Mapping[str, Any]:
    from experiments.harness.range import leaf_keys

    return leaf_keys(experiment.config)


def _shorts(experiment: Experiment) -> dict[str, tuple[str, str]]:
    """Short options of an experiment; ``--frames`` is the number of frames wherever there is such a number."""
    field = experiment.config.model_fields.get("frames")
    common = {"frames": ("frames", f"Number of {field.description}.")} if field and field.annotation is int else {}
    return {**common, **experiment.options}


def _is_switch(experiment: Experiment, key: str) -> bool:
    field = experiment.config.model_fields.get(key)
    return field is not None and field.annotation is bool


def _is_list(experiment: Experiment, key: str) -> bool:
    field = experiment.config.model_fields.get(key)
    return field is not None and field.annotation == tuple[str, ...]


def _text(value: str | tuple[str, ...]) -> str:
    """What ``--set`` would be given: text, or a list of text as TOML writes it."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _sensor_help(experiment: Experiment) -> str:
    text = "TOML file of a star sensor, taken by every experiment."
    return text if experiment.comparison is None else f"{text} Repeatable: sensors side by side."


def _parameter(option: str) -> str:
    return f"short_{option.replace('-', '_')}"


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


def asked(declared: Experiment, options: Options) -> tuple[Experiment, ExperimentConfig]:
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


def _perform(declared: Experiment, options: Options, interrupts: Interrupts) -> int:
    experiment, config = asked(declared, options)
    with interrupts.unwinding():
        folder: Output = output_folder(experiment, options, config)
    interrupts.said = lambda: folder.interrupted
    own = {"output": folder} if experiment.output else {}
    variant = None
    if experiment.renders(config):
        from render.engine import Engine

        variant = Engine.start(options.backend).variant
    interrupts.at_once = False
    progress = terminal_progress()
    result = experiment.part(experiment.run)(config, progress=progress, **own)
    with progress.stage("write"):
        run = finished(experiment, config, result, variant=variant, quick=options.quick, times_s=progress.times_s)
        with folder.writing() as staging:
            write_run(run, staging)
    _show(run, folder.shown)
    return EXIT_GOOD if all(criterion.passed for criterion in run.criteria) else EXIT_FAILED


def output_folder(experiment: Experiment, options: Options, config: ExperimentConfig) -> Output:
    """The output folder; that of another run is refused unless the user insists."""
    if not options.out.strip():
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


def _version(context: click.Context, parameter: click.Parameter, asked: bool) -> None:
    del parameter
    if asked:
        from experiments.harness.provenance import program_version

        click.echo(program_version())
        context.exit()


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


def write_run(run: Run, folder: Path) -> None:
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
