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
from experiments.harness.config import ExperimentConfig
from experiments.harness.experiment import Experiment
from experiments.harness.plotting import band_colours, new_figure
from experiments.harness.sections import Section, below, col
from experiments.harness.summary import Measured
from optics.errors import DomainError
from optics.settings import StrictModel


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
class Level:
    level_e: float = col("Level", "e-", ".0f")
    mean_e: Measured = col("Mean", "e-")
    variance_e2: Measured = col("Variance", "e-2")
    deviation_sigma: float = col("Deviation", "sigma", "+.2f")


@dataclass(frozen=True, slots=True, kw_only=True)
class Worst:
    worst: Measured = col("Largest deviation of a variance", "sigma", ".2f")
    limit_sigma: float = col("Limit", "sigma")


def run(config, *, progress):
    if max(config.mean_e) > 1e12:
        raise DomainError(f"mean_e = {max(config.mean_e):.3g} e-; at most 1e12 e- can be drawn; lower it")
    rng = np.random.Generator(np.random.Philox(config.seed))
    levels = []
    for level in progress.track(config.mean_e, "draw"):
        drawn = rng.poisson(level, config.samples).astype(float)
        variance = float(drawn.var(ddof=1))
        # variance of a sample variance of Poisson numbers: (m4 - s^4)/n with m4 = lambda + 3 lambda^2
        error = float(np.sqrt((level + 2 * level**2) / config.samples))
        levels.append(
            Level(
                level_e=level,
                mean_e=Measured(value=float(drawn.mean()), uncertainty=float(np.sqrt(level / config.samples))),
                variance_e2=Measured(value=variance, uncertainty=error),
                deviation_sigma=(variance - level) / error,
            )
        )
        if config.pause_s > 0:  # a test that interrupts the run waits for this line
            print("drawing", file=sys.stderr, flush=True)
            time.sleep(config.pause_s)
    largest = Measured(value=max(abs(one.deviation_sigma) for one in levels), n=len(levels))
    return {"levels": levels, "worst": Worst(worst=largest, limit_sigma=config.limit_sigma)}


def draw(outcome, width="full"):
    figure, axes = new_figure(width=width, aspect_ratio=0.5 if width == "full" else 0.8)
    mean = outcome.values("mean_e")
    colours = band_colours([band.centre_nm for band in outcome.config.bands])
    for colour, shift in zip(colours, (0.8, 1.0, 1.25), strict=False):
        variance = outcome.values("variance_e2"), outcome.errors("variance_e2")
        axes.errorbar(mean * shift, *variance, fmt="o", color=colour, label=f"shift {shift}")
    axes.plot(mean, mean, color="0.6", zorder=0, label="variance = mean")
    axes.set(xscale="log", yscale="log", xlabel=outcome.heading("mean_e"), ylabel=outcome.heading("variance_e2"))
    axes.legend()
    return figure


def files(result, folder):
    (folder / "frames").mkdir()
    np.save(folder / "frames" / "variance.npy", [one.variance_e2.value for one in result["levels"]])


SECTIONS = {
    "levels": Section(
        record=Level,
        dim="level",
        along="level_e",
        table="levels",
        caption="Variance of the signal and its mean.",
        note="Uncertainties are one standard deviation.",
        figures={"draw": draw},
    ),
    "worst": Section(record=Worst, verdicts=[below("worst", "limit_sigma")]),
}
experiment = Experiment(
    name="shot_noise",
    config=Config,
    run=run,
    sections=SECTIONS,
    report="shot_noise.md",
    quick={"samples": 2000, "bands.1.name": "quick"},
    show=("levels",),
    files=files,
    renders=lambda config: False,
)
main = command(experiment)

if __name__ == "__main__":
    sys.exit(main())
