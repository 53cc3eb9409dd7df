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

from experiments.harness.config import ExperimentConfig, StrictModel
from experiments.harness.legacy import legacy_command as command
from experiments.harness.plotting import band_colours, new_figure
from experiments.harness.report import Equation, Figure, KeyNumber, Report, Row, Section, Text
from experiments.harness.summary import Criterion, Measured
from experiments.harness.tables import Column, Table
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


def table(result):
    rows = [
        (
            level,
            Measured(value=mean, unit="e-", uncertainty=(level / result.config.samples) ** 0.5),
            Measured(value=var, uncertainty=err),
            dev,
        )
        for level, mean, var, err, dev in zip(
            result.config.mean_e,
            result.mean_e,
            result.variance_e2,
            result.error_e2,
            deviation_sigma(result),
            strict=True,
        )
    ]
    columns = (
        Column(name="Level", unit="e⁻", key="level_e", format=".0f"),
        Column(name="Mean", unit="e⁻", key="mean_e"),
        Column(name="Variance", unit="e⁻²", key="variance_e2"),
        Column(name="Deviation", unit="σ", key="deviation_sigma", format="+.2f"),
    )
    note = f"Uncertainties are one standard deviation; N = {result.config.samples} per level."
    return Table(columns=columns, rows=rows, caption="Variance of the signal beside its mean.", note=note)


def draw(result, width):
    figure, axes = new_figure(width=width, aspect_ratio=0.5 if width == "full" else 0.8)
    for colour, shift in zip(
        band_colours([band.centre_nm for band in result.config.bands]), (0.8, 1.0, 1.25), strict=False
    ):
        axes.errorbar(
            result.mean_e * shift, result.variance_e2, result.error_e2, fmt="o", color=colour, label=f"shift {shift}"
        )
    axes.plot(result.mean_e, result.mean_e, color="0.6", zorder=0, label="variance = mean")
    axes.set(xscale="log", yscale="log", xlabel="mean [e⁻]", ylabel="variance [e⁻²]")
    axes.legend()
    return figure


def report(result):
    halves = Row(
        [
            Figure(drawing=draw(result, "half"), caption="The same in half the width, as vectors."),
            Figure(drawing=draw(result, "half"), caption="And as pixels.", raster=True),
        ]
    )
    return Report(
        title="Shot noise is as large as its signal says",
        lead="Poisson numbers are drawn at a few levels; their variance is compared with their mean. "
        f"Label: {result.config.label or 'none'}.",
        verdict="The largest deviation is well inside what the number of samples allows.",
        key_numbers=[
            KeyNumber(
                label="Largest deviation", value=float(np.abs(deviation_sigma(result)).max()), unit="σ", format=".2f"
            ),
            KeyNumber(label="Levels", value=len(result.config.mean_e)),
            KeyNumber(
                label="Variance at the top level",
                value=Measured(value=result.variance_e2[-1], unit="e⁻²", uncertainty=result.error_e2[-1]),
                note="expected 2000",
            ),
        ],
        sections=[
            Section(
                title="Result",
                blocks=[
                    Text("For *Poisson* numbers variance and mean are equal; a **gain error** would tilt the line."),
                    Equation(
                        latex=r"\sigma^2 = \frac{1}{N-1}\sum_{i=1}^{N} (n_i - \bar n)^2 = \lambda", note="definition"
                    ),
                    table(result),
                    Figure(drawing=draw(result, "full"), caption="Variance against mean, **log–log**; bars are 1σ."),
                ],
            ),
            Section(title="Two widths", blocks=[halves, Text("First paragraph.\n\nSecond paragraph, x < y & z.")]),
        ],
    )


def summary(result):
    worst = float(np.abs(deviation_sigma(result)).max())
    results = {
        "variance_e2": result.variance_e2,
        "mean_e": result.mean_e,
        "worst": Measured(value=worst, unit="sigma", n=3),
    }
    return results, [
        Criterion(name="largest deviation of a variance", value=worst, limit=result.config.limit_sigma, unit="sigma")
    ]


def tables(result):
    return {"levels": table(result)}


def files(result, folder):
    (folder / "frames").mkdir()
    np.save(folder / "frames" / "variance.npy", result.variance_e2)


main = command(
    "shot_noise",
    config=Config,
    run=run,
    report=report,
    summary=summary,
    quick={"samples": 2000, "bands.1.name": "quick"},
    tables=tables,
    show=("levels",),
    files=files,
    renders=False,
)

if __name__ == "__main__":
    sys.exit(main())
