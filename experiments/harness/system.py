"""What depends on the operating system: locks, memory, processors, and which signs a terminal can print."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

__all__ = ["lock_folder", "own_peak_memory_mb", "print_anything", "processors", "signals_held", "sync"]


def lock_folder(path: Path) -> int:
    """Take the only right to write in a folder; the system lets go of it when the process ends, however it ends.

    Windows cannot open folders: there a file in the temporary folder, named after the folder's path, stands for it, and
    keeps off processes of the same machine only.
    """
    try:
        import fcntl
    except ImportError:
        return _lock_file_of(path, import_module("msvcrt"))
    handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise
    except OSError:  # a file system without locks
        pass
    return handle


def _lock_file_of(path: Path, msvcrt: Any) -> int:
    name = hashlib.sha256(os.path.normcase(os.path.realpath(path)).encode()).hexdigest()[:32]
    handle = os.open(Path(tempfile.gettempdir()) / f"starbench-{name}.lock", os.O_RDWR | os.O_CREAT)
    try:
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    except OSError as error:
        os.close(handle)
        raise BlockingIOError(error.errno, "locked by another process", str(path)) from None
    return handle


def own_peak_memory_mb() -> float:
    """Largest resident memory of this process so far [MB = 10^6 bytes]."""
    try:
        import resource
    except ImportError:  # Windows
        return float(import_module("psutil").Process().memory_info().peak_wset / 1e6)
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return largest * (1.0 if sys.platform == "darwin" else 1024.0) / 1e6


def processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def signals_held(*numbers: int) -> Iterator[None]:
    """Hold back signals meanwhile, where the system can (not Windows) and in the main thread, which receives them."""
    if not hasattr(signal, "pthread_sigmask") or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def sync(path: Path) -> None:
    """Bring a file or folder onto its disk; folders not on Windows, which cannot open them and needs no such step."""
    windows = sys.platform == "win32"
    if windows and path.is_dir():
        return
    handle = os.open(path, os.O_RDWR if windows else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def print_anything() -> None:
    """Let the standard streams take any sign: what an encoding lacks (seconds of arc in cp1252) becomes a mark."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="replace")
