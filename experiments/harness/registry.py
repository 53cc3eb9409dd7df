"""Which experiments there are, found among the packages beside this one without importing any of their work."""

from __future__ import annotations

import importlib.util
import pkgutil
from collections.abc import Iterable
from functools import cache
from importlib import import_module, metadata
from typing import TYPE_CHECKING

import experiments as home
from optics.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    from experiments.harness.cli import Main

__all__ = ["GROUP", "declaration_of", "found", "load", "package_of"]

GROUP = "starbench.experiments"
"""Entry points under which other distributions offer experiments: ``NAME = "package"``, laid out as ours."""


def _is_experiment(package: str) -> bool:
    """Whether a package declares an experiment and ``python -m PACKAGE`` runs it; the frame itself does not."""
    return all(importlib.util.find_spec(f"{package}.{part}") for part in ("experiment", "__main__"))


@cache
def _packages() -> dict[str, str]:
    beside = [name for _, name, is_package in pkgutil.iter_modules(home.__path__) if is_package]
    ours = {name: f"{home.__name__}.{name}" for name in beside}
    ours = {name: package for name, package in ours.items() if _is_experiment(package)}
    others = {point.name: point.value for point in metadata.entry_points(group=GROUP)}
    return dict(sorted((others | ours).items()))


def found() -> dict[str, str]:
    """Experiments in alphabetical order: name -> what it answers, the first line of its package's docstring."""
    return {name: (import_module(at).__doc__ or "").strip().partition("\n")[0] for name, at in _packages().items()}


def package_of(name: str, beside: Iterable[str] = ()) -> str:
    """The package of an experiment."""
    packages = _packages()
    if name not in packages:
        raise unknown_name("experiment", name, [*packages, *beside])
    return packages[name]


def declaration_of(package: str) -> str:
    """Module that declares the experiment of a package: ``settings`` (or ``experiment``)."""
    settings = import_module(f"{package}.settings") if importlib.util.find_spec(f"{package}.settings") else None
    return f"{package}.{'settings' if hasattr(settings, 'experiment') else 'experiment'}"


def load(name: str, beside: Iterable[str] = ()) -> Main:
    """The command of an experiment; parameters and errors as of `package_of`."""
    package = package_of(name, beside)
    main = getattr(import_module(declaration_of(package)), "main", None)
    if main is None:
        raise ConfigError(f"experiment {name!r}: {declaration_of(package)} has no main = command(experiment)")
    command: Main = main
    return command
