"""Error beyond the stated one that residuals show."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from optics.arrays import FloatArray

CLIP_SIGMA = 5.0


def excess_sigma(residual: FloatArray, variance: FloatArray, *, expected: float = 1.0, largest: float = 10.0) -> float:
    """Standard deviation per axis to be added to all stated errors, in the unit of the residuals.

    With it the mean square of the standardised residuals, outliers beyond five sigma left out, is ``expected`` (R. C.
    Paule and J. Mandel, J. Res. NBS 87, 377 (1982)).

    Parameters
    ----------
    residual : (n, k)
        Residuals along k axes.
    variance : (n,)
        Stated variance, mean of the axes.
    expected : float
        Degrees of freedom over the number of residuals.
    largest : float
        Largest value that is sought.

    Returns
    -------
    float
        0 where the stated errors explain the residuals, and where ``largest`` does not.
    """
    axes = residual.shape[1]
    squared, stated = (residual**2).sum(axis=1), axes * variance

    def excess(sigma: float) -> float:
        total = stated + axes * sigma**2
        inside = squared < CLIP_SIGMA**2 * total
        # where all lie beyond five sigma the sought value is larger
        return float(np.mean(squared[inside] / total[inside])) - expected if inside.any() else CLIP_SIGMA**2

    return float(brentq(excess, 0.0, largest)) if excess(0.0) > 0.0 > excess(largest) else 0.0
