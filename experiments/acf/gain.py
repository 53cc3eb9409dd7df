"""Gain of a gyro over free attitudes against stars per frame, and the loss by a gyro taken as perfect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.acf.settings import Config
from experiments.acf.trials import Point, Trials, table1_gyro
from experiments.harness.drawings import curves
from experiments.harness.sections import Section, agree, col
from experiments.harness.summary import Measured
from optics.arrays import FloatArray, IntArray

RESAMPLES = 300

Row = Sequence[Measured]


def sweep_points(config: Config) -> list[Point]:
    """One point per number of stars; a gyro per factor; every run has a sky of its own."""
    sweep, (bias, walk) = config.sweep, table1_gyro(config)
    return [
        Point(
            name=f"sweep {n}",
            runs=sweep.skies,
            noise_px=sweep.noise_px,
            gyro=tuple((factor * bias, factor * walk) for factor in sweep.gyro_factor),
            methods=("acc", "linked", "free"),
            frames="all",
            stars=n,
            own_sky=True,
        )
        for n in sweep.stars
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Gain:
    """Median error of free attitudes over that of another method, by size of the gyro's noise."""

    stars: int = col("Stars")
    acc: Row = col("ACC", dims="factor")
    acc_bound: FloatArray = col("Expected", "", ".2f", "factor")
    linked: Row = col("Gyro of stated noise", dims="factor")
    linked_bound: FloatArray = col("Bound", "", ".2f", "factor")
    # Of the logarithm of the gain, in standard deviations of gains that are drawn from the design of every sky
    linked_z: FloatArray = col("Deviation", "sigma", "+.2f", "factor", shown=False)
    linked_whole: FloatArray = col("Deviation for an error of 100 %", "sigma", ".1f", "factor", shown=False)


def gains(config: Config, trials: Mapping[str, Trials]) -> list[Gain]:
    """Ratios of the median line-of-sight errors over the skies, with errors by resampling."""
    rng, rows = np.random.default_rng(config.seed), []
    for point in sweep_points(config):
        runs = trials[point.name]
        free, free_bound = usable_sight(runs, "free"), runs.values["bound.free"]
        pick = rng.integers(0, len(free), (RESAMPLES, len(free)))

        factors = range(len(point.gyro))
        bounds = {method: [runs.values[f"bound@{k}.{method}"] for k in factors] for method in ("acc", "linked")}
        linked = [gain(free, usable_sight(runs, "linked", k), pick) for k in factors]
        mean, spread = np.transpose([drawn_logarithm(runs, k) for k in factors])
        rows.append(
            Gain(
                stars=point.stars or 0,
                acc=[gain(free, usable_sight(runs, "acc", k), pick) for k in factors],
                acc_bound=np.array([np.median(free_bound[:, -1]) / np.median(one[:, -1]) for one in bounds["acc"]]),
                linked=linked,
                linked_z=(np.log([one.value for one in linked]) - mean) / spread,
                linked_whole=1.0 / spread,
                linked_bound=np.array(
                    [np.median(free_bound[:, -1]) / np.median(one[:, -1]) for one in bounds["linked"]]
                ),
            )
        )
    return rows


def gain(free: FloatArray, other: FloatArray, pick: IntArray) -> Measured:
    """Ratio of two medians, its standard error from resampled skies."""
    again = np.median(free[pick], axis=1) / np.median(other[pick], axis=1)
    return Measured(value=float(np.median(free) / np.median(other)), uncertainty=float(again.std(ddof=1)))


def drawn_logarithm(trials: Trials, gyro: int) -> tuple[float, float]:
    """Mean and standard deviation of the logarithm of the gain of a gyro of stated noise, by drawn errors.

    The skies resampled would tell the scatter of a few skies' medians to no better than a third, and the ratio's is
    skewed: one quick run in twenty to a hundred failed by that.
    """
    free, linked = (np.median(trials.values[f"drawn@{gyro}.{name}"], axis=0) for name in ("free", "linked"))
    logarithm = np.log(free / linked)
    return float(logarithm.mean()), float(logarithm.std(ddof=1))


def usable_sight(trials: Trials, method: str, gyro: int | None = 0) -> FloatArray:
    """Line-of-sight error, infinite where the adjustment did not converge or has no direction for a pixel."""
    values = trials.of(method, "sight_arcsec", gyro)
    good = (trials.of(method, "converged", gyro) > 0.5) & np.isfinite(values)
    return np.where(good, values, np.inf)


GAIN = {
    "gain": Section(
        record=Gain,
        dim="stars",
        along="stars",
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
                "linked_z",
                0.0,
                error=1.0,
                of="linked_whole",
                title="gain of a gyro of stated noise against its bound",
            )
        ],
    )
}
