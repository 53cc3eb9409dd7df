"""Worker processes on this machine: a Dask cluster that an interrupt does not wait for."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from multiprocessing import resource_tracker
from typing import Any

from experiments.harness.system import THREADS, signals_held

__all__ = ["DEATHS", "hush", "local_cluster"]

DEATHS = 3
"""Workers that a frame may cost before it is given up."""
START_S, CLOSE_S = 120.0, 5.0
KILL_S = 0.4
"""For the end of a cluster whose processes are killed: what is left of it then dies with this process."""
LOOK_S = 0.02
_MEMORY = {"MALLOC_TRIM_THRESHOLD_": str(1 << 30), "MALLOC_MMAP_THRESHOLD_": str(1 << 25)}
"""Images are allocated and freed all the time: what a worker got from the system it keeps."""


@contextlib.contextmanager
def local_cluster(dask: Any, distributed: Any, count: int) -> Iterator[Any]:
    """A client of so many worker processes of this machine; they end with it.

    The cluster starts beside the main thread, which takes interrupts meanwhile. After one (or any other exception) the
    processes are killed, whatever they are at: they may have been starting, or amid a frame.
    """
    settings = {
        "distributed.scheduler.allowed-failures": DEATHS,
        "distributed.scheduler.active-memory-manager.start": False,
        "distributed.worker.daemon": True,
        "distributed.worker.profile.enabled": False,  # it would look at every worker a hundred times a second
        "distributed.nanny.pre-spawn-environ": {**dict.fromkeys(THREADS, "1"), **_MEMORY},
    }
    others = set(multiprocessing.active_children())
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask.config.set(settings))
        scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="starbench-", ignore_cleanup_errors=True))
        made: list[Any] = []
        failed: list[BaseException] = []
        started = threading.Event()  # to join a thread would do, but Python 3.11 forgets it when that is interrupted

        def start() -> None:
            try:
                cluster = distributed.LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address=None,
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # its page is at a port that nobody has
                    memory_limit=0,
                    local_directory=scratch,
                    silence_logs=logging.CRITICAL,
                )
                made.extend((cluster, distributed.Client(cluster, set_as_default=False)))
            except BaseException as error:
                failed.append(error)
            finally:
                started.set()

        try:
            resource_tracker.ensure_running()  # lets interrupts through again for the thread that it starts from
            with signals_held(signal.SIGINT):  # threads and processes that start inherit it: an interrupt is ours
                threading.Thread(target=start, daemon=True, name="start of the workers").start()
            until = time.monotonic() + START_S
            while not started.wait(LOOK_S):
                if time.monotonic() > until:
                    raise TimeoutError(f"they are not up after {START_S:g} s")
            if failed:
                raise failed[0]
            yield made[1]
        except BaseException:
            _kill(made, started, others)
            raise
        made[1].close()
        made[0].close(timeout=CLOSE_S)


def hush() -> None:
    """Keep Dask from logging what goes wrong: it is said in one line."""
    for name in [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)


def _kill(made: list[Any], started: threading.Event, others: set[Any]) -> None:
    """End the processes, also those that start meanwhile, then what is left of the cluster."""
    hush()

    def close() -> None:
        started.wait()
        with contextlib.suppress(Exception):
            made[1].close(timeout=0)
        with contextlib.suppress(Exception):
            made[0].close(timeout=CLOSE_S)

    for cluster in made[:1]:
        for nanny in cluster.workers.values():
            cluster.loop.add_callback(nanny.close_gracefully)  # it makes no new process
    closing = threading.Thread(target=close, daemon=True, name="end of the workers")
    closing.start()
    until = time.monotonic() + KILL_S
    while closing.is_alive() and time.monotonic() < until:
        for child in set(multiprocessing.active_children()) - others:
            child.kill()
        closing.join(LOOK_S)
