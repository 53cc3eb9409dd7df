"""Forbes' polynomials for aspheres of revolution (Forbes 2007, Opt. Express 15, 5218; 2010, Opt. Express 18, 13851).

Sums and their derivatives are evaluated from the highest order downwards (Clenshaw).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any


def qcon_sum(a: Sequence[Any], x: Any) -> tuple[Any, Any]:
    """Sum of a_m Qcon_m(x) and its derivative; Qcon_m(x) is the Jacobi polynomial P_m^(0,4)(2 x - 1)."""
    now, after, slope, slope_after = 0.0 * x, 0.0 * x, 0.0 * x, 0.0 * x
    for m in reversed(range(len(a))):
        # P_(m+1) = (u_m + v_m (2 x - 1)) P_m - w_m P_(m-1) (Abramowitz & Stegun 22.7.1)
        u, v, _ = _jacobi(m)
        _, _, w = _jacobi(m + 1)
        factor = u + v * (2.0 * x - 1.0)
        slope, slope_after = factor * slope + 2.0 * v * now - w * slope_after, slope
        now, after = a[m] + factor * now - w * after, now
    return now, slope


def _jacobi(m: int) -> tuple[float, float, float]:
    """Recurrence of the Jacobi polynomials with alpha = 0, beta = 4."""
    if m == 0:
        return -2.0, 3.0, 0.0
    s = 2 * m + 4
    below = 2 * (m + 1) * (m + 5) * s
    return -16.0 * (s + 1) / below, s * (s + 1) * (s + 2) / below, 2.0 * m * (m + 4) * (s + 2) / below


def bfs_from_q(a: Sequence[float]) -> tuple[float, ...]:
    """Coefficients of the auxiliary polynomials P_m (`bfs_sum`) of a sum of a_m Qbfs_m (Forbes 2010, A.14 ff.)."""
    count = len(a)
    if not count:
        return ()
    f, g, h = [2.0], [-0.5], []
    for m in range(1, count):
        if m >= 2:
            h.append(-m * (m - 1) / (2.0 * f[m - 2]))
        if m >= 2:
            g.append(-(1.0 + g[m - 2] * h[m - 2]) / f[m - 1])
            f.append(math.sqrt(m * (m + 1) + 3.0 - g[m - 1] ** 2 - h[m - 2] ** 2))
        else:
            f.append(math.sqrt(19.0) / 2.0)
    b = [0.0] * (count + 2)
    for m in reversed(range(count)):
        later = (g[m] * b[m + 1] if m + 1 < count else 0.0) + (h[m] * b[m + 2] if m + 2 < count else 0.0)
        b[m] = (a[m] - later) / f[m]
    return tuple(b[:count])


def bfs_sum(b: Sequence[Any], x: Any) -> tuple[Any, Any]:
    """Sum of b_m P_m(x) and its derivative; P_0 = 2, P_1 = 6 - 8 x, P_(m+1) = (2 - 4 x) P_m - P_(m-1)."""
    now, after, slope, slope_after = 0.0 * x, 0.0 * x, 0.0 * x, 0.0 * x
    factor = 2.0 - 4.0 * x
    for value in reversed(b):
        slope, slope_after = factor * slope - 4.0 * now - slope_after, slope
        now, after = value + factor * now - after, now
    return 2.0 * (now + after), 2.0 * (slope + slope_after)
