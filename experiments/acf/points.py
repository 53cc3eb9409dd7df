"""Points of the Monte-Carlo runs: which noise, gyros, stars and methods each figure and table of ACF17 asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from experiments.acf.settings import Config

__all__ = ["COMPARED", "Method", "Plan", "Point", "make_plan"]

Method = Literal["acc", "linked", "free", "iac", "iac_full"]

COMPARED: tuple[Method, ...] = ("acc", "linked", "free", "iac", "iac_full")
"""The document's method (ACC), a gyro of stated noise, free attitudes, interstar angles (IAC) as published, and IAC
fully weighted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A setting that runs are made of."""

    name: str  # Name of its random streams
    noise_px: float  # Noise of a star's position, per axis
    # (float, float) Gyros tried on the same stars: bias [deg/h] and angle random walk [deg/sqrt(h)]
    gyro: tuple[tuple[float, float], ...]
    methods: tuple[Method, ...]  # "acc" and "linked" run for every gyro, the others once
    frames: Literal["odd", "all"] = "odd"  # What calibrates. After "odd", noise-free even frames are reprojected
    stars: int | None = None  # Stars in every frame; None: the density of the configuration
    own_sky: bool = False  # Whether each run has a sky of its own; otherwise all runs see sky 0
    pixel_um: float | None = None  # Pixel in place of the configured one
    keep_reprojections: bool = False  # Whether each star's reprojection error is kept


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """All points of the experiment."""

    fig3: Sequence[Point]  # One per noise; gyros: perfect, then the biases, then the random walks
    table2: Point  # Table 1's gyro, then a perfect one; Fig. 4 too
    counts: Sequence[Point]  # One per number of stars; a perfect gyro, then Table 1's
    inferred: Point  # Table 1's gyro with the pixel and the number of stars that the document's numbers ask for
    fig5: Sequence[Point]  # One per noise, Table 1's gyro, all methods
    sweep: Sequence[Point]  # One per number of stars; a gyro per factor

    @property
    def points(self) -> list[Point]:
        """All of them."""
        return [self.table2, self.inferred, *self.counts, *self.fig3, *self.fig5, *self.sweep]

    def runs(self, config: Config, point: Point) -> int:
        """How many runs a point has."""
        return config.sweep.skies if point in self.sweep else config.runs


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
