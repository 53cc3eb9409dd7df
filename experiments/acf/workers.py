"""Monte-Carlo work on several processes; what comes out does not depend on how many there are.

Every task is a function of its argument alone (random streams are named, not shared), workers use one thread for linear
algebra, and results come back in the order of the tasks. An interrupt ends the workers and is passed on.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from optics.errors import BackendError

__all__ = ["run_tasks"]

Task = TypeVar("Task")
Done = TypeVar("Done")

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def run_tasks(
    work: Callable[[Task], Done], tasks: Sequence[Task], *, workers: int, done: Callable[[int], None]
) -> list[Done]:
    """Results of all tasks, in their order.

    Parameters
    ----------
    work : callable
        A function of a module, of one argument.
    tasks : sequence
        Its arguments; all are pickled.
    workers : int
        Processes; 0 for one per processor that this process may use.
    done : callable
        Called with the index of a task when its result is in, in the order of the tasks.

    Raises
    ------
    BackendError
        When a worker vanished (killed, out of memory).
    """
    count = min(workers or _processors(), len(tasks))
    if not tasks:
        return []
    others = multiprocessing.active_children()
    with _single_threaded():
        pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"), initializer=_prepare)
        try:
            with _interrupts_held():  # children inherit this: an interrupt at the terminal is ours to handle
                futures = [pool.submit(work, task) for task in tasks]
            return [_wait(future, index, done) for index, future in enumerate(futures)]
        except BrokenProcessPool:
            raise BackendError(
                "a Monte-Carlo process vanished (killed, or out of memory); set workers=1 or lower sky.stars_per_frame"
            ) from None
        except BaseException:
            _stop(pool, others)
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _wait(future: Future[Done], index: int, done: Callable[[int], None]) -> Done:
    result = future.result()
    done(index)
    return result


def _stop(pool: ProcessPoolExecutor, others: Sequence[object]) -> None:
    """End the workers now; what they were at is of no use any more. Processes of others are left alone."""
    pool.shutdown(wait=False, cancel_futures=True)
    ours = [child for child in multiprocessing.active_children() if child not in others]
    for child in ours:
        child.terminate()
    deadline = time.monotonic() + 5.0
    for child in ours:
        child.join(timeout=5.0)
        while child.exitcode is None and time.monotonic() < deadline:  # the pool's own thread is just taking it in
            time.sleep(0.001)


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def _single_threaded() -> Iterator[None]:
    """Let processes that start meanwhile use one thread each: quicker side by side, and the same sums everywhere."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _prepare() -> None:
    """First thing in a worker: interrupts are the parent's business, and without a parent there is nothing to do."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_leave_with, args=(parent,), daemon=True).start()


def _leave_with(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)
