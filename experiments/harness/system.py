"""Process resources: processors, threads of linear algebra, locks, deferred signals."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Environment variables that libraries of linear algebra read when they are loaded."""


def processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def one_thread(*, unless_told: bool = False) -> Iterator[None]:
    """Linear algebra on one thread meanwhile, in libraries that are loaded, that will be, and in processes that start.

    The matrices here are small. OpenBLAS hands even them to as many threads as there are processors, whose idle ones
    spin: two processes side by side then wait for each other's threads (``benchmarks/side_by_side.py``).
    """
    before = {name: os.environ.get(name) for name in THREADS}
    if unless_told and any(before.values()):
        yield
        return
    from threadpoolctl import threadpool_limits

    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        for name in THREADS:
            os.environ.pop(name, None)
        os.environ.update({name: value for name, value in before.items() if value is not None})


@contextlib.contextmanager
def prompt_pool(threads: int | None = None) -> Iterator[ThreadPoolExecutor]:
    """Threads (one per processor if left out) for work that writes nothing: it is not waited for after an exception."""
    pool = ThreadPoolExecutor(threads or processors())
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def lock_folder(path: Path) -> int:
    """Take the only right to write in a folder; the system lets go of it when the process ends, however it ends."""
    handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise
    except OSError:  # a file system without locks
        pass
    return handle


@contextlib.contextmanager
def signals_held(*numbers: int) -> Iterator[None]:
    """Hold back signals meanwhile; without effect outside the main thread, which receives them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
