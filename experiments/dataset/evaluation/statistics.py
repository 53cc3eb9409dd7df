"""Statistics of an evaluation: solved share, attitude errors, completeness, false detections, blends, centroids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from astropy.stats import binom_conf_interval
from numpy.typing import NDArray

from experiments.dataset.evaluation.detection import FoundStars
from experiments.dataset.evaluation.evaluate import Evaluation
from experiments.dataset.evaluation.solve import SolvedFrame
from optics.arrays import FloatArray

__all__ = [
    "BOUND_SNR",
    "BRIGHT_SNR",
    "CentroidBins",
    "Completeness",
    "SolverStatistics",
    "bound_ratio",
    "centroid_bins",
    "completeness",
    "even_edges",
    "false_excess",
    "magnitude_of_half",
    "mean_of",
    "solver_statistics",
]


BRIGHT_SNR = 10.0
"""From here on a star that nothing disturbs is detected."""
BOUND_SNR = (8.0, 25.0)
"""Between these noise alone decides: below, only stars that the noise helped are seen; above, colours and response."""
FEWEST_IN_BIN = 8
FEWEST_FOR_HALF = 5
"""Stars in a bin of magnitude for its share to count."""
ROBUST_SIGMA = 1.4826
"""Median absolute deviation to standard deviation of a normal distribution."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverStatistics:
    """What the solver reached."""

    attempted: int  # Frames; mirrored and wrong ones are not solved
    solved: int  # Frames; mirrored and wrong ones are not solved
    mirrored: int  # Frames; mirrored and wrong ones are not solved
    wrong: int  # Frames; mirrored and wrong ones are not solved
    median_arcsec: float  # Boresight error of the solved ones
    median_error_arcsec: float  # Standard error of the median
    p95_arcsec: float  # Boresight error of the solved ones
    largest_arcsec: float  # Boresight error of the solved ones
    roll_median_arcsec: float  # Median of the absolute roll error
    equal_median_arcsec: float  # Median boresight error with equal weights
    sigma_arcsec: float  # Median of the predicted length of the boresight error
    pull: FloatArray  # (3,) Root mean square of error over predicted sigma

    @property
    def parity_ok(self) -> bool:
        """Whether no frame matched a mirrored sky."""
        return self.mirrored == 0


def solver_statistics(frames: tuple[SolvedFrame, ...]) -> SolverStatistics:
    """Statistics of solved frames; NaN where none was solved."""
    good = [one for one in frames if one.solved]
    error = np.array([one.error_arcsec for one in good]).reshape(-1, 3)
    sigma = np.array([one.sigma_arcsec for one in good]).reshape(-1, 3)
    equal = np.array([one.equal_error_arcsec for one in good]).reshape(-1, 3)
    off = np.hypot(error[:, 0], error[:, 1])
    nothing = float("nan")
    spread = 1.2533 * ROBUST_SIGMA * float(np.median(np.abs(off - np.median(off)))) if len(off) else nothing
    return SolverStatistics(
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
    """Share of the stars that are found, in bins."""

    edges: FloatArray  # (k + 1,) Of the bins
    stars: NDArray[np.int64]  # (k,) In every bin
    found: NDArray[np.int64]  # (k,) In every bin
    share: FloatArray  # (k,) Share and its interval of 68.3 % (Wilson); NaN in empty bins
    low: FloatArray  # (k,) Share and its interval of 68.3 % (Wilson); NaN in empty bins
    high: FloatArray  # (k,) Share and its interval of 68.3 % (Wilson); NaN in empty bins

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


def even_edges(values: FloatArray, step: float) -> FloatArray:
    """Edges of bins of equal width from the whole number below the smallest value; two of them hold no values."""
    if not len(values):
        return np.array([0.0, step])
    return np.arange(np.floor(values.min()), values.max() + step, step)


def magnitude_of_half(curve: Completeness) -> float:
    """Magnitude where a completeness falls below one half for good; NaN where it never does."""
    enough = curve.stars >= FEWEST_FOR_HALF
    middle, share = curve.middle[enough], curve.share[enough]
    above = np.flatnonzero(share >= 0.5)
    if not len(above) or above[-1] + 1 >= len(share):
        return float("nan")
    k = int(above[-1])
    return float(np.interp(0.5, [share[k + 1], share[k]], [middle[k + 1], middle[k]]))


def mean_of(values: NDArray[np.bool_], which: NDArray[np.bool_]) -> float:
    """Share of the chosen stars for which something holds; NaN where none is chosen."""
    return float(values[which].mean()) if which.any() else float("nan")


def false_excess(evaluation: Evaluation) -> float:
    """False detections per frame less those of empty frames, in standard deviations of both counts."""
    stars = evaluation.stars
    mine, empty = int((~stars.false_spike).sum()), evaluation.empty_detections
    spread = np.sqrt((mine + 1) / stars.frames**2 + (empty + 1) / evaluation.empty_frames**2)
    return float((mine / stars.frames - empty / evaluation.empty_frames) / spread)


@dataclass(frozen=True, slots=True, kw_only=True)
class CentroidBins:
    """Centroid errors of undisturbed stars against signal-to-noise ratio."""

    snr: FloatArray  # (k,) Median of each bin
    error_px: FloatArray  # (k,) Robust standard deviation per axis
    error_sigma_px: FloatArray  # (k,) Its own standard error
    bound_px: FloatArray  # (k,) Median of the stars' Cramer-Rao bounds, each at its own place on the pixels
    ratio: FloatArray  # (k,) Robust standard deviation of each star's error over its own bound
    stars: NDArray[np.int64]  # (k,) In each bin


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


def bound_ratio(bins: CentroidBins) -> tuple[float, int]:
    """Mean ratio of error and bound where noise alone decides (`BOUND_SNR`), and the number of stars behind it."""
    inside = (bins.snr >= BOUND_SNR[0]) & (bins.snr <= BOUND_SNR[1])
    count = int(bins.stars[inside].sum())
    return (float(np.average(bins.ratio[inside], weights=bins.stars[inside])) if count else float("nan")), count
