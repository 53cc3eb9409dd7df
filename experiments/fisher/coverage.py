"""How often the confidence interval holds the truth: where its assumptions hold, and where they do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from calib.directional.fisher import mean_and_chords, sample_fisher, tangent_basis
from experiments.fisher.settings import CoverageConfig
from experiments.harness.drawings import curves
from experiments.harness.sections import Section, agree, col
from experiments.harness.summary import Measured, measured
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD
from render.engine.random import Streams

LEVELS = (0.6827, 0.95)
SIGMA_ARCSEC = 0.5
ANISOTROPY = 3.0
OUTLIERS, OUTLIER_SIGMAS = 0.02, 4.0
MODERATE_K = 20.0
MEAN = np.array([0.36, -0.48, 0.8])
DISTRIBUTIONS = {
    "fisher": "Fisher",
    "moderate": f"Fisher, k = {MODERATE_K:g}",
    "ellipse": f"ellipse {ANISOTROPY:g} : 1",
    "tails": f"{100 * OUTLIERS:g} % of {OUTLIER_SIGMAS:g} σ",
}
"""Distributions that are tried: key -> words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoveragePoint:
    """Samples of one distribution and size; shares with their standard deviation by the number of runs."""

    kind: str = col("Key", shown=False)  # Of `DISTRIBUTIONS`
    distribution: str = col("Distribution", json="")
    count: int = col("Vectors")
    covered: Any = col("Held,", "", ".3f", "level", json_error="error")
    # By the degrees of freedom that the vectors themselves show (`calib.directional.fisher_checks.effective_degrees`)
    covered_effective: FloatArray = col("ν from scatter,", "", ".3f", "level")
    # The level, of the Fisher distribution, which the interval is made for; NaN of the others
    nominal: FloatArray = col("Level", dims="level", json="", shown=False)
    bias: Measured = col("bias of σ²", json_error="bias_error")  # Mean of the estimates over the truth, less 1


def true_sigma(kind: str) -> float:
    """Root of the mean squared angle per axis of a distribution [rad]; 1/sqrt(k) of a Fisher distribution."""
    if kind == "moderate":
        return MODERATE_K**-0.5
    sigma = SIGMA_ARCSEC * ARCSEC_RAD
    if kind == "ellipse":
        return sigma * float(np.sqrt((1 + ANISOTROPY**2) / 2))
    if kind == "tails":
        return sigma * float(np.sqrt(1 + OUTLIERS * (OUTLIER_SIGMAS**2 - 1)))
    return sigma


def _draw(kind: str, runs: int, count: int, rng: np.random.Generator) -> FloatArray:
    """Samples (runs, count, 3)."""
    sigma = SIGMA_ARCSEC * ARCSEC_RAD
    if kind in ("fisher", "moderate"):
        return sample_fisher(MEAN, true_sigma(kind) ** -2, runs * count, rng).reshape(runs, count, 3)
    scale = np.full((runs, count, 2), sigma)
    if kind == "ellipse":
        scale[..., 0] *= ANISOTROPY
    else:
        scale *= np.where(rng.random((runs, count, 1)) < OUTLIERS, OUTLIER_SIGMAS, 1.0)
    off = rng.standard_normal((runs, count, 2)) * scale
    vectors = MEAN + off @ tangent_basis(MEAN)
    return np.asarray(vectors / np.linalg.norm(vectors, axis=2, keepdims=True))


def coverage(config: CoverageConfig, streams: Streams, *, advance: Callable[[], None]) -> list[CoveragePoint]:
    """Draw, estimate, count."""
    points = []
    for kind in DISTRIBUTIONS:
        for count in config.counts:
            rng = streams.child("coverage", kind).generator("vectors", count)
            vectors = _draw(kind, config.runs, count, rng)
            points.append(_point(kind, count, mean_and_chords(vectors)[1]))
            advance()
    return points


def _point(kind: str, count: int, chord2: FloatArray) -> CoveragePoint:
    nu, runs, levels = 2.0 * (count - 1), len(chord2), np.array(LEVELS)
    relative = chord2.sum(1) / nu / true_sigma(kind) ** 2
    effective = nu * chord2.mean(1) ** 2 / chord2.var(1, ddof=1)
    shares = [_share(relative, np.full(runs, nu), level) for level in LEVELS]
    error = float(relative.std(ddof=1) / np.sqrt(runs))
    return CoveragePoint(
        kind=kind,
        distribution=DISTRIBUTIONS[kind],
        count=count,
        covered=measured(shares, np.sqrt(levels * (1 - levels) / runs)),
        covered_effective=np.array([_share(relative, effective, level) for level in LEVELS]),
        nominal=levels if kind in ("fisher", "moderate") else np.full(len(LEVELS), np.nan),
        bias=Measured(value=float(relative.mean() - 1.0), uncertainty=error),
    )


def _share(relative: FloatArray, nu: FloatArray, level: float) -> float:
    """Share of intervals that hold the truth, by estimated over true variance and degrees of freedom."""
    low, high = chi2.ppf([[(1 - level) / 2], [(1 + level) / 2]], nu) / nu
    return float(np.mean((low <= relative) & (relative <= high)))


COVERAGE = Section(
    record=CoveragePoint,
    dim="sample",
    prefix="coverage_",
    place="coverage[sample]",
    axes=lambda q, _: q.axis("level", LEVELS, "Confidence", names=[f"{100 * level:.0f} %" for level in LEVELS]),
    table="coverage",
    across="level",
    hidden="sample",
    caption="Part of the intervals that hold the true σ.",
    note="Ellipse: of the noise. Last: vectors of that part with that noise. "
    "ν from scatter: degrees of freedom from the scatter of the squared chords themselves. Bias: relative.",
    figures={
        "coverage_plot": curves(
            "coverage_count",
            points="coverage_covered",
            lines="coverage_nominal",
            by="coverage_distribution",
            panels="level",
            log="x",
            y="Intervals that hold the truth",
        )
    },
    verdicts=[agree("coverage_covered", with_="coverage_nominal", title="intervals that hold the truth, Fisher")],
)
