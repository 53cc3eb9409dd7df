"""Shot noise: is the variance of a Poisson signal its mean?

A small real experiment that the tests of the frame run; it is not part of the package.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from experiments.harness.cli import command
from experiments.harness.config import ExperimentConfig, StrictModel
from experiments.harness.experiment import Experiment
from experiments.harness.pivot import Pivot
from experiments.harness.plotting import band_colours, new_figure
from experiments.harness.quantities import Quantities
from experiments.harness.summary import Criterion, Measured
from optics.errors import DomainError


class Band(StrictModel):
    centre_nm: float = Field(default=600.0, gt=0)
    name: str = "red"


class Config(ExperimentConfig):
    mean_e: tuple[float, ...] = Field(default=(20.0, 200.0, 2000.0), min_length=1, description="signal levels")
    samples: int = Field(default=20000, ge=2, description="pixels per level")
    limit_sigma: float = Field(default=4.0, gt=0, description="largest deviation of a variance from its mean")
    label: str = ""
    kind: Literal["poisson"] = "poisson"
    bands: tuple[Band, ...] = (Band(centre_nm=500.0, name="500"), Band(), Band(centre_nm=800.0, name="800"))
    pause_s: float = Field(default=0.0, ge=0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    config: Config
    mean_e: np.ndarray
    variance_e2: np.ndarray
    error_e2: np.ndarray


def run(config, *, progress):
    if max(config.mean_e) > 1e12:
        raise DomainError(f"mean_e = {max(config.mean_e):.3g} e-; at most 1e12 e- can be drawn; lower it")
    rng = np.random.Generator(np.random.Philox(config.seed))
    drawn = []
    for level in progress.track(config.mean_e, "draw"):
        drawn.append(rng.poisson(level, config.samples).astype(float))
        if config.pause_s > 0:  # a test that interrupts the run waits for this line
            print("drawing", file=sys.stderr, flush=True)
            time.sleep(config.pause_s)
    values = np.array(drawn)
    # variance of a sample variance of Poisson numbers: (m4 - s^4)/n with m4 = lambda + 3 lambda^2
    level = np.array(config.mean_e)
    return Result(
        config=config,
        mean_e=values.mean(axis=1),
        variance_e2=values.var(axis=1, ddof=1),
        error_e2=np.sqrt((level + 2 * level**2) / config.samples),
    )


def deviation_sigma(result):
    return (result.variance_e2 - np.array(result.config.mean_e)) / result.error_e2


def describe(result):
    q, config = Quantities(), result.config
    q.axis("level", config.mean_e, "Level", unit="e-", format=".0f", key="level_e")
    sigma = np.sqrt(np.array(config.mean_e) / config.samples)
    q.add("mean_e", result.mean_e, "Mean", unit="e-", dims="level", error=sigma, json="")
    q.add("variance_e2", result.variance_e2, "Variance", unit="e-2", dims="level", error=result.error_e2, json="")
    q.add("means", result.mean_e, dims="level", json="mean_e")
    q.add("variances", result.variance_e2, dims="level", json="variance_e2")
    deviation = deviation_sigma(result)
    q.add("deviation_sigma", deviation, "Deviation", unit="sigma", dims="level", format="+.2f", json="")
    worst = Measured(value=float(np.abs(deviation).max()), unit="sigma", n=3)
    q.add("worst", worst, "Largest deviation", format=".2f")
    return q


def tables(outcome):
    note = f"Uncertainties are one standard deviation; N = {outcome.config.samples} per level."
    columns = "mean_e variance_e2 deviation_sigma"
    return {
        "levels": Pivot(rows="level", columns=columns, caption="Variance of the signal beside its mean.", note=note)
    }


def draw(outcome, width="full"):
    result = outcome.result
    figure, axes = new_figure(width=width, aspect_ratio=0.5 if width == "full" else 0.8)
    for colour, shift in zip(
        band_colours([band.centre_nm for band in result.config.bands]), (0.8, 1.0, 1.25), strict=False
    ):
        axes.errorbar(
            outcome.values("mean_e") * shift,
            outcome.values("variance_e2"),
            outcome.errors("variance_e2"),
            fmt="o",
            color=colour,
            label=f"shift {shift}",
        )
    axes.plot(result.mean_e, result.mean_e, color="0.6", zorder=0, label="variance = mean")
    axes.set(xscale="log", yscale="log", xlabel=outcome.heading("mean_e"), ylabel=outcome.heading("variance_e2"))
    axes.legend()
    return figure


def criteria(outcome):
    worst, limit = outcome.value("worst"), outcome.config.limit_sigma
    return [Criterion(name="largest deviation of a variance", value=worst.value, limit=limit, unit="sigma")]


def files(result, folder):
    (folder / "frames").mkdir()
    np.save(folder / "frames" / "variance.npy", result.variance_e2)


experiment = Experiment(
    name="shot_noise",
    config=Config,
    run=run,
    quantities=describe,
    tables=tables,
    criteria=criteria,
    figures={"draw": draw},
    report="shot_noise.md",
    quick={"samples": 2000, "bands.1.name": "quick"},
    show=("levels",),
    files=files,
    renders=lambda config: False,
)
main = command(experiment)

if __name__ == "__main__":
    sys.exit(main())
