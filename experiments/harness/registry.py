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
"""Entry points under which other distributions offer experiments: ``NAME = "package"``, laid out as ours."""


@cache
def _packages() -> dict[str, str]:
    """Packages of experiments by name: those with ``settings`` and ``experiment``, and those of entry points."""
    ours = {name: f"{home.__name__}.{name}" for _, name, package in pkgutil.iter_modules(home.__path__) if package}
    parts = ("settings", "experiment")
    ours = {name: at for name, at in ours.items() if all(importlib.util.find_spec(f"{at}.{part}") for part in parts)}
    others = {point.name: point.value for point in metadata.entry_points(group=GROUP)}
    return dict(sorted((others | ours).items()))


def found() -> dict[str, str]:
    """Experiments in alphabetical order: name -> what it answers, the first line of its package's docstring."""
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
    """All experiments, and other commands: name -> (``module:command``, what it does); each loaded when called for."""

    def __init__(self, others: Mapping[str, tuple[str, str]], **settings: Any) -> None:
        super().__init__(**settings)
        self._others = others

    def _lines(self) -> dict[str, str]:
        return found() | {name: line for name, (_, line) in self._others.items()}

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands."""
        del ctx
        return list(self._lines())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """One of them, loaded."""
        del ctx
        if cmd_name not in self._others:
            return load(cmd_name) if cmd_name in _packages() else None
        module, _, name = self._others[cmd_name][0].partition(":")
        loaded: click.Command = getattr(import_module(module), name)
        return loaded

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As in click; the error for an unknown name states the nearest known one."""
        if args[0] not in self._lines() and not args[0].startswith("-") and not ctx.resilient_parsing:
            raise unknown_name("experiment", args[0], self._lines())
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """A line for each, none of them loaded."""
        del ctx
        others = {name: line for name, (_, line) in self._others.items()}
        for head, lines in (("Experiments", found()), ("Commands", others)):
            with formatter.section(head):
                formatter.write_dl(list(lines.items()))

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Names that begin so, none of them loaded; and options."""
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
