"""Progress of long work: a bar on a terminal, silence elsewhere, and the time each stage took in both cases."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar

__all__ = ["Progress", "Stage", "terminal_progress"]

Item = TypeVar("Item")


class Stage(Protocol):
    """A running stage."""

    def advance(self, steps: int = 1) -> None:
        """Report ``steps`` more of the stage's total as done."""


class _SilentStage:
    def advance(self, steps: int = 1) -> None:
        """Nothing to show."""


class Progress:
    """Progress without a display; also the base of the one with bars.

    Attributes
    ----------
    times_s : dict
        Seconds spent in each stage, in order; stages of the same label add up.

    Examples
    --------
    >>> progress = Progress()
    >>> with progress.stage("render", total=3) as stage:
    ...     for _ in range(3):
    ...         stage.advance()
    >>> list(progress.times_s)
    ['render']
    """

    def __init__(self) -> None:
        self.times_s: dict[str, float] = {}

    @contextmanager
    def stage(self, label: str, total: int | None = None) -> Iterator[Stage]:
        """Run a stage.

        Parameters
        ----------
        label : str
            A few words, shown beside the bar and kept in `times_s`.
        total : int, optional
            Number of steps; None where it is not known.
        """
        start = time.perf_counter()
        try:
            with self._display(label, total) as stage:
                yield stage
        finally:
            self.times_s[label] = self.times_s.get(label, 0.0) + time.perf_counter() - start

    def track(self, items: Iterable[Item], label: str, total: int | None = None) -> Iterator[Item]:
        """Iterate over ``items`` as a stage of one step per item."""
        if total is None and isinstance(items, Sized):
            total = len(items)
        with self.stage(label, total) as stage:
            for item in items:
                yield item
                stage.advance()

    @contextmanager
    def _display(self, label: str, total: int | None) -> Iterator[Stage]:
        del label, total
        yield _SilentStage()


class _RichStage:
    def __init__(self, bars: Any, task: Any) -> None:
        self._bars = bars
        self._task = task

    def advance(self, steps: int = 1) -> None:
        self._bars.advance(self._task, steps)


class _RichProgress(Progress):
    def __init__(self) -> None:
        super().__init__()
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bars

        self._bars = Bars(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self._depth = 0

    @contextmanager
    def _display(self, label: str, total: int | None) -> Iterator[Stage]:
        if self._depth == 0:
            self._bars.start()
        self._depth += 1
        task = self._bars.add_task(label, total=total)
        try:
            yield _RichStage(self._bars, task)
        finally:
            self._bars.remove_task(task)
            self._depth -= 1
            if self._depth == 0:
                self._bars.stop()


def terminal_progress() -> Progress:
    """Progress bars on the standard error stream if that is a terminal, otherwise a silent `Progress`."""
    return _RichProgress() if sys.stderr is not None and sys.stderr.isatty() else Progress()
