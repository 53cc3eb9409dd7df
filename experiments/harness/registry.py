"""Registry of experiments and commands, each loaded when it is called."""

from __future__ import annotations

import importlib.util
import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module, metadata
from typing import Any

import click
from click.shell_completion import CompletionItem

import experiments as home
from experiments.harness.outputs import PROGRAM
from optics.errors import ConfigError, unknown_name

GROUP = "starbench.experiments"
"""Entry points by which other distributions offer experiments: ``NAME = "package"``, laid out as those here."""


@cache
def _packages() -> dict[str, str]:
    """Packages with ``settings`` and ``experiment``, and packages of entry points, by name."""
    packages = {point.name: point.value for point in metadata.entry_points(group=GROUP)}
    for _, name, is_package in pkgutil.iter_modules(home.__path__):
        package = f"{home.__name__}.{name}"
        if is_package and all(importlib.util.find_spec(f"{package}.{part}") for part in ("settings", "experiment")):
            packages[name] = package
    return dict(sorted(packages.items()))


def experiment_names() -> dict[str, str]:
    """Experiments in alphabetical order: name -> the first line of its package's docstring, what it answers."""
    return {name: (import_module(at).__doc__ or "").strip().partition("\n")[0] for name, at in _packages().items()}


def declaration_of(package: str) -> str:
    """Module that declares the experiment of a package: ``settings`` (or ``experiment``)."""
    settings = import_module(f"{package}.settings") if importlib.util.find_spec(f"{package}.settings") else None
    return f"{package}.{'settings' if hasattr(settings, 'experiment') else 'experiment'}"


def _declaration(name: str) -> Any:
    if name not in _packages():
        raise unknown_name("experiment", name, _packages())
    return import_module(declaration_of(_packages()[name]))


def declared(name: str) -> Any:
    """The declaration of an experiment, an `experiments.harness.experiment.Experiment`."""
    return _declaration(name).experiment


def load(name: str) -> click.Command:
    """The command of an experiment."""
    module = _declaration(name)
    main: click.Command | None = getattr(module, "main", None)
    if main is None:
        raise ConfigError(f"experiment {name!r}: {module.__name__} has no main = command(experiment)")
    return main


class Commands(click.Group):
    """All experiments, and other commands: name -> (``module:command``, meaning); each is loaded when it is called."""

    def __init__(self, others: Mapping[str, tuple[str, str]], **settings: Any) -> None:
        super().__init__(**settings)
        self._others = others

    def _lines(self) -> dict[str, str]:
        return experiment_names() | {name: line for name, (_, line) in self._others.items()}

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands."""
        del ctx
        return list(self._lines())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """A command, loaded."""
        del ctx
        if cmd_name not in self._others:
            return load(cmd_name) if cmd_name in _packages() else None
        module, _, name = self._others[cmd_name][0].partition(":")
        command: click.Command = getattr(import_module(module), name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As in click; the error for an unknown name states the nearest known one."""
        if args[0] not in self._lines() and not args[0].startswith("-") and not ctx.resilient_parsing:
            raise unknown_name("experiment", args[0], self._lines())
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """A line for each command, none of them loaded."""
        del ctx
        others = {name: line for name, (_, line) in self._others.items()}
        for head, lines in (("Experiments", experiment_names()), ("Commands", others)):
            with formatter.section(head):
                formatter.write_dl(list(lines.items()))

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Names that begin with the text, without loading their commands, and options."""
        lines = self._lines().items()
        names = [CompletionItem(name, help=line) for name, line in lines if name.startswith(incomplete)]
        return [*names, *click.Command.shell_complete(self, ctx, incomplete)]


def version_of(package: str) -> str | None:
    """Version of an installed distribution."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def version_option() -> click.Option:
    """``--version``."""

    def show(context: click.Context, parameter: click.Parameter, wanted: bool) -> None:
        del parameter
        if wanted:
            click.echo(f"{PROGRAM} {version_of(PROGRAM) or '(source tree, not installed)'}")
            context.exit()

    text = "Show the version and stop."
    return click.Option(["--version"], is_flag=True, is_eager=True, expose_value=False, callback=show, help=text)
