"""How often the confidence interval holds the truth: where its assumptions hold, and where they do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from calib.directional.fisher import mean_and_chords, sample_fisher, tangent_basis
from experiments.fisher.settings import CoverageConfig
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD
from render.engine.random import Streams

__all__ = ["DISTRIBUTIONS", "LEVELS", "CoveragePoint", "coverage", "true_sigma"]


LEVELS = (0.6827, 0.95)
SIGMA_ARCSEC = 0.5
ANISOTROPY = 3.0
OUTLIERS, OUTLIER_SIGMAS = 0.02, 4.0
MODERATE_K = 20.0
MEAN = np.array([0.36, -0.48, 0.8])
DISTRIBUTIONS = {
    "fisher": "Fisher distribution",
    "moderate": f"Fisher distribution, k = {MODERATE_K:g}",
    "ellipse": f"ellipse, axes {ANISOTROPY:g} : 1",
    "tails": f"{OUTLIERS:.0%} of the vectors with {OUTLIER_SIGMAS:g} times the noise",
}
"""Distributions that are tried: key -> words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoveragePoint:
    """Samples of one distribution and size."""

    kind: str  # Key of `DISTRIBUTIONS`
    count: int  # Vectors per sample
    covered: tuple[float, ...]  # Share of intervals that hold the true sigma, for each of `LEVELS`
    error: tuple[float, ...]  # Standard deviation of that share by the number of runs, at the nominal level
    # The same with the degrees of freedom that the vectors themselves show
    # (`calib.directional.fisher_checks.effective_degrees`)
    covered_effective: tuple[float, ...]
    bias: float  # Mean of the estimated variance over the true one, minus 1
    bias_error: float  # Its standard error


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
    truth, nu, runs = true_sigma(kind), 2.0 * (count - 1), len(chord2)
    relative = chord2.sum(1) / nu / truth**2
    effective = nu * chord2.mean(1) ** 2 / chord2.var(1, ddof=1)
    plain, wide, error = [], [], []
    for level in LEVELS:
        plain.append(_share(relative, np.full(runs, nu), level))
        wide.append(_share(relative, effective, level))
        error.append(float(np.sqrt(level * (1 - level) / runs)))
    return CoveragePoint(
        kind=kind,
        count=count,
        covered=tuple(plain),
        error=tuple(error),
        covered_effective=tuple(wide),
        bias=float(relative.mean() - 1.0),
        bias_error=float(relative.std(ddof=1) / np.sqrt(runs)),
    )


def _share(relative: FloatArray, nu: FloatArray, level: float) -> float:
    """Share of intervals that hold the truth, by estimated over true variance and degrees of freedom."""
    low, high = chi2.ppf([[(1 - level) / 2], [(1 + level) / 2]], nu) / nu
    return float(np.mean((low <= relative) & (relative <= high)))
