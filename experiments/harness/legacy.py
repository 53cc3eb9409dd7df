"""Experiments that still describe their report in Python; goes when the last one is declared (`Experiment`)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from experiments.harness.cli import Main, command
from experiments.harness.experiment import Experiment


@dataclass(frozen=True, slots=True, kw_only=True)
class _Legacy(Experiment):
    old_report: Callable[..., Any]
    old_summary: Callable[..., Any]
    old_tables: Callable[..., Any] | None = None
    old_about: Callable[..., Any] | None = None

    @property
    def about(self) -> str:
        return sys.modules[(self.old_about or self.run).__module__].__doc__ or ""

    def outcome(self, config: Any, result: Any) -> Any:
        import xarray as xr

        from experiments.harness.quantities import Outcome

        return Outcome(config=config, result=result, data=xr.Dataset())

    def results(self, outcome: Any) -> dict[str, Any]:
        return dict(self.old_summary(outcome.result)[0])

    def make_tables(self, outcome: Any) -> dict[str, Any]:
        return dict(self.old_tables(outcome.result)) if self.old_tables else {}

    def judge(self, outcome: Any) -> list[Any]:
        return list(self.old_summary(outcome.result)[1])

    def page(self, outcome: Any, *, tables: Any, criteria: Any, provenance: Any) -> str:
        from experiments.harness.report import render_html

        return render_html(self.old_report(outcome.result), criteria, provenance)


def legacy_command(name: str, **parts: Any) -> Main:
    """Command of such an experiment."""
    return command(legacy_experiment(name, **parts))


def legacy_experiment(
    name: str,
    *,
    config: Any,
    run: Any,
    report: Any,
    summary: Any,
    quick: Mapping[str, Any] | None = None,
    tables: Any = None,
    show: Sequence[str] = (),
    files: Any = None,
    renders: Any = True,
    options: Any = None,
    output: Any = None,
    about: Any = None,
) -> Experiment:
    """Declaration of such an experiment."""
    return _Legacy(
        name=name,
        config=config,
        run=run,
        old_report=report,
        old_summary=summary,
        old_tables=tables,
        old_about=about,
        quick=quick or {},
        show=show,
        files=files,
        renders=renders if callable(renders) else lambda _: bool(renders),
        options=options or {},
        output=output,
    )
