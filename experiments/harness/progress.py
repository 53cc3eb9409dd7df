"""Progress of long work: bars on a terminal, occasional lines elsewhere; the time of each stage."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from typing import TextIO, TypeVar

Item = TypeVar("Item")
Show = Callable[[int], None]


class Stage:
    """A running stage."""

    def __init__(self, show: Show) -> None:
        self._show = show

    def advance(self, steps: int = 1) -> None:
        """Report ``steps`` more of the stage's total as done."""
        self._show(steps)


class Progress:
    """Progress without a display; also the base of those with one.

    Attributes
    ----------
    times_s : dict
        Seconds spent in each stage, in order; stages of the same label add up.
    say : callable or None
        Receives the text of `answer`.

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
        self.say: Callable[[str], None] | None = None

    @contextmanager
    def stage(self, label: str, total: int | None = None) -> Iterator[Stage]:
        """Run a stage."""
        start = time.perf_counter()
        try:
            with self._display(label, total) as show:
                yield Stage(show)
        finally:
            self.times_s[label] = self.times_s.get(label, 0.0) + time.perf_counter() - start

    def answer(self, words: str) -> None:
        """Report the result of a run before figures are drawn; a command prints it."""
        if self.say is not None:
            self.say(words)

    def note(self, words: str) -> None:
        """Message for the user, on a separate line of the standard error stream."""
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
    def _display(self, label: str, total: int | None) -> Iterator[Show]:
        del label, total
        yield lambda steps: None


class _BarProgress(Progress):
    def __init__(self) -> None:
        super().__init__()
        from rich.console import Console
        from rich.progress import MofNCompleteColumn, TimeElapsedColumn
        from rich.progress import Progress as Bars

        columns = (*Bars.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn())
        self._bars = Bars(*columns, console=Console(stderr=True), transient=True)

    def note(self, words: str) -> None:
        """Above the bars."""
        self._bars.console.print(words, highlight=False, markup=False, soft_wrap=True)

    @contextmanager
    def _display(self, label: str, total: int | None) -> Iterator[Show]:
        self._bars.start()
        task = self._bars.add_task(label, total=total)
        try:
            yield lambda steps: self._bars.advance(task, steps)
        finally:
            self._bars.remove_task(task)
            if not self._bars.tasks:
                self._bars.stop()


class LineProgress(Progress):
    """Plain lines, for a pipe or a log file: none in the first two seconds, then one in thirty seconds at most."""

    FIRST_S = 2.0
    EVERY_S = 30.0

    def __init__(self, stream: TextIO, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._stream, self._clock, self._start = stream, clock, clock()
        self._next = self._start + self.FIRST_S

    def _print(self, words: str) -> None:
        now = self._clock()
        if now >= self._next:
            print(f"[{now - self._start:.0f} s] {words}", file=self._stream, flush=True)
            self._next = now + self.EVERY_S

    @contextmanager
    def _display(self, label: str, total: int | None) -> Iterator[Show]:
        begun, done = self._clock(), 0

        def show(steps: int) -> None:
            nonlocal done
            done += steps
            remaining_s = (total - done) * (self._clock() - begun) / done if total and done else 0.0
            steps_of = f"{done}" if total is None else f"{done} of {total}"
            self._print(f"{label}: {steps_of}" + (f", {remaining_s:.0f} s left" if remaining_s > 0 else ""))

        self._print(label)
        yield show


def terminal_progress() -> Progress:
    """Progress on the standard error stream: bars if that is a terminal, otherwise lines.

    Silent without the stream; no lines with ``STARBENCH_PROGRESS=none`` in the environment.
    """
    if sys.stderr is not None and sys.stderr.isatty():
        return _BarProgress()
    silent = sys.stderr is None or os.environ.get("STARBENCH_PROGRESS") == "none"
    return Progress() if silent else LineProgress(sys.stderr)
