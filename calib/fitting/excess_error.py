"""Error beyond the stated one that residuals show."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from optics.arrays import FloatArray

CLIP_SIGMA = 5.0
LARGEST = 10.0
"""Largest value that is sought, in the unit of the residuals."""


def excess_sigma(residual: FloatArray, variance: FloatArray, *, expected: float = 1.0) -> float:
    """Standard deviation per axis to be added to all stated errors; 0 where these explain the residuals.

    With it the mean square of the standardised residuals (n, k) of k axes, outliers beyond five sigma left out, is
    ``expected``, the degrees of freedom over the number of residuals (R. C. Paule and J. Mandel, J. Res. NBS 87, 377
    (1982)); 0 as well where `LARGEST` does not reach it. ``variance`` (n,) is the stated one, mean of the axes.
    """
    axes = residual.shape[1]
    squared, stated = (residual**2).sum(axis=1), axes * variance

    def excess(sigma: float) -> float:
        total = stated + axes * sigma**2
        inside = squared < CLIP_SIGMA**2 * total
        # where all lie beyond five sigma the sought value is larger
        return float(np.mean(squared[inside] / total[inside])) - expected if inside.any() else CLIP_SIGMA**2

    return float(brentq(excess, 0.0, LARGEST)) if excess(0.0) > 0.0 > excess(LARGEST) else 0.0
