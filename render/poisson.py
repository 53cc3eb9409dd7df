"""Exact Poisson variates on Dr.Jit arrays, one per pixel, from counters.

Small means: sequential inversion. With u uniform in (0, 1), the variate is the smallest k with F(k) >= u. Instead of
summing probabilities the rest is carried in units of the current one, w_0 = u exp(mu), w_k = (w_{k-1} - 1) k / mu,
until w_k <= 1: one subtraction and two products per step, no division, and the rounding error of each step is 1e-16 of
the tail that remains.

Large means: transformed rejection with squeeze, algorithm PTRS of Hoermann (1993), Insurance: Mathematics and
Economics 12, 39-45, valid from a mean of 10 on. Attempt t takes its two uniforms from counter (pixel, t, 0, 0).

Neither is an approximation; both run in float64 on uniforms of 52 bits. The means are taken apart at
`INVERSION_LIMIT`, where the two cost about the same.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from render.philox import philox4x32, uniform64

__all__ = ["INVERSION_LIMIT", "poisson"]

INVERSION_LIMIT = 30.0
# Reached with a probability of 1e-80 at the largest mean of the branch; ends the loop if rounding leaves a rest.
_INVERSION_STEPS = 200.0
_UNROLLED = 4  # 1.6 times as fast as testing after every step
_HALF_LOG_TWO_PI = 0.9189385332046727


def poisson(types: Any, mean: Any, pixel: Any, key: tuple[Any, Any]) -> Any:
    """Poisson variates.

    Parameters
    ----------
    types : module
        ``drjit.llvm`` or ``drjit.cuda``.
    mean : Float32 or Float64 (n,)
        Means, 0 to 1e8.
    pixel : UInt32 (n,)
        Index of each pixel in the whole detector: the counter.
    key : 2 UInt32
        Key of the stream; scalars or (n,).

    Returns
    -------
    Float64 (n,)
        Whole numbers.
    """
    mean = types.Float64(mean)
    small = mean < INVERSION_LIMIT
    words = philox4x32(types, (pixel, 0, 0, 0), key)
    few = _inversion(types, mean, uniform64(types, words[1], words[0]), small)
    many = _transformed_rejection(types, mean, pixel, key, ~small)
    return dr.select(small, few, many)


def _inversion(types: Any, mean: Any, u: Any, active: Any) -> Any:
    mean = dr.select(active, mean, 0.0)
    per_mean = dr.rcp(mean)  # infinite for a mean of 0, where w_0 = u < 1 ends the search at once

    def steps(rest: Any, factor: Any, count: Any) -> tuple[Any, Any, Any]:
        # Once at or below 1 the rest turns negative and stays so: steps taken too many add nothing to the count.
        for _ in range(_UNROLLED):
            count = count + dr.select(rest > 1.0, types.Float64(1.0), types.Float64(0.0))
            factor = factor + per_mean
            rest = (rest - 1.0) * factor
        return rest, factor, count

    size = dr.width(mean)
    start = (u * dr.exp(mean), dr.zeros(types.Float64, size), dr.zeros(types.Float64, size))
    return dr.while_loop(
        start,
        lambda rest, factor, count: (rest > 1.0) & (count < _INVERSION_STEPS),
        steps,
        label="poisson_inversion",
    )[2]


def _transformed_rejection(types: Any, mean: Any, pixel: Any, key: tuple[Any, Any], active: Any) -> Any:
    mean = dr.select(active, mean, 100.0)
    b = 0.931 + 2.53 * dr.sqrt(mean)
    a = -0.059 + 0.02483 * b
    log_inverse_alpha = dr.log(1.1239 + 1.1328 / (b - 3.4))
    squeeze = 0.9277 - 3.6224 / (b - 2.0)
    log_mean = dr.log(mean)

    def attempt(count: Any, index: Any, pending: Any) -> tuple[Any, Any, Any]:
        words = philox4x32(types, (pixel, index, 0, 0), key)
        u = uniform64(types, words[1], words[0]) - 0.5
        v = uniform64(types, words[3], words[2])
        edge = 0.5 - dr.abs(u)
        count = dr.floor((2.0 * a / edge + b) * u + mean + 0.43)
        inside = (edge >= 0.07) & (v <= squeeze)
        outside = (count < 0.0) | ((edge < 0.013) & (v > edge))
        below = dr.log(v) + log_inverse_alpha - dr.log(a / (edge * edge) + b) <= (
            count * log_mean - mean - _log_factorial(dr.maximum(count, 0.0))
        )
        return count, index + 1, pending & ~(inside | (~outside & below))

    size = dr.width(mean)
    count, index, pending = dr.while_loop(
        (dr.zeros(types.Float64, size), dr.zeros(types.UInt32, size), types.Bool(active)),
        lambda count, index, pending: pending,
        attempt,
        label="poisson_ptrs",
    )
    del index, pending
    return count


def _log_factorial(k: Any) -> Any:
    """ln k! by Stirling's series at k + 9 (next term 2e-12) and the recurrence down."""
    x = k + 9.0
    product = (k + 1.0) * (k + 2.0) * (k + 3.0) * (k + 4.0) * (k + 5.0) * (k + 6.0) * (k + 7.0) * (k + 8.0)
    r = dr.rcp(x)
    s = r * r
    series = r * (1 / 12 - s * (1 / 360 - s * (1 / 1260 - s / 1680)))
    return (x - 0.5) * dr.log(x) - x + _HALF_LOG_TWO_PI + series - dr.log(product)
