"""All Monte-Carlo runs, on several processes; what comes out does not depend on how many there are.

Every task is a function of its argument alone (random streams are named, not shared), workers use one thread for linear
algebra, and results come back in the order of the tasks. An interrupt ends the workers and is passed on.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from experiments.acf.points import Plan, Point
from experiments.acf.settings import Config
from experiments.acf.trials import Task, work
from experiments.harness.system import one_thread, processors, signals_held
from optics.arrays import FloatArray
from optics.errors import BackendError

__all__ = ["Trials", "perform", "run_tasks"]

CHUNK = 25
"""Runs of a task at most; a part of a second to a few seconds of work."""
Work = TypeVar("Work")
Done = TypeVar("Done")


@dataclass(frozen=True, slots=True, kw_only=True)
class Trials:
    """The runs of a point: arrays with the runs along the first axis, named as `experiments.acf.trials.work` does."""

    point: Point
    values: Mapping[str, FloatArray]

    def of(self, method: str, what: str, gyro: int | None = 0) -> FloatArray:
        """One figure of one method; ``gyro`` counts for ACC and the linked adjustment only."""
        label = f"{method}@{gyro}" if method in ("acc", "linked") else method
        return self.values[f"{label}.{what}"]


def perform(config: Config, plan: Plan, *, advance: Callable[[int], None]) -> dict[str, Trials]:
    """Make all runs."""
    tasks = [
        Task(config=config, point=point, first=first, last=min(first + CHUNK, runs))
        for point, runs in ((point, plan.runs(config, point)) for point in plan.points)
        for first in range(0, runs, CHUNK)
    ]
    found = run_tasks(
        work, tasks, workers=config.workers, done=lambda index: advance(tasks[index].last - tasks[index].first)
    )
    parts: dict[str, list[Mapping[str, FloatArray]]] = {point.name: [] for point in plan.points}
    for task, values in zip(tasks, found, strict=True):
        parts[task.point.name].append(values)
    return {
        point.name: Trials(
            point=point,
            values={key: np.concatenate([part[key] for part in parts[point.name]]) for key in parts[point.name][0]},
        )
        for point in plan.points
    }


def run_tasks(
    work: Callable[[Work], Done], tasks: Sequence[Work], *, workers: int, done: Callable[[int], None]
) -> list[Done]:
    """Results of all tasks, in their order."""
    count = min(workers or processors(), len(tasks))
    if not tasks:
        return []
    others = set(multiprocessing.active_children())
    with one_thread():  # quicker side by side, and the same sums everywhere
        pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"), initializer=_prepare)
        try:
            with signals_held(signal.SIGINT):  # children inherit this: an interrupt at the terminal is ours to handle
                futures = [pool.submit(work, task) for task in tasks]
            found = []
            for index, future in enumerate(futures):
                found.append(future.result())
                done(index)
            return found
        except BrokenProcessPool:
            raise BackendError(
                "a Monte-Carlo process vanished (killed, or out of memory); set workers=1 or lower sky.stars_per_frame"
            ) from None
        except BaseException:  # what the workers are at is of no use any more; processes of others are left alone
            for child in set(multiprocessing.active_children()) - others:
                child.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


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
