"""Numbers of an evaluation: solved share, attitude errors, completeness, centroid errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from astropy.stats import binom_conf_interval
from numpy.typing import NDArray

from experiments.dataset.detection import FoundStars
from experiments.dataset.evaluate import Evaluation
from experiments.dataset.solve import SolvedFrame
from optics.arrays import FloatArray

__all__ = ["CentroidBins", "Completeness", "Solver", "centroid_bins", "completeness", "solver"]


FEWEST_IN_BIN = 8
ROBUST_SIGMA = 1.4826
"""Median absolute deviation to standard deviation of a normal distribution."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Solver:
    """What the solver reached.

    Attributes
    ----------
    attempted, solved, mirrored, wrong : int
        Frames; mirrored and wrong ones are not solved.
    median_arcsec, p95_arcsec, largest_arcsec : float
        Boresight error of the solved ones.
    median_error_arcsec : float
        Standard error of the median.
    roll_median_arcsec : float
        Median of the absolute roll error.
    equal_median_arcsec : float
        Median boresight error with equal weights.
    sigma_arcsec : float
        Median of the predicted length of the boresight error.
    pull : (3,)
        Root mean square of error over predicted sigma.
    """

    attempted: int
    solved: int
    mirrored: int
    wrong: int
    median_arcsec: float
    median_error_arcsec: float
    p95_arcsec: float
    largest_arcsec: float
    roll_median_arcsec: float
    equal_median_arcsec: float
    sigma_arcsec: float
    pull: FloatArray

    @property
    def parity_ok(self) -> bool:
        """Whether no frame matched a mirrored sky."""
        return self.mirrored == 0


def solver(frames: tuple[SolvedFrame, ...]) -> Solver:
    """Statistics of solved frames; NaN where none was solved."""
    good = [one for one in frames if one.solved]
    error = np.array([one.error_arcsec for one in good]).reshape(-1, 3)
    sigma = np.array([one.sigma_arcsec for one in good]).reshape(-1, 3)
    equal = np.array([one.equal_error_arcsec for one in good]).reshape(-1, 3)
    off = np.hypot(error[:, 0], error[:, 1])
    nothing = float("nan")
    spread = 1.2533 * ROBUST_SIGMA * float(np.median(np.abs(off - np.median(off)))) if len(off) else nothing
    return Solver(
        attempted=len(frames),
        solved=len(good),
        mirrored=sum(one.mirrored for one in frames),
        wrong=sum(one.status == "wrong" for one in frames),
        median_arcsec=float(np.median(off)) if len(off) else nothing,
        median_error_arcsec=spread / np.sqrt(len(off)) if len(off) else nothing,
        p95_arcsec=float(np.quantile(off, 0.95)) if len(off) else nothing,
        largest_arcsec=float(off.max()) if len(off) else nothing,
        roll_median_arcsec=float(np.median(np.abs(error[:, 2]))) if len(off) else nothing,
        equal_median_arcsec=float(np.median(np.hypot(equal[:, 0], equal[:, 1]))) if len(off) else nothing,
        sigma_arcsec=float(np.median(np.hypot(sigma[:, 0], sigma[:, 1]))) if len(off) else nothing,
        pull=np.sqrt(np.mean((error / sigma) ** 2, axis=0)) if len(off) else np.full(3, nothing),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Completeness:
    """Share of the stars that are found, in bins.

    Attributes
    ----------
    edges : (k + 1,)
        Of the bins.
    stars, found : (k,) int64
        In every bin.
    share, low, high : (k,)
        Share and its interval of 68.3 % (Wilson); NaN in empty bins.
    """

    edges: FloatArray
    stars: NDArray[np.int64]
    found: NDArray[np.int64]
    share: FloatArray
    low: FloatArray
    high: FloatArray

    @property
    def middle(self) -> FloatArray:
        """Of the bins."""
        return np.asarray((self.edges[1:] + self.edges[:-1]) / 2)


def completeness(stars: FoundStars, value: FloatArray, edges: FloatArray) -> Completeness:
    """Completeness against a value per star; stars that lie beside the detector's edge do not count."""
    inside = ~stars.has("off_edge")
    total, _ = np.histogram(value[inside], edges)
    found, _ = np.histogram(value[inside & stars.found], edges)
    share, low, high = (np.full(len(total), np.nan) for _ in range(3))
    some = total > 0
    share[some] = found[some] / total[some]
    low[some], high[some] = binom_conf_interval(found[some], total[some], interval="wilson")
    return Completeness(edges=edges, stars=total, found=found, share=share, low=low, high=high)


@dataclass(frozen=True, slots=True, kw_only=True)
class CentroidBins:
    """Centroid errors of undisturbed stars against signal-to-noise ratio.

    Attributes
    ----------
    snr : (k,)
        Median of each bin.
    error_px : (k,)
        Robust standard deviation per axis.
    error_sigma_px : (k,)
        Its own standard error.
    bound_px : (k,)
        Median of the stars' Cramer-Rao bounds, each at its own place on the pixels.
    ratio : (k,)
        Robust standard deviation of each star's error over its own bound.
    stars : (k,) int64
        In each bin.
    """

    snr: FloatArray
    error_px: FloatArray
    error_sigma_px: FloatArray
    bound_px: FloatArray
    ratio: FloatArray
    stars: NDArray[np.int64]


def centroid_bins(evaluation: Evaluation, *, bins_per_decade: int = 6) -> CentroidBins:
    """Errors of the stars that no flag, of truth or measurement, speaks against."""
    stars = evaluation.stars
    good = stars.clean & stars.fit & np.isfinite(stars.error_px).all(axis=1) & (stars.snr > 0)
    snr, error = stars.snr[good], stars.error_px[good]
    bound = evaluation.bound.at(stars.electrons[good], stars.position_px[good], stars.radius_px[good])
    number = np.floor(np.log10(snr) * bins_per_decade).astype(int)
    rows = []
    for one in np.unique(number):
        mine = number == one
        count = int(mine.sum())
        if count < FEWEST_IN_BIN:
            continue
        off = error[mine] - np.median(error[mine], axis=0)
        spread = ROBUST_SIGMA * float(np.median(np.abs(off)))
        ratio = ROBUST_SIGMA * float(np.median(np.abs(off / bound[mine])))
        # variance of the median absolute deviation of 2 n normal values: 1.3604 sigma^2 / (2 n)
        uncertainty = spread * np.sqrt(1.3604 / (2 * count))
        rows.append((np.median(snr[mine]), spread, uncertainty, np.median(bound[mine]), ratio, count))
    columns = np.array(rows, float).reshape(-1, 6).T
    return CentroidBins(
        snr=columns[0],
        error_px=columns[1],
        error_sigma_px=columns[2],
        bound_px=columns[3],
        ratio=columns[4],
        stars=columns[5].astype(np.int64),
    )
