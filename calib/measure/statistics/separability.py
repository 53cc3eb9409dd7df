"""Separability of two kinds of star images: features of windows, logistic regression, cross-validated ROC area.

An area under the ROC curve of 0.5 is chance, 1 complete separation. Groups are left out in turn, so that no star is in
training and test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import mannwhitneyu
from skimage.measure import moments_central, moments_hu

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError

HALF_PX = 5
RIDGE, FOLDS, RESAMPLED, CLIP_SIGMA = 1.0, 4, 200, 5.0
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


def window_features(dn: FloatArray, position_px: FloatArray) -> FloatArray:
    """`FEATURES` (m, 10) of windows of 11 px about the stars at (n, 2) that lie in a frame (h, w) and have light."""
    height, width = dn.shape
    features = []
    for x, y in np.rint(position_px).astype(int):
        if not (HALF_PX <= x < width - HALF_PX and HALF_PX <= y < height - HALF_PX):
            continue
        window = dn[y - HALF_PX : y + HALF_PX + 1, x - HALF_PX : x + HALF_PX + 1]
        rim = np.ones(window.shape, bool)
        rim[2:-2, 2:-2] = False
        level = float(np.median(window[rim]))
        light = window - level
        total = float(light[2:-2, 2:-2].sum())
        if total <= 0.0:
            continue
        core = np.maximum(light[2:-2, 2:-2], 0.0)
        moments = moments_central(core) / core.sum()
        first_row = window[0] - level
        features.append(
            [
                core.max() / total,
                light[4:7, 4:7].sum() / total,
                light[3:8, 3:8].sum() / total,
                moments[0, 2],
                moments[2, 0],
                moments[1, 1],
                float(np.log(abs(moments_hu(moments)[0]) + 1e-12)),
                np.log((window[rim] - level).std() + 1e-6),
                float(np.mean(first_row[1:] * first_row[:-1]) / (first_row.var() + 1e-9)),
                level,
            ]
        )
    return np.array(features, float).reshape(-1, len(FEATURES))


@dataclass(frozen=True, slots=True, kw_only=True)
class Separability:
    """Separability of two kinds of images."""

    area: float  # Under the ROC curve
    error: float  # Standard deviation, by bootstrap
    first: int  # Images of the first kind
    effect: FloatArray  # (f,) Difference of the means over the standard deviation, second kind minus first


def separability(features: FloatArray, kind: IntArray, group: IntArray) -> Separability:
    """Logistic regression of features (n, f) of kinds 0 and 1 (n,), cross-validated over four folds of groups (n,).

    Raises
    ------
    DomainError
        If a kind is missing.
    """
    if len(np.unique(kind)) != 2:
        raise DomainError("separability: samples of both kinds, 0 and 1, are needed")
    middle, spread = np.median(features, axis=0), features.std(axis=0) + 1e-12
    z = np.clip((features - middle) / spread, -CLIP_SIGMA, CLIP_SIGMA)
    score = np.zeros(len(kind))
    for fold in np.unique(group % FOLDS):
        test = group % FOLDS == fold
        if len(np.unique(kind[~test])) == 2:
            score[test] = z[test] @ _logistic_weights(z[~test], kind[~test])[1:]
    rng = np.random.default_rng(1)
    draws = [rng.integers(len(kind), size=len(kind)) for _ in range(RESAMPLED)]
    areas = [roc_area(score[rows], kind[rows]) for rows in draws if 0 < kind[rows].sum() < len(rows)]
    pooled = np.sqrt((z[kind == 0].var(axis=0) + z[kind == 1].var(axis=0)) / 2.0) + 1e-12
    effect = (z[kind == 1].mean(axis=0) - z[kind == 0].mean(axis=0)) / pooled
    return Separability(
        area=roc_area(score, kind), error=float(np.std(areas)), first=int((kind == 0).sum()), effect=effect
    )


def _logistic_weights(z: FloatArray, kind: NDArray[np.integer]) -> FloatArray:
    """Intercept and weights with a ridge on the weights."""
    design = np.column_stack([np.ones(len(z)), z])

    def loss(w: FloatArray) -> tuple[float, FloatArray]:
        t = design @ w
        value = float(np.logaddexp(0.0, t).sum() - t[kind == 1].sum() + 0.5 * RIDGE * (w[1:] ** 2).sum())
        slope = design.T @ (expit(t) - kind)
        slope[1:] += RIDGE * w[1:]
        return value, slope

    return np.asarray(minimize(loss, np.zeros(design.shape[1]), jac=True, method="L-BFGS-B").x)


def roc_area(score: FloatArray, kind: NDArray[np.integer]) -> float:
    """Area under the ROC curve: probability that the second kind scores higher (Mann and Whitney's U)."""
    second, first = score[kind == 1], score[kind == 0]
    return float(mannwhitneyu(second, first, method="asymptotic").statistic / (len(second) * len(first)))
