"""Non-linearity of the conversion, DN = K x (1 + sum_i c_i (x / full_well)^i)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def relative_gain(fraction: Any, coefficients: Sequence[Any]) -> Any:
    """Gain at a fraction of the full well, over the gain K at small signals; arrays of NumPy or Dr.Jit."""
    series = 0.0 * fraction
    for coefficient in reversed(coefficients):
        series = (series + coefficient) * fraction
    return 1.0 + series


def falling_from(coefficients: Sequence[float]) -> float | None:
    """Fraction u of the full well from which on u (1 + sum_i c_i u^i) falls; None if it rises up to 1."""
    fraction = np.linspace(0.0, 1.0, 1001)
    slope = np.polynomial.polynomial.polyval(fraction, [1.0, *((i + 2) * c for i, c in enumerate(coefficients))])
    falling = fraction[slope < 0.0]
    return float(falling[0]) if len(falling) else None
