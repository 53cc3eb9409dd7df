"""Who makes which frame: this process, a few on this machine, or a Dask cluster. The frames do not depend on it."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import CancelledError
from itertools import islice
from pathlib import Path
from typing import Any

from experiments.dataset.production.identity import software
from experiments.dataset.production.job import Job, make_frame
from experiments.dataset.production.local_cluster import DEATHS, hush, local_cluster
from experiments.dataset.production.remote import Store
from experiments.dataset.truth.frame_record import FrameRecord
from experiments.harness.provenance import count_memory_of_workers, peak_memory_mb
from experiments.harness.system import processors
from optics.errors import BackendError, ConfigError

__all__ = ["Done", "make_frames"]

Done = Callable[[Sequence[FrameRecord]], None]

CONNECT_S = 5.0
AHEAD = 3
"""Batches per worker that are handed out before the first is back."""
LARGEST_BATCH = 8
"""Frames that are handed out together: sending them one by one costs the scheduler some milliseconds each."""
FEW_FRAMES = 8
"""With so few frames, starting workers takes longer than making them."""
LOOK_S, POLL_S = 1.0, 0.003
ALONE_S, GIVE_UP_S = 10.0, 300.0
GO_ON = "what was made is kept: run the same command again to go on"


def make_frames(job: Job, frames: Sequence[int], *, workers: int, scheduler: str, done: Done) -> int:
    """Make frames; every one that is finished is reported at once."""
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


def _on_processes(job: Job, frames: Sequence[int], count: int, done: Done) -> int:
    dask, distributed = _dask()
    with contextlib.ExitStack() as stack:
        try:
            client = stack.enter_context(local_cluster(dask, distributed, count))
        except (OSError, RuntimeError, TimeoutError) as error:
            raise BackendError(f"{count} workers cannot be started ({_said(error)}); set workers = 1") from None
        watch = _Watch(client, "the scheduler on this machine", most_workers=count + DEATHS)
        _gather(distributed, client, job, frames, watch=watch, threads=max(1, processors() // count), done=done)
        with contextlib.suppress(OSError, TimeoutError, RuntimeError):
            count_memory_of_workers(client.run(peak_memory_mb).values())
    return count


def _on_cluster(job: Job, frames: Sequence[int], address: str, done: Done) -> int:
    dask, distributed = _dask()
    if not address.startswith(("tcp://", "tls://", "ws://", "wss://", "ucx://")):
        raise ConfigError(f"scheduler = {address!r}; an address such as tcp://host:8786 is needed")
    hush()
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask.config.set({"distributed.comm.timeouts.connect": f"{CONNECT_S:g}s"}))
        try:
            asyncio.run(_greet(distributed, address))
            client = stack.enter_context(
                distributed.Client(address, timeout=f"{CONNECT_S:g}s", set_as_default=False, name="starbench")
            )
        except TypeError:  # Dask's, of a missing certificate
            raise ConfigError(
                f"scheduler {address}: Dask knows no certificates; name them in its configuration "
                "(distributed.comm.tls.ca-file, client.cert and client.key, see docs/dataset.md)"
            ) from None
        except (OSError, TimeoutError, ValueError, RuntimeError) as error:
            raise ConfigError(
                f"scheduler {address} does not answer as one within {CONNECT_S:g} s ({_said(error)}); start one with "
                "'dask scheduler', or leave scheduler out to use this machine"
            ) from None
        _check_workers(client, job, address)
        watch = _Watch(client, f"scheduler {address}")
        _gather(distributed, client, job, frames, watch=watch, threads=None, done=done)
    return watch.most


def _first_worker(client: Any, address: str) -> Any:
    """The client, once a cluster that scales itself has started a worker for something to do; it may soon be gone."""
    try:
        client.submit(int, pure=False).result(timeout=ALONE_S)
        return client
    except TimeoutError:
        raise ConfigError(
            f"scheduler {address} has no workers, and starts none within {ALONE_S:g} s; start some with "
            f"'dask worker {address}'"
        ) from None


async def _greet(distributed: Any, address: str) -> None:
    """Speak to the scheduler once: a client would wait for ever at a port where something else listens."""
    arguments = distributed.Security().get_connection_args("client")
    comm = await asyncio.wait_for(distributed.comm.connect(address, timeout=CONNECT_S, **arguments), CONNECT_S)
    comm.abort()


def _check_workers(client: Any, job: Job, address: str) -> None:
    """Refuse workers that do not see the folder, or have other software."""
    token = f".token-{secrets.token_hex(8)}.partial"
    try:
        Store(job.url).write(token, b"") if job.url else (Path(job.folder) / token).touch()
        try:
            if client.scheduler_info(n_workers=-1)["workers"]:
                answers = client.run(probe, job, token)
            else:
                answers = {"of its own": _first_worker(client, address).submit(probe, job, token, pure=False).result()}
        except ConfigError:
            raise
        except Exception as error:  # whatever hinders a worker from running our function
            raise ConfigError(
                f"scheduler {address}: its workers cannot run starbench ({_said(error)}); install the same version "
                "there"
            ) from None
    finally:
        if job.url:
            with contextlib.suppress(ConfigError):
                Store(job.url).remove(token)
        else:
            (Path(job.folder) / token).unlink(missing_ok=True)
    ours = software(job.backend)
    for worker, (sees, theirs) in sorted(answers.items()):
        if not sees:
            raise ConfigError(
                f"scheduler {address}: worker {worker} does not see {job.url or 'the folder of the dataset'}; "
                + (
                    "it must reach it"
                    if job.url
                    else "it must be on a file system that all machines share, under the same path"
                )
            )
        for package, version in ours.items():
            if theirs.get(package) != version:
                raise ConfigError(
                    f"scheduler {address}: worker {worker} has {package} {theirs.get(package)}, here it is {version}; "
                    "frames would differ: install the same version"
                )


def probe(job: Job, token: str) -> tuple[bool, dict[str, str]]:
    """What a worker sees: whether a file of the dataset is there, and its software."""
    sees = token in Store(job.url).names() if job.url else (Path(job.folder) / token).exists()
    return sees, software(job.backend)


class _Watch:
    """Looks at a cluster now and then: how many frames it takes at once, and whether it is still there.

    Workers may come and go (adaptive scaling); without any for `ALONE_S` seconds the user is told, after `GIVE_UP_S`
    the run ends.
    """

    def __init__(self, client: Any, name: str, most_workers: int | None = None) -> None:
        self._client, self._name, self._most_workers = client, name, most_workers
        self.slots, self.most, self.finished = 1, 0, 0
        self._seen: set[str] = set()
        self._next = self._good = time.monotonic()
        self._told = False
        self.look()

    def look(self) -> None:
        """Ask the scheduler, if the last answer is old."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + LOOK_S
        workers: dict[str, Any] = {}
        with contextlib.suppress(OSError, TimeoutError, RuntimeError, KeyError, AttributeError):
            workers = self._client.scheduler_info(n_workers=-1)["workers"]
        if self._client.status in ("closed", "closing"):
            raise self.gone()
        self._seen |= set(workers)
        if self._most_workers is not None and not self.finished and len(self._seen) > self._most_workers:
            raise BackendError(
                f"workers die as soon as they start ({len(self._seen)} so far; out of memory, or killed); {GO_ON}"
            )
        if workers:
            self.slots = sum(int(worker["nthreads"]) for worker in workers.values())
            self.most = max(self.most, len(workers))
            self._good, self._told = now, False
        elif now - self._good > GIVE_UP_S:
            raise BackendError(f"{self._name}: no workers for {GIVE_UP_S:g} s; {GO_ON}")
        elif now - self._good > ALONE_S and not self._told:
            self._told = True
            print(f"{self._name}: no workers for {ALONE_S:g} s; waiting for some", file=sys.stderr, flush=True)

    def gone(self) -> BackendError:
        """The error for a cluster that does not answer any more."""
        return BackendError(f"{self._name} is gone; {GO_ON}")


