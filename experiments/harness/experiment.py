"""Declaration of an experiment: its name, settings, run, sections and report.

A package ``experiments/NAME`` contains

* ``__init__.py``: a docstring whose first line states what the experiment answers (``python -m experiments`` lists it);
* ``settings.py``, light to import: ``Config(ExperimentConfig)``, whose defaults are the published run, and::

      experiment = Experiment(name="NAME", config=Config, run="experiment:run", sections="experiment:SECTIONS")
      main = command(experiment)

* ``experiment.py``, read from top to bottom: records of `experiments.harness.sections.col` fields, the computation,
  ``run(config, *, progress) -> {section: record or records}`` without side effects, and ``SECTIONS``;
* ``report.md``: the text of ``report.html`` (`experiments.harness.document`).

Parts are named as "module:function", relative to the package, and imported when work begins, so that ``--help`` and
error messages are fast.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.harness.config import ExperimentConfig
from experiments.harness.system import prompt_import
from optics.errors import unknown_name

if TYPE_CHECKING:
    from experiments.harness.quantities import Outcome
    from experiments.harness.sections import Section
    from experiments.harness.summary import Criterion
    from experiments.harness.tables import Table

Part = str | Callable[..., Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """Declaration of an experiment."""

    name: str  # On the command line; the default output folder is ``out/NAME``
    config: type[ExperimentConfig]
    # ``run(config, *, progress) -> {section: record, records or None}``; it reports stages to ``progress``
    # (`experiments.harness.progress.Progress`) and raises `StarbenchError` on bad input
    run: Part
    # Name -> `experiments.harness.sections.Section`; or ``sections(result)`` if they depend on the result
    sections: Part | Mapping[str, Any]
    # ``axes(config) -> Quantities``: dimensions that the sections share
    axes: Part | None = None
    # ``predict(config, *, progress)``: the same sections without frames, for sweeps and comparisons of sensors
    predict: Part | None = None
    swept: Sequence[str] = ()  # Quantities without dimensions that sweeps and comparisons show, the chief one first
    # Quantities along a numbered dimension that a comparison of sensors draws in a common figure
    compared: Sequence[str] = ()
    # ``limits(config)``: quantity -> (required value, whether at least), judged at every point of a sweep
    limits: Part | None = None
    takes: str = ""  # Duration of a default and of a quick run on two cores, for the help text
    # Arguments of at least two command lines -> their meaning
    examples: Mapping[str, str] = field(default_factory=dict)
    report: str | Path = "report.md"  # Template of the report, relative to the package
    # Dotted key -> value of the ``--quick`` run; the user's own settings win over it
    quick: Mapping[str, Any] = field(default_factory=dict)
    show: Sequence[str] = ()  # Tables that are printed in the terminal
    judged: str = "simulation"  # Subject of the verdict
    files: Part | None = None  # ``files(result, folder)`` writes further files
    # ``renders(config)``: whether the backend has to be ready before ``run``
    renders: Callable[[Any], bool] = field(default=lambda _: True)
    # Name of an option without dashes -> (key of the configuration, help text): ``--NAME TEXT`` is short for ``--set
    # KEY=TEXT`` and overrides it; repeatable if the key holds a list of text
    options: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    # ``output(path, config)``: another kind of output folder, for work that can be resumed; ``run`` takes it as
    # ``output=``
    output: Part | None = None
    # ``instead(config)``: another declaration that replaces this one for some settings, or None
    instead: Callable[[Any], Experiment | None] | None = None
    # Declaration for several ``--sensor``; its configuration has ``sensors``, a configuration of this experiment each
    comparison: Experiment | None = None

    @property
    def package(self) -> str:
        """Package that relative parts belong to."""
        return self.config.__module__.rpartition(".")[0]

    @property
    def about(self) -> str:
        """Docstring of the package, or of the module that declares the experiment."""
        module = sys.modules.get(self.package) or sys.modules[self.config.__module__]
        return (module.__doc__ or sys.modules[self.config.__module__].__doc__ or "").strip()

    @property
    def template(self) -> Path:
        """File of the report's template."""
        return Path(sys.modules[self.config.__module__].__file__ or ".").parent / self.report

    def parts(self, result: Any) -> Mapping[str, Section]:
        """Sections of the experiment."""
        declared: Any = self.part(self.sections) if isinstance(self.sections, str) else self.sections
        sections: Mapping[str, Section] = declared if isinstance(declared, Mapping) else declared(result)
        return sections

    def part(self, part: Part) -> Callable[..., Any]:
        """A part of the experiment, imported if it is a name."""
        if callable(part):
            return part
        module, _, name = part.partition(":")
        function: Callable[..., Any] = getattr(prompt_import(f"{self.package}.{module}"), name)
        return function

    def outcome(self, config: ExperimentConfig, result: Any) -> Outcome:
        """Result with its quantities."""
        from experiments.harness.quantities import Outcome, Quantities
        from experiments.harness.sections import described

        q = self.part(self.axes)(config) if self.axes is not None else Quantities()
        return Outcome(config=config, result=result, data=described(self.parts(result), q, result).dataset)

    def make_tables(self, outcome: Outcome, *, every: bool = False) -> dict[str, Table]:
        """Tables by name; with ``every`` all columns of the sections, which is what ECSV files hold."""
        from experiments.harness.pivot import Pivot, pivot
        from experiments.harness.sections import tabulated

        tables = tabulated(self.parts(outcome.result), outcome, every=every)
        return {name: pivot(outcome.data, t) if isinstance(t, Pivot) else t for name, t in tables.items()}

    def judge(self, outcome: Outcome) -> list[Criterion]:
        """Criteria of a run."""
        from experiments.harness.sections import judged

        return judged(self.parts(outcome.result), outcome)

    def draw(self, outcome: Outcome, name: str, *arguments: Any) -> Any:
        """Figure of the experiment by name."""
        sections = self.parts(outcome.result)
        figures = {figure: key for key, section in sections.items() for figure in section.figures}
        if name not in figures:
            raise unknown_name("figure", name, figures)
        key = figures[name]
        return sections[key].figures[name](replace(outcome, section=key), *arguments)
