"""The command line that all experiments share.

An experiment is a package ``experiments/NAME``: its ``__main__.py`` runs ``main`` of ``experiment.py``, a module with

* ``Config(ExperimentConfig)``: its settings; the defaults are the published run;
* ``run(config, *, progress) -> Result``: the work, without side effects;
* ``report(result) -> Report``: what ``report.html`` shows (called inside `plotting.house_style`);
* ``summary(result) -> (results, criteria)``: a mapping and a sequence of `Criterion`, for ``summary.json``;
* optionally ``tables(result) -> {name: Table}``: written as ``NAME.ecsv``;
* optionally ``files(result, folder)``: writes further files (FITS frames) into ``folder``;
* optionally ``options``: text options of its own, each short for one key of the configuration;
* optionally ``output(path, config)``: an output folder of its own kind, for work that is to be taken up again; ``run``
  is then given it as ``output=``;
* and, at its end::

      main = command("NAME", config=Config, run=run, report=report, summary=summary, quick={"frames": 4})

The first line of the module's docstring is what ``python -m experiments`` lists. Import what is slow (mitsuba, astropy)
inside ``run``, so that ``--help`` and mistakes answer at once.
"""

from __future__ import annotations

import contextlib
import inspect
import json
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import click

from experiments.harness.config import ExperimentConfig, load_config
from experiments.harness.outputs import RECORD, OutputFolder
from experiments.harness.progress import terminal_progress
from experiments.harness.summary import Criterion
from optics.errors import StarbenchError

if TYPE_CHECKING:
    from experiments.harness.report import Report
    from experiments.harness.tables import Table

__all__ = ["Experiment", "Main", "command", "configuration_file"]

C = TypeVar("C", bound=ExperimentConfig)
R = TypeVar("R")
Main = Callable[..., int]

_INTERRUPTED = OutputFolder.interrupted

EXIT_GOOD, EXIT_FAILED, EXIT_BAD_INPUT, EXIT_BROKEN, EXIT_INTERRUPTED = 0, 1, 2, 3, 130


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
class Experiment(Generic[C, R]):
    """An experiment as the command line sees it; the fields are the parameters of `command`."""

    name: str
    config: type[C]
    run: Callable[..., R]
    report: Callable[[R], Report]
    summary: Callable[[R], tuple[Mapping[str, Any], Sequence[Criterion]]]
    quick: Mapping[str, Any] = field(default_factory=dict)
    tables: Callable[[R], Mapping[str, Table]] | None = None
    show: Sequence[str] = ()
    files: Callable[[R, Path], None] | None = None
    renders: Callable[[C], bool] = field(default=lambda _: True)
    about: Callable[..., Any] | None = None
    options: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    output: Callable[[str, C], Output] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Options:
    file: str | None
    settings: tuple[str, ...]
    short: Mapping[str, str]
    seed: int | None
    backend: str
    out: str
    quick: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class _Outcome:
    result: Any
    config: ExperimentConfig
    results: Mapping[str, Any]
    criteria: Sequence[Criterion]
    tables: Mapping[str, Table]


