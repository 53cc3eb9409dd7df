"""Ctrl-C and polite kills: unwind, so that nothing half-written stays, or leave at once while nothing can be."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import FrameType

import click

from experiments.harness.outputs import OutputFolder
from optics.errors import StarbenchError

__all__ = [
    "EXIT_BAD_INPUT",
    "EXIT_BROKEN",
    "EXIT_FAILED",
    "EXIT_GOOD",
    "EXIT_INTERRUPTED",
    "Interrupts",
    "guarded",
    "leave",
]

EXIT_GOOD, EXIT_FAILED, EXIT_BAD_INPUT, EXIT_BROKEN, EXIT_INTERRUPTED = 0, 1, 2, 3, 130


@dataclass(slots=True)
class Interrupts:
    """Ctrl-C and a polite kill: unwind, so that nothing half-written stays, or leave at once while nothing can be."""

    asked: list[int] = field(default_factory=list)  # Signals that came
    # Whether a signal ends the process in its handler. True while a command starts: an exception raised amid the
    # import of a native library can crash it, or be swallowed
    at_once: bool = False
    # Descriptor of the error stream from before anybody turned it elsewhere, as the start of the renderer does
    stderr: int = -1
    said: Callable[[], str] = lambda: OutputFolder.interrupted  # What to say

    @contextlib.contextmanager
    def caught(self) -> Iterator[None]:
        """Take the signals over."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        with contextlib.suppress(OSError):  # closed by the caller
            self.stderr = os.dup(2)
        before = {number: signal.signal(number, self._interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            with contextlib.suppress(OSError):
                os.close(self.stderr)

    @contextlib.contextmanager
    def unwinding(self) -> Iterator[None]:
        """A part that has something to clear away."""
        before, self.at_once = self.at_once, False
        try:
            yield
        finally:
            self.at_once = before

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        del frame
        self.asked.append(number)
        if self.at_once:
            with contextlib.suppress(OSError):  # nobody listens
                os.write(self.stderr, f"{self.said()}\n".encode())
            _leave_at_once(EXIT_INTERRUPTED)
        raise KeyboardInterrupt


def guarded(work: Callable[[], None], interrupts: Interrupts) -> int:
    """Exit code of ``work``; what the user can mend becomes one line.

    An interrupt in the middle of an import may come out as another error (an extension module that failed to load), so
    any error after one was ``asked`` for counts as the interrupt.
    """
    try:
        work()
    except (click.exceptions.Abort, KeyboardInterrupt):
        return _say(interrupts.said(), EXIT_INTERRUPTED)
    except Exception as error:
        if interrupts.asked:
            return _say(interrupts.said(), EXIT_INTERRUPTED)
        if isinstance(error, click.ClickException):
            return _say(error.format_message(), EXIT_BAD_INPUT)
        if isinstance(error, StarbenchError):
            return _say(str(error), EXIT_BAD_INPUT)
        traceback.print_exc()
        return EXIT_BROKEN
    return EXIT_GOOD


def leave(status: int) -> None:
    """End an interrupted command with our exit code, whatever Python makes of an interrupt on its way out.

    Python's own clean-up of a process with a renderer and its kernels takes up to a second; of it only that of
    multiprocessing matters, which tells the system that its semaphores are gone.
    """
    if "multiprocessing.util" in sys.modules:
        with contextlib.suppress(Exception):
            sys.modules["multiprocessing.util"]._exit_function()
    _leave_at_once(status)


def _leave_at_once(status: int) -> None:
    """End the process of an interrupted command without Python's clean-up; everything of ours is unwound by now.

    The clean-up could end in another exit code: Python dies by the signal if the interrupt passed through an ``exec``
    of a string (as in the making of a dataclass), and native libraries caught amid their import may crash.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def _say(sentence: str, status: int) -> int:
    line = "; ".join(part.strip() for part in sentence.splitlines() if part.strip())
    print(f"error: {line}" if status == EXIT_BAD_INPUT else line, file=sys.stderr)
    return status
