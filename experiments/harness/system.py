"""Process resources: processors, threads of linear algebra, locks, deferred signals."""

from __future__ import annotations

import contextlib
import fcntl
import gc
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")

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


def prompt_import(name: str) -> ModuleType:
    """A module, imported without searches for cycles among what it brings, which take a third of the time."""
    searching = gc.isenabled()
    gc.disable()
    try:
        return import_module(name)
    finally:
        if searching:
            gc.enable()


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


_HERE = os.getpid()  # Another number in a copy of the process


@contextlib.contextmanager
def aside(work: Callable[[], Result], *, niceness: int = 0) -> Iterator[Callable[[], Result]]:
    """Work done meanwhile by a copy of this process: NumPy alone, nothing that renders, writes or shows progress.

    Gives a function that waits for the result. Without a copy (a single processor, another system than Linux), or when
    it fails, that function does the work.
    """
    if sys.platform != "linux" or processors() < 2 or os.getpid() != _HERE:
        yield work
        return
    source, sink = os.pipe()
    with signals_held(signal.SIGINT, signal.SIGTERM), warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of locks that threads hold: NumPy knows of none
        child = os.fork()
        if not child:
            _work_and_leave(work, sink, niceness)
    os.close(sink)

    def result() -> Result:
        with open(source, "rb", closefd=False) as stream:
            told = stream.read()
        if not told:
            return work()
        found: Result = pickle.loads(told)
        return found

    try:
        yield result
    finally:
        os.close(source)
        with contextlib.suppress(OSError):  # gone, and nobody's child any more where the caller ignores SIGCHLD
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def _work_and_leave(work: Callable[[], object], sink: int, niceness: int) -> None:
    """All that a copy does; it ends without clearing up what belongs to the other process."""
    try:
        os.nice(niceness)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))
        with open(sink, "wb") as stream:
            stream.write(pickle.dumps(work()))
    finally:
        os._exit(0)


def shared(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    advance: Callable[[Task], None] = lambda task: None,
    *,
    workers: int = 0,
) -> list[Result]:
    """Results of tasks in order, each done by the next free process (0: one per processor); work as of `aside`.

    Tasks advance when they, or later ones, are done by this process, the others at the end.
    """
    source, sink = os.pipe()
    for number in range(len(tasks)):
        os.write(sink, number.to_bytes(2))
    os.close(sink)
    told = 0

    def some() -> dict[int, Result]:
        nonlocal told
        done = {}
        while taken := os.read(source, 2):
            number = int.from_bytes(taken)
            done[number] = work(tasks[number])
            if os.getpid() == _HERE:
                for task in tasks[told : number + 1]:
                    advance(task)
                told = number + 1
        return done

    with contextlib.ExitStack() as stack:
        stack.callback(os.close, source)
        others = [stack.enter_context(aside(some)) for _ in range(min(workers or processors(), len(tasks)) - 1)]
        done = some()
        for other in others:
            done |= other()
        for task in tasks[told:]:
            advance(task)
        return [done[number] if number in done else work(task) for number, task in enumerate(tasks)]


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
