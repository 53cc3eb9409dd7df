"""Progress of long work: bars on a terminal, now and then a line elsewhere, and the time each stage took."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from typing import Any, Protocol, TextIO, TypeVar

__all__ = ["LineProgress", "Progress", "Stage", "terminal_progress"]

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
        """Run a stage."""
        start = time.perf_counter()
        try:
            with self._display(label, total) as stage:
                yield stage
        finally:
            self.times_s[label] = self.times_s.get(label, 0.0) + time.perf_counter() - start

    def note(self, words: str) -> None:
        """Say something that the user has to know, on a line of its own on the standard error stream."""
        if sys.stderr is not None:
            print(words, file=sys.stderr, flush=True)

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
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            ProgressColumn,
            SpinnerColumn,
            Text,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )
        from rich.progress import Progress as Bars

        class Rate(ProgressColumn):
            def render(self, task: Any) -> Text:
                speed = task.finished_speed or task.speed
                return Text("" if speed is None else f"{speed:.3g}/s")

        self._bars = Bars(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            Rate(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self._depth = 0

    def note(self, words: str) -> None:
        """Above the bars."""
        self._bars.console.print(words, highlight=False, markup=False, soft_wrap=True)

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


class _LineStage:
    def __init__(self, progress: LineProgress, label: str, total: int | None) -> None:
        self._progress, self._label, self._total, self._done = progress, label, total, 0
        self._begun = progress.clock()

    def advance(self, steps: int = 1) -> None:
        self._done += steps
        of = f" of {self._total}" if self._total is not None else ""
        took = self._progress.clock() - self._begun
        rate = f", {self._done / took:.3g}/s" if took > 0 else ""
        left = (self._total - self._done) * took / self._done if self._total and self._done else 0.0
        self._progress.say(f"{self._label}: {self._done}{of}{rate}" + (f", {left:.0f} s left" if left > 0 else ""))


class LineProgress(Progress):
    """Plain lines, for a pipe or a log file: none from a run of two seconds, then one in thirty seconds at most."""

    FIRST_S = 2.0
    EVERY_S = 30.0

    def __init__(self, stream: TextIO, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._stream, self.clock = stream, clock
        self._start = clock()
        self._next = self._start + self.FIRST_S

    def say(self, words: str) -> None:
        """Write a line if it is time for one."""
        now = self.clock()
        if now >= self._next:
            print(f"[{now - self._start:.0f} s] {words}", file=self._stream, flush=True)
            self._next = now + self.EVERY_S

    @contextmanager
    def _display(self, label: str, total: int | None) -> Iterator[Stage]:
        self.say(label)
        yield _LineStage(self, label, total)


def terminal_progress() -> Progress:
    """Progress on the standard error stream: bars if that is a terminal, otherwise lines.

    Silent without the stream; no lines where the environment says ``STARBENCH_PROGRESS=none``.
    """
    if sys.stderr is None or (not sys.stderr.isatty() and os.environ.get("STARBENCH_PROGRESS") == "none"):
        return Progress()
    return _RichProgress() if sys.stderr.isatty() else LineProgress(sys.stderr)
