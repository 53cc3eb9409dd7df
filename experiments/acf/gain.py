"""Gain by a gyro against the number of stars per frame, and the loss where ACC takes a noisy gyro as error-free.

Gain: median line-of-sight error of calibrations with an independent attitude in every frame over that of calibrations
with the gyro (ACC, attitude-correlated calibration, or "linked", least squares that weight the gyro by its noise).
"""

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
    """One point per number of stars; one gyro per factor of Table 1's noise; another sky in every run."""
    sweep = config.sweep
    bias, walk = table1_gyro(config)
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
    """Median error of independent attitudes over that of a method with a gyro, by size of the gyro's noise."""

    stars_per_frame: int = col("Stars")
    acc: Sequence[Measured] = col("ACC", dims="factor")
    acc_expected: FloatArray = col("Expected", "", ".2f", "factor")
    linked: Sequence[Measured] = col("Gyro weighted by its noise", dims="factor")
    linked_expected: FloatArray = col("Expected", "", ".2f", "factor")
    # z = (ln(measured gain) - mean) / sigma, with mean and sigma of ln(gain) from `sampled_log_gain`
    linked_log_gain_z: FloatArray = col("Deviation", "sigma", "+.2f", "factor", shown=False)
    # A unit of ln(gain), an error of 100 % to first order, over its sigma
    linked_log_gain_unit_z: FloatArray = col("Deviation for an error of 100 %", "sigma", ".1f", "factor", shown=False)


def gain_by_stars(config: AcfConfig, trials: Mapping[str, Trials]) -> list[Gain]:
    """Ratios of the median line-of-sight errors over the skies, with standard errors by the bootstrap."""
    rng = np.random.default_rng(config.seed)
    rows = []
    for point in sweep_points(config):
        runs = trials[point.name]
        free = usable_line_of_sight(runs, "free")
        resampled = rng.integers(0, len(free), (RESAMPLES, len(free)))
        gyros = range(len(point.gyro))
        measured, expected = {}, {}
        for method in ("acc", "linked"):
            measured[method] = [median_ratio(free, usable_line_of_sight(runs, method, k), resampled) for k in gyros]
            expected[method] = np.array([predicted_gain(runs, method, k) for k in gyros])
        mean, sigma = np.transpose([sampled_log_gain(runs, k) for k in gyros])
        rows.append(
            Gain(
                stars_per_frame=point.stars or 0,
                acc=measured["acc"],
                acc_expected=expected["acc"],
                linked=measured["linked"],
                linked_expected=expected["linked"],
                linked_log_gain_z=(np.log([ratio.value for ratio in measured["linked"]]) - mean) / sigma,
                linked_log_gain_unit_z=1.0 / sigma,
            )
        )
    return rows


def predicted_gain(trials: Trials, method: str, gyro: int) -> float:
    """Ratio of the medians over the skies of the line-of-sight errors predicted by covariances."""
    free, other = (np.median(trials.of(name, "predicted_arcsec", gyro)) for name in ("free", method))
    return float(free / other)


def median_ratio(free: FloatArray, other: FloatArray, resampled: IntArray) -> Measured:
    """Ratio of two medians, and its standard error by the bootstrap: rows of ``resampled`` are indices of skies."""
    ratios = np.median(free[resampled], axis=1) / np.median(other[resampled], axis=1)
    return Measured(value=float(np.median(free) / np.median(other)), uncertainty=float(ratios.std(ddof=1)))


def sampled_log_gain(trials: Trials, gyro: int) -> tuple[float, float]:
    """Mean and sigma of ln(gain) with a gyro weighted by its noise, from errors sampled from the covariances.

    A bootstrap of the few skies would give sigma to no better than a third, and the ratio of medians is skewed: 1 to
    5 % of the quick runs would fail.
    """
    free, linked = (
        np.median(trials.of("linked", quantity, gyro), axis=0) for quantity in ("sampled_free_arcsec", "sampled_arcsec")
    )
    log_gain = np.log(free / linked)
    return float(log_gain.mean()), float(log_gain.std(ddof=1))


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
        caption="Gain over independent attitudes: ratio of the median line-of-sight errors of all skies.",
        note="Expected: from the covariances of every sky. Standard errors by the bootstrap over the skies.",
        figures={
            "gain_acc": curves(
                "stars",
                points="acc",
                lines="acc_expected",
                by="factor",
                level=1.0,
                log="xy",
                y="Gain of ACC (gyro taken as error-free)",
                aspect_ratio=0.5,
            )
        },
        verdicts=[
            agree(
                "linked_log_gain_z",
                0.0,
                error=1.0,
                of="linked_log_gain_unit_z",
                title="gain with a gyro weighted by its noise, against its expectation",
            )
        ],
    )
}
