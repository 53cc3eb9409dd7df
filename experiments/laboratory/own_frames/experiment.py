"""An experiment on frames from outside: no rendering, no truth.

It takes over from the rendered experiment when ``own_frames`` names a folder. The room reads the folder, centroids
every series and looks at what the frames say about themselves; the experiment adds how it asks for its frames, and its
reduction (`FramesTest`, in its module ``own_frames``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from experiments.harness.config import ExperimentConfig
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.laboratory.centroid_methods import needs_epsf
from optics.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from experiments.harness.quantities import Outcome, Quantities
    from experiments.harness.summary import Criterion
    from experiments.laboratory.own_frames.checks import FrameChecks
    from experiments.laboratory.own_frames.folder import FrameFolder
    from experiments.laboratory.own_frames.series import SeriesFrames
    from experiments.laboratory.own_frames.settings import Layout

__all__ = ["FramesResult", "FramesTest", "Reduced", "or_own_frames", "reduce_folder"]


class Reduced(Protocol):
    """What a reduction gives: the centroids of its series, beside its own numbers."""

    @property
    def series(self) -> tuple[SeriesFrames, ...]:
        """In the order of the folder."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class FramesTest:
    """What an experiment does with own frames."""

    title: str  # Of the report
    layout: Layout  # What it asks of a folder
    reduce: Callable[[FrameFolder, Sequence[str], Any], Reduced]  # ``reduce(folder, methods, config) -> Reduced``
    # ``describe(quantities, reduced, methods)`` adds the numbers of the reduction
    describe: Callable[[Quantities, Any, Sequence[str]], None]
    # ``headline(outcome)``: label -> number, for the head of the report
    headline: Callable[[Outcome], Mapping[str, Any]]
    tables: Callable[[Outcome], Mapping[str, Any]]  # ``tables(outcome)``: name -> table
    # Name -> (figure of an outcome, its caption)
    figures: Mapping[str, tuple[Callable[[Outcome], Figure], str]] = field(default_factory=dict)
    # ``criteria(outcome)``: what has to hold besides what holds for all frames
    criteria: Callable[[Outcome], list[Criterion]] = lambda _: []
    show: tuple[str, ...] = ()  # Tables that are printed in the terminal too
    series: str = "Series"  # What readers call a series


@dataclass(frozen=True, slots=True, kw_only=True)
class FramesResult:
    """What a folder gave."""

    test: FramesTest  # Which experiment
    methods: tuple[str, ...]  # Centroiders, the one that counts first
    folder: FrameFolder  # As read
    reduced: Reduced  # By experiment
    checks: FrameChecks  # What the frames say about themselves


def reduce_folder(test: FramesTest, config: Any, *, progress: Progress) -> FramesResult:
    """Read the folder of the configuration and reduce its frames."""
    from experiments.laboratory.own_frames.checks import check_frames
    from experiments.laboratory.own_frames.folder import read_folder

    if config.own_frames is None:
        raise ConfigError("own_frames is not given: the folder with the frames and frames.toml")
    with progress.stage("read"):
        folder = read_folder(config.own_frames, window_px=config.window_px, layout=test.layout)
    first = () if folder.settings.centroid is None else (folder.settings.centroid,)
    methods = tuple(dict.fromkeys(m for m in (*first, *getattr(config, "methods", ("gaussian",))) if not needs_epsf(m)))
    if not methods:
        raise ConfigError("frames from outside come without a PSF: name another centroid than epsf, e.g. gaussian")
    with progress.stage("reduce"):
        reduced = test.reduce(folder, methods, config)
    with progress.stage("check"):
        checks = check_frames(folder.series, reduced.series, methods[0])
    return FramesResult(test=test, methods=methods, folder=folder, reduced=reduced, checks=checks)


def or_own_frames(rendered: Experiment, own: str) -> Experiment:
    """An experiment on rendered frames that reduces those of a folder instead where ``own_frames`` is given."""

    def instead(config: Any) -> Experiment | None:
        if config.own_frames is None:
            return None
        test: FramesTest = import_module(own).own_frames
        return _experiment(rendered, test)

    return replace(
        rendered,
        examples={**rendered.examples, "--own-frames my_frames": "reduce the FITS frames of a laboratory"},
        options={
            **rendered.options,
            "own-frames": ("own_frames", "Reduce the FITS frames of a folder that holds frames.toml."),
        },
        instead=instead,
    )


def _experiment(rendered: Experiment, test: FramesTest) -> Experiment:
    def run(config: ExperimentConfig, *, progress: Progress) -> FramesResult:
        return reduce_folder(test, config, progress=progress)

    return Experiment(
        name=rendered.name,
        config=rendered.config,
        run=run,
        tables=test.tables,
        figures={name: draw for name, (draw, _) in test.figures.items()},
        report=Path(__file__).with_name("frames.md"),
        renders=lambda _: False,
        judged="reduction",
        show=test.show,
    )
