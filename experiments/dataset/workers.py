"""Workers of a dataset: this process, several processes, or a Dask cluster; the frames do not depend on the choice."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import multiprocessing
import secrets
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import replace
from itertools import islice
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from experiments.dataset.folder import software
from experiments.dataset.job import Job, check_worker, make_frame
from experiments.dataset.remote import Store
from experiments.dataset.truth import FrameRecord
from experiments.harness.provenance import count_memory_of_workers, peak_memory_mb
from experiments.harness.system import THREADS, processors, signals_held
from optics.errors import BackendError, ConfigError, StarbenchError

Done = Callable[[Sequence[FrameRecord]], None]

AHEAD = 3
"""Batches per worker that are submitted before the first result."""
LARGEST_BATCH = 8
"""Frames per task: each task costs the scheduler some milliseconds."""
FEW_FRAMES = 8
"""Starting workers takes longer than rendering this number of frames."""
DEATHS = 3
"""Workers that may die over a frame before the run ends."""
MONITOR_S, POLL_S = 1.0, 0.003
ALONE_S, GIVE_UP_S = 10.0, 300.0
CONNECT_S, START_S, CLOSE_S = 5.0, 120.0, 5.0
KILL_S = 0.4
"""Longest wait for the end of a cluster whose processes are killed; the rest ends with this process."""
CONTINUE = "finished frames are kept; run the same command again to continue"


def make_frames(job: Job, frames: Sequence[int], *, workers: int, scheduler: str, done: Done) -> int:
    """Render frames and report each one to ``done``. Returns the number of processes."""
    if not frames:
        return 0
    if scheduler:
        return _on_cluster(job, frames, scheduler, done)
    count = min(workers or (1 if len(frames) <= FEW_FRAMES else processors()), len(frames))
    if count > 1:
        return _on_processes(job, frames, count, done)
    for frame in frames:
        done([make_frame(job, frame)])
    return 1


def make_batch(job: Job, frames: Sequence[int], threads: int | None) -> list[FrameRecord] | StarbenchError:
    """Render frames in a worker.

    Returns their records, or the error of a caller: Dask drops the class of an exception whose traceback is too large.
    """
    try:
        return [make_frame(job, frame, threads) for frame in frames]
    except StarbenchError as error:
        return type(error)(str(error))


def _on_processes(job: Job, frames: Sequence[int], count: int, done: Done) -> int:
    with contextlib.ExitStack() as stack:
        try:
            client = stack.enter_context(local_cluster(count))
        except (OSError, RuntimeError, TimeoutError) as error:
            raise BackendError(f"{count} workers cannot be started ({_reason(error)}); set workers = 1") from None
        monitor = _Monitor(client, "the scheduler on this machine")
        _gather(client, job, frames, monitor=monitor, threads=max(1, processors() // count), done=done)
        with contextlib.suppress(OSError, TimeoutError, RuntimeError):
            count_memory_of_workers(client.run(peak_memory_mb).values())
    return count


def _on_cluster(job: Job, frames: Sequence[int], address: str, done: Done) -> int:
    if not address.startswith(("tcp://", "tls://", "ws://", "wss://", "ucx://")):
        raise ConfigError(f"scheduler = {address!r}; an address such as tcp://host:8786 is needed")
    import dask
    import distributed

    _hush()
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask.config.set({"distributed.comm.timeouts.connect": f"{CONNECT_S:g}s"}))
        try:
            asyncio.run(_greet(address))
            client = stack.enter_context(
                distributed.Client(address, timeout=f"{CONNECT_S:g}s", set_as_default=False, name="starbench")
            )
        except TypeError:  # of Dask, for a missing certificate
            raise ConfigError(
                f"scheduler {address}: Dask has no certificates; name them in its configuration "
                "(distributed.comm.tls.ca-file, client.cert and client.key, see docs/dataset.md)"
            ) from None
        except (OSError, TimeoutError, ValueError, RuntimeError) as error:
            raise ConfigError(
                f"scheduler {address} does not answer within {CONNECT_S:g} s ({_reason(error)}); start one with "
                "'dask scheduler', or leave scheduler out to use this machine"
            ) from None
        job = stack.enter_context(_with_token(job))
        _check_cluster(client, job, address)
        monitor = _Monitor(client, f"scheduler {address}")
        _gather(client, job, frames, monitor=monitor, threads=None, done=done)
    return monitor.most_workers


async def _greet(address: str) -> None:
    """Connect to the scheduler once: a client would wait forever at the port of another service."""
    import distributed

    arguments = distributed.Security().get_connection_args("client")
    comm = await asyncio.wait_for(distributed.comm.connect(address, timeout=CONNECT_S, **arguments), CONNECT_S)
    comm.abort()


@contextlib.contextmanager
def _with_token(job: Job) -> Iterator[Job]:
    """The job for workers on other machines, with a file at the destination by which each is checked at its start."""
    token = f".token-{secrets.token_hex(8)}.partial"
    path = Path(job.folder) / token
    Store(job.url).write(token, b"") if job.url else path.touch()
    try:
        yield replace(job, token=token, software=json.dumps(software(job.backend)))
    finally:
        if job.url:
            with contextlib.suppress(ConfigError):
                Store(job.url).remove(token)
        else:
            path.unlink(missing_ok=True)


def _check_cluster(client: Any, job: Job, address: str) -> None:
    """Refuse a cluster without workers, or whose workers do not see the destination, or have other software."""
    try:
        client.submit(int, pure=False).result(timeout=ALONE_S)  # an adaptive cluster starts its first worker
    except TimeoutError:
        raise ConfigError(
            f"scheduler {address} has no workers, and started none within {ALONE_S:g} s; start some with "
            f"'dask worker {address}'"
        ) from None
    try:
        client.submit(check_worker, job, pure=False).result()
    except ConfigError as error:
        raise ConfigError(f"scheduler {address}: {error}") from None
    except Exception as error:  # any obstacle to running the function in a worker
        raise ConfigError(
            f"scheduler {address}: its workers cannot run starbench ({_reason(error)}); install the same version there"
        ) from None


class _Monitor:
    """Number of threads of a cluster, and whether it responds.

    Workers may come and go (adaptive scaling); without any for `ALONE_S` seconds a note is printed, after `GIVE_UP_S`
    the run ends.
    """

    def __init__(self, client: Any, name: str) -> None:
        self._client, self._name = client, name
        self.slots, self.most_workers = 1, 0
        self._next = self._last_seen = time.monotonic()
        self._noted = False
        self.update()

    def update(self) -> None:
        """Ask the scheduler, at most once in `MONITOR_S`."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + MONITOR_S
        workers: dict[str, Any] = {}
        with contextlib.suppress(OSError, TimeoutError, RuntimeError, KeyError, AttributeError):
            workers = self._client.scheduler_info(n_workers=-1)["workers"]
        if self._client.status in ("closed", "closing"):
            raise self.gone()
        if workers:
            self.slots = sum(int(worker["nthreads"]) for worker in workers.values())
            self.most_workers = max(self.most_workers, len(workers))
            self._last_seen, self._noted = now, False
        elif now - self._last_seen > GIVE_UP_S:
            raise BackendError(f"{self._name}: no workers for {GIVE_UP_S:g} s; {CONTINUE}")
        elif now - self._last_seen > ALONE_S and not self._noted:
            self._noted = True
            print(f"{self._name}: no workers for {ALONE_S:g} s; waiting for some", file=sys.stderr, flush=True)

    def gone(self) -> BackendError:
        """The error for a cluster that does not respond any more."""
        return BackendError(f"{self._name} is gone; {CONTINUE}")


