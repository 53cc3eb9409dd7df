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
        self.received = False
        self.own_process = False  # Whether the process ends with the command
        # An exception raised during the import of a native library can crash it or be swallowed: during imports, as
        # long as there is nothing to clean up, a signal ends the process in its handler
        self.at_once = False
        self.message: Callable[[], str] = lambda: NOTHING_WRITTEN
        self._stderr = 2

    @contextlib.contextmanager
    def caught(self, *, own_process: bool) -> Iterator[None]:
        """Take the signals over."""
        self.received, self.own_process, self.at_once, self.message = (
            False,
            own_process,
            own_process,
            lambda: NOTHING_WRITTEN,
        )
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        handlers = {number: signal.signal(number, self._interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
        with contextlib.suppress(OSError):  # closed by the caller
            self._stderr = os.dup(2)  # the start of the renderer redirects the error stream
        try:
            yield
        finally:
            self.at_once = False
            for number, handler in handlers.items():
                signal.signal(number, handler)
            with contextlib.suppress(OSError):
                os.close(self._stderr)

    @contextlib.contextmanager
    def leaving(self) -> Iterator[None]:
        """A part that imports native libraries and leaves nothing to clean up."""
        self.at_once = self.own_process
        yield
        self.at_once = False

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.received = True
        if self.at_once:
            with contextlib.suppress(OSError):  # the stream is closed
                os.write(self._stderr, f"{self.message()}\n".encode())
            _leave()
        raise KeyboardInterrupt


interrupts = _Interrupts()
"""Interrupts of this process."""


def invoke(command: click.Command, argv: Sequence[str] | None, *, prog: str, own_process: bool) -> int:
    """Run a command and give its exit status.

    An interrupt in the middle of an import may appear as another error (an extension module that failed to load), so
    any error after one counts as the interrupt.
    """
    for stream in (sys.stdout, sys.stderr) if own_process else ():
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="replace")  # characters that an encoding lacks, such as that of seconds of arc
    try:
        with interrupts.caught(own_process=own_process):
            status = int(command.main(argv, prog_name=prog, standalone_mode=False) or EXIT_GOOD)
        if own_process:
            gc.freeze()  # at its end the process does not search all modules for cycles, which takes half a second
        return status
    except (click.exceptions.Abort, KeyboardInterrupt):
        pass
    except Exception as error:
        if not interrupts.received:
            if not isinstance(error, (click.ClickException, StarbenchError)):
                traceback.print_exc()
                return EXIT_BROKEN
            text = error.format_message() if isinstance(error, click.ClickException) else str(error)
            print("error:", "; ".join(line.strip() for line in text.splitlines() if line.strip()), file=sys.stderr)
            return EXIT_BAD_INPUT
    print(interrupts.message(), file=sys.stderr)
    if own_process:
        if "multiprocessing.util" in sys.modules:  # it removes the semaphores from the system
            with contextlib.suppress(Exception):
                sys.modules["multiprocessing.util"]._exit_function()
        sys.stdout.flush()
        sys.stderr.flush()
        _leave()
    return EXIT_INTERRUPTED


def _leave() -> None:
    """End the process without Python's clean-up, which takes up to a second and may end in another exit status."""
    os._exit(EXIT_INTERRUPTED)
