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
def one_thread(*, unless_set: bool = False) -> Iterator[None]:
    """Linear algebra on one thread, in libraries that are or will be loaded and in child processes.

    The matrices here are small. OpenBLAS splits even them between threads of all processors, and idle threads spin:
    parallel processes then wait for each other's threads (``benchmarks/side_by_side.py``). ``unless_set``: not if the
    environment sets a number of threads.
    """
    earlier = {name: os.environ.get(name) for name in THREADS}
    if unless_set and any(earlier.values()):
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
        os.environ.update({name: value for name, value in earlier.items() if value is not None})


def prompt_import(name: str) -> ModuleType:
    """A module, imported without garbage collection, which takes a third of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        return import_module(name)
    finally:
        if enabled:
            gc.enable()


@contextlib.contextmanager
def prompt_pool(threads: int | None = None) -> Iterator[ThreadPoolExecutor]:
    """Threads (default: one per processor) for work that writes nothing, which is abandoned after an exception."""
    pool = ThreadPoolExecutor(threads or processors())
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


_PARENT = os.getpid()  # Differs from the number of a forked process


@contextlib.contextmanager
def forked(work: Callable[[], Result], *, niceness: int = 0) -> Iterator[Callable[[], Result]]:
    """Work in a forked process: NumPy alone, nothing that renders, writes or shows progress.

    Gives a function that waits for the result. Without a fork (a single processor, another system than Linux), or if
    it fails, that function does the work.
    """
    if sys.platform != "linux" or processors() < 2 or os.getpid() != _PARENT:
        yield work
        return
    source, sink = os.pipe()
    with signals_held(signal.SIGINT, signal.SIGTERM), warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of locks of other threads, which NumPy does not take
        child = os.fork()
        if not child:
            _work_and_exit(work, sink, niceness)
    os.close(sink)

    def result() -> Result:
        with open(source, "rb", closefd=False) as stream:
            pickled = stream.read()
        if not pickled:
            return work()
        returned: Result = pickle.loads(pickled)
        return returned

    try:
        yield result
    finally:
        os.close(source)
        with contextlib.suppress(OSError):  # already reaped if the caller ignores SIGCHLD
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def _work_and_exit(work: Callable[[], object], sink: int, niceness: int) -> None:
    """The life of a forked process; it exits without cleaning up what belongs to its parent."""
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
    """Results of tasks in order, each by the next free process (0: one per processor); work as of `forked`.

    A task advances when this process has done it or a later one, the others at the end.
    """
    source, sink = os.pipe()
    for number in range(len(tasks)):
        os.write(sink, number.to_bytes(2))
    os.close(sink)
    advanced = 0

    def some() -> dict[int, Result]:
        nonlocal advanced
        done = {}
        while taken := os.read(source, 2):
            number = int.from_bytes(taken)
            done[number] = work(tasks[number])
            if os.getpid() == _PARENT:
                for task in tasks[advanced : number + 1]:
                    advance(task)
                advanced = number + 1
        return done

    with contextlib.ExitStack() as stack:
        stack.callback(os.close, source)
        others = [stack.enter_context(forked(some)) for _ in range(min(workers or processors(), len(tasks)) - 1)]
        done = some()
        for other in others:
            done |= other()
        for task in tasks[advanced:]:
            advance(task)
        return [done[number] if number in done else work(task) for number, task in enumerate(tasks)]


def lock_folder(path: Path) -> int:
    """Lock a folder for writing; the system releases the lock when the process ends, however it ends."""
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
    """Defer signals; without effect outside the main thread, which receives them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