def _gather(
    distributed: Any,
    client: Any,
    job: Job,
    frames: Sequence[int],
    *,
    watch: _Watch,
    threads: int | None,
    done: Done,
) -> None:
    """Hand frames out, a few ahead, and take them in as they are finished."""
    run = secrets.token_hex(4)
    size = max(1, min(LARGEST_BATCH, len(frames) // (8 * watch.slots)))
    batches = (frames[start : start + size] for start in range(0, len(frames), size))

    def submit(some: Iterable[Sequence[int]]) -> list[Any]:
        return [
            client.submit(make_batch, job, list(batch), threads, pure=False, key=f"frame-{batch[0]}-{run}")
            for batch in some
        ]

    running = distributed.as_completed(submit(islice(batches, AHEAD * watch.slots)), loop=client.loop)
    while not running.is_empty():
        watch.look()
        if not running.has_ready():
            time.sleep(POLL_S)
            continue
        future = next(running)
        try:
            done(future.result())
        except distributed.KilledWorker:
            raise BackendError(
                f"workers died {DEATHS + 1} times over {future.key.rsplit('-', 1)[0]} (killed, or out of memory); what "
                "was made is kept: use fewer workers and run the same command again"
            ) from None
        except (CancelledError, distributed.CancelledError, distributed.comm.CommClosedError):
            raise watch.gone() from None
        watch.finished += 1
        future.release()
        for following in submit(islice(batches, max(0, AHEAD * watch.slots - running.count()))):
            running.add(following)


def _said(error: BaseException) -> str:
    """What an error says, and what the first of its causes says: "Nanny failed to start" helps nobody."""
    first = error
    while before := first.__cause__ or (None if first.__suppress_context__ else first.__context__):
        first = before
    said = [" ".join(str(each).split()).rstrip(".")[:160] or type(each).__name__ for each in (error, first)]
    return ": ".join(dict.fromkeys(said))


def make_batch(job: Job, frames: Sequence[int], threads: int | None) -> list[FrameRecord]:
    """Make frames one after the other, in a worker."""
    return [make_frame(job, frame, threads) for frame in frames]


def _dask() -> tuple[Any, Any]:
    try:
        import dask
        import distributed
    except ImportError:
        raise ConfigError(
            "several workers need the package distributed; pip install distributed, or set workers = 1"
        ) from None
    return dask, distributed
