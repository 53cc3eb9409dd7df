"""The command line common to all experiments: options, help, and terminal output of a run."""

from __future__ import annotations

import inspect
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from experiments.harness.experiment import Experiment
from experiments.harness.interrupts import EXIT_FAILED, EXIT_GOOD, invoke
from experiments.harness.progress import terminal_progress
from experiments.harness.registry import version_option
from experiments.harness.run import ExperimentRun, Options, configuration, perform
from optics.errors import ConfigError


class ExperimentCommand(click.Group):
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
        own_process = argv is None if own_process is None else own_process
        return invoke(self, argv, prog=f"python -m experiments.{self.name}", own_process=own_process)

    def _run(self, context: click.Context, schema: bool, defaults: str | None, **values: Any) -> int | None:
        if context.invoked_subcommand is not None:
            return None
        if schema:
            click.echo(json.dumps(self.experiment.config.model_json_schema(), indent=2, ensure_ascii=False))
            return None
        short = {}
        for name, (key, _) in _shorts(self.experiment).items():
            if (value := values.pop(_parameter(name))) not in (None, ()):
                short[name] = f"{key}={value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)}"
        options = Options(short=short, **values)
        if defaults is not None:
            click.echo(_defaults(self.experiment, options, complete=defaults == "all"), nl=False)
            return None
        progress = terminal_progress()
        progress.say = click.echo
        run, folder = perform(self.experiment, options, progress)
        _show(run, folder.shown)
        return EXIT_FAILED if any(criterion.failed for criterion in run.criteria) else EXIT_GOOD


command = ExperimentCommand


def _options(experiment: Experiment) -> list[click.Parameter]:
    sensor = "Sensor file (TOML), the same for all experiments but cube."
    sensor += "" if experiment.comparison is None else " Repeat it to compare sensors."
    text = "Print a commented sensor file with the values of the other options (all: every setting, for --config)."
    path, out = click.Path(readable=False), f"out/{experiment.name}"
    backends, files = click.Choice(["auto", "llvm", "cuda"]), click.Choice(["sensor", "all"])

    def keys(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
        from experiments.harness.range import leaf_keys

        keys = leaf_keys(experiment.config).items()
        return [CompletionItem(f"{key}=", help=field.description) for key, field in keys if key.startswith(incomplete)]

    return [
        click.Option(["--sensor"], metavar="FILE", type=path, multiple=True, help=sensor),
        click.Option(
            ["--config", "file"], metavar="FILE", type=path, help="TOML file with any part of the configuration."
        ),
        click.Option(
            ["--set", "settings"],
            metavar="KEY=VALUE",
            multiple=True,
            help="Change a setting, e.g. instrument.exposure_s=0.2, or exposure_s=0.2 if no other key ends so; "
            "repeatable.",
            shell_complete=keys,
        ),
        click.Option(["--seed"], type=click.IntRange(min=0), help="Seed of all random streams."),
        click.Option(["--backend"], type=backends, default="auto", show_default=True, help="CPU (llvm) or GPU (cuda)."),
        click.Option(["--out"], metavar="DIR", type=path, default=out, show_default=True, help="Output folder."),
        click.Option(["--force"], is_flag=True, help="Overwrite an output folder written with other settings."),
        click.Option(["--quick"], is_flag=True, help="Small run that includes every part."),
        click.Option(["--defaults"], type=files, is_flag=False, flag_value="sensor", help=text),
        version_option(),
        click.Option(["--schema"], is_flag=True, help="Print the JSON schema of the configuration and stop."),
        *(_short(experiment, name, key, text) for name, (key, text) in _shorts(experiment).items()),
    ]


def _shorts(experiment: Experiment) -> dict[str, tuple[str, str]]:
    """Short options of an experiment; ``--frames`` is the number of frames wherever there is such a number."""
    frames = experiment.config.model_fields.get("frames")
    common = {"frames": ("frames", f"Number of {frames.description}.")} if frames and frames.annotation is int else {}
    return {**common, **experiment.options}


def _parameter(option: str) -> str:
    return f"short_{option.replace('-', '_')}"


def _short(experiment: Experiment, name: str, key: str, text: str) -> click.Option:
    """An option that stands for ``--set KEY=...``: a switch, a repeatable one for a list of text, or text."""
    field = experiment.config.model_fields.get(key)
    annotation = None if field is None else field.annotation
    names = [f"--{name}", _parameter(name)]
    if annotation is bool:
        return click.Option(names, flag_value="true", default=None, help=f"{text} Short for --set {key}=true.")
    if annotation == tuple[str, ...]:
        return click.Option(names, metavar="TEXT", multiple=True, help=f"{text} Repeatable.")
    return click.Option(names, metavar="TEXT", help=f"{text} Short for --set {key}=TEXT.")


def _help(experiment: Experiment) -> str:
    """Question, duration and examples of the experiment."""
    parts = [inspect.cleandoc(experiment.about or f"The experiment {experiment.name}.").partition("\n\n")[0]]
    if experiment.takes:
        parts.append(f"Takes {experiment.takes} on two cores.")
    if experiment.examples:
        start = f"  python -m experiments.{experiment.name}"
        lines = [f"{start} {line}\n      {meaning}" for line, meaning in experiment.examples.items()]
        parts.append("\b\n" + "\n".join(["Examples:", *lines]))
    return "\n\n".join(parts)


def _defaults(experiment: Experiment, options: Options, *, complete: bool) -> str:
    """The configuration as a file: its sensor, or all of it."""
    from experiments.harness.settings_text import toml_text

    if len(options.sensor) > 1:
        raise ConfigError("--defaults writes one sensor: give one --sensor")
    config = configuration(experiment, options)
    sensor = None if complete else config.as_sensor(Path(options.sensor[0]) if options.sensor else None)
    run = f"python -m experiments.{experiment.name}"
    if sensor is None:
        return toml_text(config, f"All settings of the experiment {experiment.name}: {run} --config THIS_FILE")
    more = "every other experiment takes it too. Keys may be left out; docs/sensor_file.md says what holds then."
    return toml_text(sensor, f"A sensor file: {run} --sensor THIS_FILE; {more}")


def _show(run: ExperimentRun, folder: str) -> None:
    """Tables, criteria and verdict on the terminal."""
    from rich.console import Console

    from experiments.harness.summary import criteria_lines, verdict_line
    from experiments.harness.tables import to_rich

    console = Console()
    for name in run.experiment.show:
        if name in run.tables and run.tables[name].rows:
            console.print(to_rich(run.tables[name], console.width), "")
    for line in criteria_lines(run.criteria):
        console.print(line, style="red" if line.startswith("NO ") else None, highlight=False, markup=False)
    for criterion in run.criteria:
        if criterion.advice and criterion.failed:
            text = f"{criterion.name}: {criterion.advice}"
            console.print(text, style="red", highlight=False, markup=False, soft_wrap=True)
    console.print(verdict_line(run.criteria, run.experiment.judged), style="bold", highlight=False)
    console.print(f"report: {folder.rstrip('/')}/report.html", highlight=False, soft_wrap=True)
