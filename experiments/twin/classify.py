"""Separability of real and rendered stars: features of star windows, logistic regression, cross-validated area.

The same stars in the same attitudes: an area under the ROC curve of 0.5 is chance, 1 complete separation. Frames are
left out in turn, so that no star is in training and test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import rankdata
from skimage.measure import moments_central, moments_hu

from calib.records import SensorImage
from experiments.twin.compare import FrameStats
from optics.arrays import FloatArray

HALF_PX = 5
RIDGE = 1.0
RESAMPLED = 200
FEATURES = (
    "share of the brightest pixel",
    "share of 3 x 3 px",
    "share of 5 x 5 px",
    "moment along columns",
    "moment along rows",
    "mixed moment",
    "first invariant of Hu",
    "noise of the rim",
    "correlation of the rim's neighbours",
    "level of the rim",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """Separability of real and rendered stars."""

    area: float  # Under the ROC curve; 0.5: not at all
    error: float  # Standard deviation, stars drawn again
    stars: int
    effect: FloatArray  # (features,) Mean difference over the standard deviation, rendered minus real


def tell_apart(
    real: Sequence[tuple[SensorImage, FrameStats]], rendered: Sequence[tuple[SensorImage, FrameStats]], faintest: float
) -> Told | None:
    """Compare windows about the bright stars of real and rendered frames; None where there are too few."""
    rows, label, frame = [], [], []
    for kind, frames in enumerate((real, rendered)):
        for number, (image, stats) in enumerate(frames):
            found = _features(image, stats.place_px[stats.star_magnitude < faintest])
            rows.append(found)
            label.append(np.full(len(found), kind))
            frame.append(np.full(len(found), number))
    x, y, group = np.concatenate(rows), np.concatenate(label), np.concatenate(frame)
    good = np.isfinite(x).all(axis=1)
    x, y, group = x[good], y[good], group[good]
    if min((y == 0).sum(), (y == 1).sum()) < 30:
        return None
    middle, spread = np.median(x, axis=0), x.std(axis=0) + 1e-12
    z = np.clip((x - middle) / spread, -5.0, 5.0)
    score = np.zeros(len(y))
    for part in np.unique(group % 4):
        test = group % 4 == part
        if len(np.unique(y[~test])) < 2:
            continue
        score[test] = z[test] @ _logistic(z[~test], y[~test])[1:]
    rng = np.random.default_rng(1)
    drawn = [rng.integers(len(y), size=len(y)) for _ in range(RESAMPLED)]
    areas = [_area(score[one], y[one]) for one in drawn if 0 < y[one].sum() < len(one)]
    pooled = np.sqrt((z[y == 0].var(axis=0) + z[y == 1].var(axis=0)) / 2.0) + 1e-12
    return Told(
        area=_area(score, y),
        error=float(np.std(areas)),
        stars=int((y == 0).sum()),
        effect=(z[y == 1].mean(axis=0) - z[y == 0].mean(axis=0)) / pooled,
    )


def _features(image: SensorImage, place_px: FloatArray) -> FloatArray:
    height, width = image.dn.shape
    out = []
    for x, y in np.rint(place_px).astype(int):
        if not (HALF_PX <= x < width - HALF_PX and HALF_PX <= y < height - HALF_PX):
            continue
        cut = image.dn[y - HALF_PX : y + HALF_PX + 1, x - HALF_PX : x + HALF_PX + 1]
        rim = np.ones(cut.shape, bool)
        rim[2:-2, 2:-2] = False
        level = float(np.median(cut[rim]))
        light = cut - level
        total = float(light[2:-2, 2:-2].sum())
        if total <= 0.0:
            continue
        core = np.maximum(light[2:-2, 2:-2], 0.0)
        moments = moments_central(core) / core.sum()
        noise = cut[rim] - level
        mean = cut[0] - level
        out.append(
            [
                core.max() / total,
                light[4:7, 4:7].sum() / total,
                light[3:8, 3:8].sum() / total,
                moments[0, 2],
                moments[2, 0],
                moments[1, 1],
                float(np.log(abs(moments_hu(moments)[0]) + 1e-12)),
                np.log(noise.std() + 1e-6),
                float(np.mean(mean[1:] * mean[:-1]) / (mean.var() + 1e-9)),
                level,
            ]
        )
    return np.array(out, float).reshape(-1, len(FEATURES))


def _logistic(z: FloatArray, y: NDArray[np.integer]) -> FloatArray:
    """Intercept and weights with a ridge on the weights."""
    design = np.column_stack([np.ones(len(z)), z])

    def loss(w: FloatArray) -> tuple[float, FloatArray]:
        t = design @ w
        value = float(np.logaddexp(0.0, t).sum() - t[y == 1].sum() + 0.5 * RIDGE * (w[1:] ** 2).sum())
        slope = design.T @ (1.0 / (1.0 + np.exp(-t)) - y)
        slope[1:] += RIDGE * w[1:]
        return value, slope

    return np.asarray(minimize(loss, np.zeros(design.shape[1]), jac=True, method="L-BFGS-B").x)


def _area(score: FloatArray, y: NDArray[np.integer]) -> float:
    """Area under the ROC curve by ranks (Mann and Whitney)."""
    ones = int((y == 1).sum())
    ranks = rankdata(score)
    return float((ranks[y == 1].sum() - ones * (ones + 1) / 2.0) / (ones * (len(y) - ones)))
