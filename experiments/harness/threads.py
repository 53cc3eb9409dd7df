"""One thread for linear algebra, and threads that an interrupt does not wait for.

The matrices here are small. OpenBLAS hands even them to as many threads as there are processors, whose idle ones spin:
two processes side by side then wait for each other's threads most of the time (``benchmarks/side_by_side.py``).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from experiments.harness.system import processors

__all__ = ["THREADS", "one_thread", "prompt_pool"]

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Environment variables that libraries of linear algebra read when they are loaded."""


@contextlib.contextmanager
def one_thread(*, unless_told: bool = False) -> Iterator[None]:
    """Linear algebra on one thread meanwhile, in libraries that are loaded, that will be, and in processes that start."""
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
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def prompt_pool(threads: int | None = None) -> Iterator[ThreadPoolExecutor]:
    """Threads (one per processor if left out) for work that writes nothing: after an exception nobody waits for it."""
    pool = ThreadPoolExecutor(threads or processors())
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
