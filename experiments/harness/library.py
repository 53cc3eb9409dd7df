"""An experiment from Python: what its command does, as a function."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from experiments.harness.cli import Options, Run, perform
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.harness.registry import declared
from optics.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    import xarray as xr
    from astropy.table import Table
    from matplotlib.figure import Figure

    from experiments.harness.summary import Criterion

__all__ = ["ExperimentRun", "run_experiment"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ExperimentRun:
    """A run of an experiment."""

    run: Run  # What the command would write: result, quantities, criteria and tables

    def __repr__(self) -> str:
        failed = [one.name for one in self.criteria if not one.passed]
        met = f"{len(self.criteria)} criteria met" if self.criteria else "no criteria"
        verdict = f"not met: {', '.join(failed)}" if failed else met
        return f"<{self.run.experiment.name}: tables {', '.join(self.run.tables)}; {verdict}>"

    @property
    def result(self) -> Any:
        """What the experiment computed, as its own records."""
        return self.run.outcome.result

    @property
    def data(self) -> xr.Dataset:
        """Every number of the report with its dimensions, label and unit, as ``results.nc`` holds it."""
        return self.run.outcome.data

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """The verdicts."""
        return tuple(self.run.criteria)

    def table(self, name: str) -> Table:
        """A table of the report by name, as an `astropy.table.Table`."""
        from experiments.harness.tables import to_astropy

        if name not in self.run.tables:
            raise unknown_name("table", name, self.run.tables)
        table = to_astropy(self.run.tables[name])
        for column in table.itercols():
            if column.dtype.kind == "f":
                column.info.format = ".4g"
        return table

    def draw(self, name: str, *arguments: Any) -> Figure:
        """A figure of the report by name."""
        from experiments.harness.plotting import house_style

        with house_style():
            figure: Figure = self.run.experiment.draw(self.run.outcome)(name, *arguments)
        return figure


def run_experiment(
    name: str | Experiment,
    settings: Mapping[str, Any] | None = None,
    *,
    sensor: str | Path | None = None,
    quick: bool = False,
    seed: int | None = None,
    out: str | Path | None = None,
    backend: Literal["auto", "llvm", "cuda"] = "auto",
) -> ExperimentRun:
    """Run an experiment as its command does.

    Parameters
    ----------
    name : str or Experiment
        One of ``python -m experiments --names``, or a declaration of your own.
    settings : mapping, optional
        Dotted keys and their values, what ``--set`` takes: ``{"frames": 10, "instrument.exposure_s": 0.2}``.
    sensor : path, optional
        Sensor file, what ``--sensor`` takes.
    quick : bool
        The small run.
    seed : int, optional
        Seed; the configuration's own if left out.
    out : path, optional
        Folder to write, report included; nothing is written if left out (a dataset needs one).
    backend : {"auto", "llvm", "cuda"}
        Where rendering runs; it is chosen once per process.

    Returns
    -------
    ExperimentRun
        Numbers, tables, figures, verdicts.

    Raises
    ------
    StarbenchError
        Whatever the command refuses in one line.
    """
    experiment: Experiment = name if isinstance(name, Experiment) else declared(name)
    if experiment.output is not None and out is None:
        raise ConfigError(f"the experiment {experiment.name!r} writes as it goes: name a folder, out=")
    options = Options(
        sensor=() if sensor is None else (str(sensor),),
        settings=tuple(f"{key}={_text(value)}" for key, value in (settings or {}).items()),
        seed=seed,
        backend=backend,
        out=None if out is None else str(out),
        quick=quick,
    )
    return ExperimentRun(run=perform(experiment, options, Progress())[0])


def _text(value: Any) -> str:
    """A value as ``--set`` takes it."""
    return str(value) if isinstance(value, str | Path) else json.dumps(value, ensure_ascii=False)