@dataclass(slots=True)
class _Interrupts:
    """Ctrl-C and a polite kill: unwind, so that nothing half-written stays, or leave at once while nothing can be.

    Attributes
    ----------
    asked : list of int
        Signals that came.
    at_once : bool
        Whether a signal ends the process in its handler. True while a command starts: an exception raised amid the
        import of a native library can crash it, or be swallowed.
    stderr : int
        Descriptor of the error stream from before anybody turned it elsewhere, as the start of the renderer does.
    said : callable
        What to say.
    """

    asked: list[int] = field(default_factory=list)
    at_once: bool = False
    stderr: int = -1
    said: Callable[[], str] = lambda: _INTERRUPTED

    @contextlib.contextmanager
    def caught(self) -> Iterator[None]:
        """Take the signals over."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        with contextlib.suppress(OSError):  # closed by the caller
            self.stderr = os.dup(2)
        before = {number: signal.signal(number, self._interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            with contextlib.suppress(OSError):
                os.close(self.stderr)

    @contextlib.contextmanager
    def unwinding(self) -> Iterator[None]:
        """A part that has something to clear away."""
        before, self.at_once = self.at_once, False
        try:
            yield
        finally:
            self.at_once = before

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        del frame
        self.asked.append(number)
        if self.at_once:
            with contextlib.suppress(OSError):  # nobody listens
                os.write(self.stderr, f"{self.said()}\n".encode())
            _leave_at_once(EXIT_INTERRUPTED)
        raise KeyboardInterrupt


def command(
    name: str,
    *,
    config: type[C],
    run: Callable[..., R],
    report: Callable[[R], Report],
    summary: Callable[[R], tuple[Mapping[str, Any], Sequence[Criterion]]],
    quick: Mapping[str, Any] | None = None,
    tables: Callable[[R], Mapping[str, Table]] | None = None,
    show: Sequence[str] = (),
    files: Callable[[R, Path], None] | None = None,
    renders: bool | Callable[[Any], bool] = True,
    options: Mapping[str, tuple[str, str]] | None = None,
    output: Callable[[str, Any], Output] | None = None,
    about: Callable[..., Any] | None = None,
) -> Main:
    """Turn an experiment into a command.

    Parameters
    ----------
    name : str
        Module name; the default output folder is ``out/NAME``.
    config, run, report, summary
        See the module's docstring.
    quick : mapping, optional
        Dotted key -> value of the ``--quick`` run; the user's own settings win over it.
    tables : callable, optional
        ``tables(result) -> {file name without suffix: Table or astropy Table}``.
    show : sequence of str
        Names of those tables that are printed in the terminal too.
    files : callable, optional
        ``files(result, folder)`` writes anything else.
    renders : bool or callable
        Whether the backend has to be ready before `run` (`render.engine.Engine.start` is called); may depend on
        the configuration.
    options : mapping, optional
        Name of an option without dashes -> (key of the configuration, help text): ``--NAME TEXT`` is short for
        ``--set KEY=TEXT`` and wins over it.
    output : callable, optional
        ``output(path, config)``: the folder to write into, in place of an `experiments.harness.outputs.OutputFolder`;
        it may refuse the path.
    about : callable, optional
        A function of the module whose docstring is the help text; ``run`` if left out.

    Returns
    -------
    callable
        ``main(argv=None) -> int``: 0 when all criteria hold, 1 when one does not, 2 on bad input (one line on the
        error stream), 3 on a fault of the program (with its traceback), 130 after Ctrl-C.
    """
    experiment = Experiment(
        name=name,
        config=config,
        run=run,
        report=report,
        summary=summary,
        quick=quick or {},
        tables=tables,
        show=show,
        files=files,
        renders=renders if callable(renders) else lambda _: bool(renders),
        about=about,
        options=options or {},
        output=output,
    )
    outcome: list[int] = []
    interrupts = _Interrupts()
    parser = _parser(experiment, outcome, interrupts)

    def main(argv: Sequence[str] | None = None) -> int:
        outcome.clear()
        interrupts.asked.clear()
        interrupts.at_once = argv is None
        interrupts.said = lambda: _INTERRUPTED

        def work() -> None:
            with interrupts.caught():
                parser.main(argv, prog_name=f"python -m experiments.{name}", standalone_mode=False)

        status = _guarded(work, interrupts)
        if status == EXIT_INTERRUPTED and argv is None:
            if "multiprocessing.synchronize" not in sys.modules:  # its semaphores want Python's clean-up
                _leave_at_once(status)
            exec("")  # Python forgets that an interrupt passed, and ends with our exit code
        return status or (outcome[0] if outcome else EXIT_GOOD)

    return main


def _parser(experiment: Experiment[Any, Any], outcome: list[int], interrupts: _Interrupts) -> click.Command:
    module = inspect.getmodule(experiment.about or experiment.run)
    about = inspect.cleandoc((module.__doc__ if module else None) or f"The experiment {experiment.name}.")

    @click.command(help=about.partition("\n\n")[0], context_settings={"max_content_width": 100})
    @click.option("--config", "file", metavar="FILE", help="TOML file with any part of the configuration.")
    @click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="One setting, dotted keys; repeatable.")
    @click.option("--seed", type=click.IntRange(min=0), help="Seed of all random streams.")
    @click.option("--backend", type=click.Choice(["auto", "llvm", "cuda"]), default="auto", show_default=True)
    @click.option("--out", metavar="DIR", default=f"out/{experiment.name}", show_default=True, help="Output folder.")
    @click.option("--quick", is_flag=True, help="A small run that shows all parts in seconds.")
    @click.option("--schema", is_flag=True, help="Print the JSON schema of the configuration and stop.")
    def parse(schema: bool, **options: Any) -> None:
        if schema:
            click.echo(json.dumps(experiment.config.model_json_schema(), indent=2, ensure_ascii=False))
            return
        given = {name: options.pop(f"short_{name}") for name in experiment.options}
        short = {name: text for name, text in given.items() if text is not None}
        outcome.append(_perform(experiment, _Options(short=short, **options), interrupts))

    for name, (key, text) in experiment.options.items():
        help_text = f"{text} Short for --set {key}=TEXT."
        parse = click.option(f"--{name}", f"short_{name}", metavar="TEXT", help=help_text)(parse)
    return parse


def _perform(experiment: Experiment[Any, Any], options: _Options, interrupts: _Interrupts) -> int:
    short = [f"{experiment.options[name][0]}={text}" for name, text in options.short.items()]
    config = load_config(
        experiment.config,
        quick=experiment.quick if options.quick else None,
        file=configuration_file(options.file),
        settings=[*options.settings, *short],
        seed=options.seed,
    )
    with interrupts.unwinding():
        folder: Output = experiment.output(options.out, config) if experiment.output else OutputFolder(options.out)
    interrupts.said = lambda: folder.interrupted
    own = {"output": folder} if experiment.output else {}
    variant = None
    if experiment.renders(config):
        from render.engine import Engine

        variant = Engine.start(options.backend).variant
    interrupts.at_once = False
    progress = terminal_progress()
    result = experiment.run(config, progress=progress, **own)
    with progress.stage("write"):
        results, criteria = experiment.summary(result)
        tables = dict(experiment.tables(result)) if experiment.tables else {}
        outcome = _Outcome(result=result, config=config, results=results, criteria=criteria, tables=tables)
        with folder.writing() as staging:
            _write(experiment, outcome, staging, variant=variant, quick=options.quick, times_s=progress.times_s)
    _show(experiment, outcome, folder.shown)
    return EXIT_GOOD if all(criterion.passed for criterion in criteria) else EXIT_FAILED


def configuration_file(name: str | None) -> str | Path | None:
    """The file that is meant: a path, or the bare name of one that comes with the program (``experiments/data``)."""
    shipped = Path(__file__).parents[1] / "data" / f"{name}.toml"
    if name is None or Path(name).suffix or len(Path(name).parts) > 1 or not shipped.is_file():
        return name
    return shipped


def _write(
    experiment: Experiment[Any, Any],
    outcome: _Outcome,
    folder: Path,
    *,
    variant: str | None,
    quick: bool,
    times_s: Mapping[str, float],
) -> None:
    from experiments.harness.plotting import house_style
    from experiments.harness.provenance import collect, file_digests, without_paths
    from experiments.harness.report import render_html
    from experiments.harness.summary import dumps, summary
    from experiments.harness.tables import write_ecsv

    content = summary(experiment.name, outcome.config, outcome.results, outcome.criteria)
    content["config"] = without_paths(content["config"])
    (folder / "summary.json").write_text(dumps(content), encoding="utf-8")
    for name, table in outcome.tables.items():
        write_ecsv(table, folder / f"{name}.ecsv")
    if experiment.files is not None:
        experiment.files(outcome.result, folder)
    with house_style():
        document = experiment.report(outcome.result)
        origin = collect(experiment.name, content["config"], variant=variant, quick=quick, times_s=times_s)
        (folder / "report.html").write_text(render_html(document, outcome.criteria, origin), encoding="utf-8")
    origin["files"] = file_digests(folder)
    (folder / RECORD).write_text(dumps(origin), encoding="utf-8")


def _show(experiment: Experiment[Any, Any], outcome: _Outcome, shown: str) -> None:
    from rich.console import Console

    from experiments.harness.report import verdict_line
    from experiments.harness.tables import Table, to_rich

    console = Console()
    for name in experiment.show:
        console.print(to_rich(outcome.tables[name]))
    rows = [
        (one.name, one.value, f"{one.relation} {one.limit:.6g}", one.unit, "yes" if one.passed else "NO")
        for one in outcome.criteria
    ]
    heads = ("criterion", "value", "limit", "unit", "holds")
    console.print(to_rich(Table(columns=heads, rows=rows, caption="Criteria")))
    console.print(verdict_line(outcome.criteria), style="bold", highlight=False)
    console.print(f"report: {Path(shown) / 'report.html'}", highlight=False, soft_wrap=True)


def _guarded(work: Callable[[], None], interrupts: _Interrupts) -> int:
    """Exit code of ``work``; what the user can mend becomes one line.

    An interrupt in the middle of an import may come out as another error (an extension module that failed to load), so
    any error after one was ``asked`` for counts as the interrupt.
    """
    try:
        work()
    except (click.exceptions.Abort, KeyboardInterrupt):
        return _say(interrupts.said(), EXIT_INTERRUPTED)
    except Exception as error:
        if interrupts.asked:
            return _say(interrupts.said(), EXIT_INTERRUPTED)
        if isinstance(error, click.ClickException):
            return _say(error.format_message(), EXIT_BAD_INPUT)
        if isinstance(error, StarbenchError):
            return _say(str(error), EXIT_BAD_INPUT)
        traceback.print_exc()
        return EXIT_BROKEN
    return EXIT_GOOD


def _leave_at_once(status: int) -> None:
    """End the process of an interrupted command without Python's clean-up; everything of ours is unwound by now.

    The clean-up could end in another exit code: Python dies by the signal if the interrupt passed through an ``exec``
    of a string (as in the making of a dataclass), and native libraries caught amid their import may crash.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def _say(sentence: str, status: int) -> int:
    line = "; ".join(part.strip() for part in sentence.splitlines() if part.strip())
    print(f"error: {line}" if status == EXIT_BAD_INPUT else line, file=sys.stderr)
    return status
