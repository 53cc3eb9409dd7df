"""End of a command: exit status, a one-line error, and no partial output after Ctrl-C."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from types import FrameType

import click

from optics.errors import StarbenchError

EXIT_GOOD, EXIT_FAILED, EXIT_BAD_INPUT, EXIT_BROKEN, EXIT_INTERRUPTED = 0, 1, 2, 3, 130
NOTHING_WRITTEN = "interrupted; nothing was written"


class _Interrupts:
    """Ctrl-C and SIGTERM of this process: they raise KeyboardInterrupt, or end a command that starts at once."""

    def __init__(self) -> None:
        self.came = False
        self.alone = False  # Whether the process is the command's own
        # An exception raised amid the import of a native library can crash it, or be swallowed: while that lasts, and
        # nothing has to be cleared away, a signal ends the process in its handler
        self.at_once = False
        self.said: Callable[[], str] = lambda: NOTHING_WRITTEN
        self._stderr = 2

    @contextlib.contextmanager
    def caught(self, *, alone: bool) -> Iterator[None]:
        """Take the signals over."""
        self.came, self.alone, self.at_once, self.said = False, alone, alone, lambda: NOTHING_WRITTEN
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {number: signal.signal(number, self._interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
        with contextlib.suppress(OSError):  # closed by the caller
            self._stderr = os.dup(2)  # the start of the renderer turns the error stream elsewhere
        try:
            yield
        finally:
            self.at_once = False
            for number, handler in before.items():
                signal.signal(number, handler)
            with contextlib.suppress(OSError):
                os.close(self._stderr)

    @contextlib.contextmanager
    def leaving(self) -> Iterator[None]:
        """A part that imports native libraries and leaves nothing to clear away."""
        self.at_once = self.alone
        yield
        self.at_once = False

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.came = True
        if self.at_once:
            with contextlib.suppress(OSError):  # nobody listens
                os.write(self._stderr, f"{self.said()}\n".encode())
            _leave()
        raise KeyboardInterrupt


interrupts = _Interrupts()
"""Those of this process, whose signals are one thing too."""


def invoke(command: click.Command, argv: Sequence[str] | None, *, prog: str, alone: bool) -> int:
    """Run a command and give its exit status.

    An interrupt in the middle of an import may appear as another error (an extension module that failed to load), so
    any error after one counts as the interrupt.
    """
    for stream in (sys.stdout, sys.stderr) if alone else ():
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="replace")  # signs that an encoding lacks, such as that of seconds of arc
    try:
        with interrupts.caught(alone=alone):
            status = int(command.main(argv, prog_name=prog, standalone_mode=False) or EXIT_GOOD)
        if alone:
            gc.freeze()  # the end of the process need not look for cycles among all modules, which takes half a second
        return status
    except (click.exceptions.Abort, KeyboardInterrupt):
        pass
    except Exception as error:
        if not interrupts.came:
            if not isinstance(error, (click.ClickException, StarbenchError)):
                traceback.print_exc()
                return EXIT_BROKEN
            said = error.format_message() if isinstance(error, click.ClickException) else str(error)
            print("error:", "; ".join(line.strip() for line in said.splitlines() if line.strip()), file=sys.stderr)
            return EXIT_BAD_INPUT
    print(interrupts.said(), file=sys.stderr)
    if alone:
        if "multiprocessing.util" in sys.modules:  # which tells the system that its semaphores are gone
            with contextlib.suppress(Exception):
                sys.modules["multiprocessing.util"]._exit_function()
        sys.stdout.flush()
        sys.stderr.flush()
        _leave()
    return EXIT_INTERRUPTED


def _leave() -> None:
    """End the process without Python's clean-up, which takes up to a second and may end in another exit status."""
    os._exit(EXIT_INTERRUPTED)
