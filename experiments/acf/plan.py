"""Which runs are made, and in which pieces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.acf.settings import Config
from experiments.acf.tasks import Method, Point, Task, work
from experiments.acf.workers import run_tasks
from optics.arrays import FloatArray

__all__ = ["Outcome", "Plan", "make_plan", "perform"]


COMPARED: tuple[Method, ...] = ("acc", "linked", "free", "iac", "iac_full")
CHUNK = 25
"""Runs of a task at most; a part of a second to a few seconds of work."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """All points of the experiment.

    Attributes
    ----------
    fig3 : sequence of Point
        One per noise; gyros: perfect, then the biases, then the random walks.
    table2 : Point
        Table 1's gyro, then a perfect one; Fig. 4 too.
    counts : sequence of Point
        One per number of stars; a perfect gyro, then Table 1's.
    inferred : Point
        Table 1's gyro with the pixel and the number of stars that the document's numbers ask for.
    fig5 : sequence of Point
        One per noise, Table 1's gyro, all methods.
    sweep : sequence of Point
        One per number of stars; a gyro per factor.
    """

    fig3: Sequence[Point]
    table2: Point
    counts: Sequence[Point]
    inferred: Point
    fig5: Sequence[Point]
    sweep: Sequence[Point]

    @property
    def points(self) -> list[Point]:
        """All of them."""
        return [self.table2, self.inferred, *self.counts, *self.fig3, *self.fig5, *self.sweep]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came out at a point: arrays with the runs along the first axis, named as `acf_tasks.work` does."""

    point: Point
    values: Mapping[str, FloatArray]

    def of(self, method: str, what: str, gyro: int | None = 0) -> FloatArray:
        """One figure of one method; ``gyro`` counts for ACC and the linked adjustment only."""
        label = f"{method}@{gyro}" if method in ("acc", "linked") else method
        return self.values[f"{label}.{what}"]


def make_plan(config: Config, *, inferred_um: float, inferred_stars: int) -> Plan:
    """Points of a configuration."""
    gyro = config.gyro
    table1 = (gyro.bias_deg_per_h, gyro.angle_random_walk_deg_per_sqrt_h)
    tried = [(0.0, 0.0)]
    tried += [(bias, 0.0) for bias in config.bias_deg_per_h]
    tried += [(0.0, walk) for walk in config.angle_random_walk_deg_per_sqrt_h]
    sweep = config.sweep
    return Plan(
        fig3=[Point(name=f"fig3 {s:g} px", noise_px=s, gyro=tuple(tried), methods=("acc",)) for s in config.noise_px],
        table2=Point(
            name="table2",
            noise_px=config.table_noise_px,
            gyro=(table1, (0.0, 0.0)),
            methods=("acc",),
            keep_reprojections=True,
        ),
        counts=[
            Point(
                name=f"counts {n}",
                noise_px=config.table_noise_px,
                gyro=((0.0, 0.0), table1),
                methods=("acc",),
                stars=n,
            )
            for n in config.counts
        ],
        inferred=Point(
            name="inferred",
            noise_px=config.table_noise_px,
            gyro=(table1,),
            methods=("acc",),
            stars=inferred_stars,
            pixel_um=inferred_um,
            keep_reprojections=True,
        ),
        fig5=[
            Point(name=f"fig5 {s:g} px", noise_px=s, gyro=(table1,), methods=COMPARED, frames="all")
            for s in config.noise_px
        ],
        sweep=[
            Point(
                name=f"sweep {n}",
                noise_px=sweep.noise_px,
                gyro=tuple((factor * table1[0], factor * table1[1]) for factor in sweep.gyro_factor),
                methods=("acc", "linked", "free"),
                frames="all",
                stars=n,
                own_sky=True,
            )
            for n in sweep.stars
        ],
    )


def perform(config: Config, plan: Plan, *, advance: Callable[[int], None]) -> dict[str, Outcome]:
    """Make all runs.

    Parameters
    ----------
    config : Config
        Settings.
    plan : Plan
        What to run.
    advance : callable
        Called with the number of runs whenever some are done.

    Returns
    -------
    dict of str to Outcome
        By the name of the point.
    """
    tasks = [
        Task(config=config, point=point, first=first, last=min(first + CHUNK, runs))
        for point, runs in ((point, runs_of(config, plan, point)) for point in plan.points)
        for first in range(0, runs, CHUNK)
    ]
    found = run_tasks(
        work, tasks, workers=config.workers, done=lambda index: advance(tasks[index].last - tasks[index].first)
    )
    parts: dict[str, list[Mapping[str, FloatArray]]] = {point.name: [] for point in plan.points}
    for task, values in zip(tasks, found, strict=True):
        parts[task.point.name].append(values)
    return {
        point.name: Outcome(
            point=point,
            values={key: np.concatenate([part[key] for part in parts[point.name]]) for key in parts[point.name][0]},
        )
        for point in plan.points
    }


def runs_of(config: Config, plan: Plan, point: Point) -> int:
    """How many runs a point has."""
    return config.sweep.skies if point in plan.sweep else config.runs
