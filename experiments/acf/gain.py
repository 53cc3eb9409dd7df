"""Gain of a gyro over free attitudes against stars per frame, and the loss by a gyro taken as perfect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.acf.settings import AcfConfig
from experiments.acf.trials import Method, TrialPoint, Trials, table1_gyro
from experiments.harness.drawings import curves
from experiments.harness.sections import Section, agree, col
from experiments.harness.summary import Measured
from optics.arrays import FloatArray, IntArray

SWEPT: tuple[Method, ...] = ("acc", "linked", "free")
"""Methods of the sweep of stars per frame."""
RESAMPLES = 300
"""Bootstrap samples of the skies, for the standard error of a ratio of medians."""


def sweep_points(config: AcfConfig) -> list[TrialPoint]:
    """One point per number of stars; a gyro per factor; every run has a sky of its own."""
    sweep, (bias, walk) = config.sweep, table1_gyro(config)
    return [
        TrialPoint(
            name=f"sweep {n}",
            runs=sweep.skies,
            noise_px=sweep.noise_px,
            gyro=tuple((factor * bias, factor * walk) for factor in sweep.gyro_factor),
            methods=SWEPT,
            frames="all",
            stars=n,
            new_sky_each_run=True,
        )
        for n in sweep.stars
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Gain:
    """Median error of free attitudes over that of another method, by size of the gyro's noise."""

    stars_per_frame: int = col("Stars")
    acc: Sequence[Measured] = col("ACC", dims="factor")
    acc_bound: FloatArray = col("Expected", "", ".2f", "factor")
    linked: Sequence[Measured] = col("Gyro of stated noise", dims="factor")
    linked_bound: FloatArray = col("Bound", "", ".2f", "factor")
    # Of the logarithm of the gain, in standard deviations of gains that are drawn from the design of every sky
    linked_deviation_sigma: FloatArray = col("Deviation", "sigma", "+.2f", "factor", shown=False)
    linked_full_deviation_sigma: FloatArray = col(
        "Deviation for an error of 100 %", "sigma", ".1f", "factor", shown=False
    )


def gains(config: AcfConfig, trials: Mapping[str, Trials]) -> list[Gain]:
    """Ratios of the median line-of-sight errors over the skies, with errors by resampling."""
    rng, rows = np.random.default_rng(config.seed), []
    for point in sweep_points(config):
        runs = trials[point.name]
        free, free_bound = usable_line_of_sight(runs, "free"), np.median(runs.values["bound.free"][:, -1])
        resampled = rng.integers(0, len(free), (RESAMPLES, len(free)))
        gyros = range(len(point.gyro))
        measured, expected = {}, {}
        for method in ("acc", "linked"):
            measured[method] = [gain(free, usable_line_of_sight(runs, method, k), resampled) for k in gyros]
            expected[method] = np.array(
                [free_bound / np.median(runs.values[f"bound@{k}.{method}"][:, -1]) for k in gyros]
            )
        mean, sigma = np.transpose([drawn_logarithm(runs, k) for k in gyros])
        rows.append(
            Gain(
                stars_per_frame=point.stars or 0,
                acc=measured["acc"],
                acc_bound=expected["acc"],
                linked=measured["linked"],
                linked_bound=expected["linked"],
                linked_deviation_sigma=(np.log([ratio.value for ratio in measured["linked"]]) - mean) / sigma,
                linked_full_deviation_sigma=1.0 / sigma,
            )
        )
    return rows


def gain(free: FloatArray, other: FloatArray, resampled: IntArray) -> Measured:
    """Ratio of two medians, and its standard error by the bootstrap: rows of ``resampled`` number the skies."""
    ratios = np.median(free[resampled], axis=1) / np.median(other[resampled], axis=1)
    return Measured(value=float(np.median(free) / np.median(other)), uncertainty=float(ratios.std(ddof=1)))


def drawn_logarithm(trials: Trials, gyro: int) -> tuple[float, float]:
    """Mean and standard deviation of the logarithm of the gain of a gyro of stated noise, by drawn errors.

    The bootstrap would give the scatter of a few skies' medians to no better than a third, and that of the ratio is
    skewed: 1 to 5 % of the quick runs would fail.
    """
    free, linked = (np.median(trials.values[f"drawn@{gyro}.{name}"], axis=0) for name in ("free", "linked"))
    logarithm = np.log(free / linked)
    return float(logarithm.mean()), float(logarithm.std(ddof=1))


def usable_line_of_sight(trials: Trials, method: str, gyro: int | None = 0) -> FloatArray:
    """Line-of-sight error, infinite where the adjustment did not converge or has no direction for a pixel."""
    values = trials.of(method, "line_of_sight_arcsec", gyro)
    usable = (trials.of(method, "converged", gyro) > 0.5) & np.isfinite(values)
    return np.where(usable, values, np.inf)


GAIN = {
    "gain": Section(
        record=Gain,
        dim="stars",
        along="stars_per_frame",
        caption="Gain over free attitudes: ratio of the median line-of-sight errors of all skies.",
        note="Expected and bound: from the design of every sky. Standard errors from resampled skies.",
        figures={
            "gain_acc": curves(
                "stars",
                points="acc",
                lines="acc_bound",
                by="factor",
                level=1.0,
                log="xy",
                y="Gain of ACC (gyro taken as perfect)",
                aspect_ratio=0.5,
            )
        },
        verdicts=[
            agree(
                "linked_deviation_sigma",
                0.0,
                error=1.0,
                of="linked_full_deviation_sigma",
                title="gain of a gyro of stated noise against its bound",
            )
        ],
    )
}