def _gather(
    client: Any, job: Job, frames: Sequence[int], *, monitor: _Monitor, threads: int | None, done: Done
) -> None:
    """Submit batches of frames, a few ahead of the workers, and collect the records."""
    import distributed

    run = secrets.token_hex(4)
    size = max(1, min(LARGEST_BATCH, len(frames) // (8 * monitor.slots)))
    batches = (list(frames[start : start + size]) for start in range(0, len(frames), size))

    def submit(count: int) -> list[Any]:
        return [
            client.submit(make_batch, job, batch, threads, pure=False, key=f"frame-{batch[0]}-{run}")
            for batch in islice(batches, max(0, count))
        ]

    running = distributed.as_completed(submit(AHEAD * monitor.slots), loop=client.loop)
    while not running.is_empty():
        monitor.update()
        if not running.has_ready():
            time.sleep(POLL_S)
            continue
        future = next(running)
        try:
            records = future.result()
        except distributed.KilledWorker:
            raise BackendError(
                f"workers died {DEATHS + 1} times over {future.key.rsplit('-', 1)[0]} (killed, or out of memory); "
                "finished frames are kept: use fewer workers and run the same command again"
            ) from None
        except (CancelledError, distributed.CancelledError, distributed.comm.CommClosedError):
            raise monitor.gone() from None
        future.release()
        if isinstance(records, StarbenchError):
            raise records
        done(records)
        for following in submit(AHEAD * monitor.slots - running.count()):
            running.add(following)


def _reason(error: BaseException) -> str:
    """Text of an error and of its root cause ("Nanny failed to start" is no help)."""
    root = error
    while cause := root.__cause__ or (None if root.__suppress_context__ else root.__context__):
        root = cause
    texts = [" ".join(str(each).split()).rstrip(".")[:160] or type(each).__name__ for each in (error, root)]
    return ": ".join(dict.fromkeys(texts))


def _hush() -> None:
    """Silence the log of Dask, whose errors are reported in one line."""
    for name in [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextlib.contextmanager
def local_cluster(count: int) -> Iterator[Any]:
    """A Dask client with worker processes on this machine, which end with it.

    The cluster starts in a separate thread, and the main thread takes interrupts. After an interrupt or any other
    exception the processes are killed at once.
    """
    import dask
    import distributed

    settings = {
        "distributed.scheduler.allowed-failures": DEATHS,
        "distributed.scheduler.active-memory-manager.start": False,
        "distributed.worker.daemon": True,
        "distributed.worker.profile.enabled": False,  # it samples every worker a hundred times a second
        # a worker returns no memory to the system, as it allocates and frees images all the time
        "distributed.nanny.pre-spawn-environ": dict.fromkeys(THREADS, "1")
        | {"MALLOC_TRIM_THRESHOLD_": str(1 << 30), "MALLOC_MMAP_THRESHOLD_": str(1 << 25)},
    }
    others = set(multiprocessing.active_children())
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask.config.set(settings))
        scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="starbench-", ignore_cleanup_errors=True))
        running: list[Any] = []  # the cluster, then its client
        failed: list[BaseException] = []
        started = threading.Event()  # not a join of the thread, which fails in Python 3.11 after an interrupt

        def start() -> None:
            try:
                cluster = distributed.LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address=None,
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # a free port
                    memory_limit=0,
                    local_directory=scratch,
                    silence_logs=logging.CRITICAL,
                )
                running.extend((cluster, distributed.Client(cluster, set_as_default=False)))
            except BaseException as error:
                failed.append(error)
            finally:
                started.set()

        try:
            resource_tracker.ensure_running()  # it unblocks interrupts in the thread that starts it
            with signals_held(signal.SIGINT):  # inherited by threads and processes: this thread takes interrupts
                threading.Thread(target=start, daemon=True, name="start of the workers").start()
            until = time.monotonic() + START_S
            while not started.wait(0.02):
                if time.monotonic() > until:
                    raise TimeoutError(f"not started after {START_S:g} s")
            if failed:
                raise failed[0]
            yield running[1]
        except BaseException:
            _kill(running, started, others)
            raise
        running[1].close()
        running[0].close(timeout=CLOSE_S)


def _kill(running: list[Any], started: threading.Event, others: set[Any]) -> None:
    """End the processes, also those just starting, then the rest of the cluster."""
    _hush()

    def close() -> None:
        started.wait()
        for closed, timeout in ((running[1:], 0.0), (running[:1], CLOSE_S)):
            with contextlib.suppress(Exception):
                closed[0].close(timeout=timeout)

    for cluster in running[:1]:
        for nanny in cluster.workers.values():
            cluster.loop.add_callback(nanny.close_gracefully)  # it starts no new process
    closing = threading.Thread(target=close, daemon=True, name="end of the workers")
    closing.start()
    until = time.monotonic() + KILL_S
    while closing.is_alive() and time.monotonic() < until:
        for child in set(multiprocessing.active_children()) - others:
            child.kill()
        closing.join(0.02)
