"""Exact Poisson variates on Dr.Jit arrays, one per pixel, from counters.

Small means: sequential inversion. With u uniform in (0, 1), the variate is the smallest k with F(k) >= u. Instead of
summing probabilities the rest is carried in units of the current one, w_0 = u exp(mu), w_k = (w_{k-1} - 1) k / mu,
until w_k <= 1: one subtraction and two products per step, no division, and the rounding error of each step is 1e-16 of
the tail that remains.

Large means: transformed rejection with squeeze, algorithm PTRS of Hoermann (1993), Insurance: Mathematics and
Economics 12, 39-45, valid from a mean of 10 on. Attempt t takes its two uniforms from counter (pixel, t, 0, 0). The
squeeze settles 60 to 75 % of the pixels without a logarithm; the others are gathered and continue in vectors of their
own, because a vector of pixels lasts as long as its slowest.

Neither is an approximation; both run in float64 on uniforms of 52 bits. They are used below and
above `INVERSION_LIMIT`, where the two cost about the same.
"""

from __future__ import annotations

from typing import Any

from render.engine.jit import dr
from render.engine.philox import philox4x32, uniform64

INVERSION_LIMIT = 30.0
# Reached with a probability of 1e-80 at the largest mean of the branch; ends the loop if rounding leaves a rest.
_INVERSION_STEPS = 200.0
_UNROLLED = 8
_HALF_LOG_TWO_PI = 0.9189385332046727


def poisson(types: Any, mean: Any, pixel: Any, key: tuple[Any, Any], *, mostly_small: bool = False) -> Any:
    """Poisson variates (n,) of means (n,) from 0 to 1e8, with the pixels' indices in the whole detector as counters.

    ``mostly_small`` promises that most means lie below `INVERSION_LIMIT`: faster if so, the same variates.
    """
    given = mean
    mean = types.Float64(given)
    small = mean < INVERSION_LIMIT
    words = philox4x32(types, (pixel, 0, 0, 0), key)
    first, second = uniform64(types, words[1], words[0]), uniform64(types, words[3], words[2])
    count, doubtful = _inversion(types, mean, first, small), ~small
    if not mostly_small:  # first attempt of PTRS for all means; unsettled ones are repeated below
        large, sure, _ = _Proposal(types, dr.select(small, 100.0, mean)).attempt(first, second)
        count, doubtful = dr.select(small, count, large), doubtful & ~sure
    count = _integer(types, count)
    dr.eval(count, doubtful, given)
    pending: Any = dr.compress(doubtful)
    if dr.width(pending):
        decided = _rejection(
            types,
            types.Float64(dr.gather(type(given), given, pending)),
            dr.gather(types.UInt32, types.UInt32(pixel), pending),
            tuple(word if dr.width(word) == 1 else dr.gather(types.UInt32, word, pending) for word in key),
        )
        dr.scatter(count, _integer(types, decided), pending)
    return types.Float64(count)


def _integer(types: Any, count: Any) -> Any:
    """Counts as UInt32, half the memory of Float64 between two kernels; counts beyond 2^32 - 256 are clipped."""
    return types.UInt32(dr.minimum(dr.maximum(count, 0.0), 4294967040.0))


def _inversion(types: Any, mean: Any, u: Any, active: Any) -> Any:
    mean = dr.select(active, mean, 0.0)
    per_mean = dr.rcp(mean)  # infinite for a mean of 0, where w_0 = u < 1 ends the search at once

    def steps(rest: Any, factor: Any, count: Any) -> tuple[Any, Any, Any]:
        # Once at or below 1 the rest turns negative and stays so: steps taken too many add nothing to the count.
        for _ in range(_UNROLLED):
            count = count + dr.select(rest > 1.0, types.Float64(1.0), types.Float64(0.0))
            factor = factor + per_mean
            rest = dr.fma(rest, factor, -factor)
        return rest, factor, count

    size = dr.width(mean)
    start = (u * dr.exp(mean), dr.zeros(types.Float64, size), dr.zeros(types.Float64, size))
    return dr.while_loop(
        start,
        lambda rest, factor, count: (rest > 1.0) & (count < _INVERSION_STEPS),
        steps,
        label="poisson_inversion",
    )[2]


class _Proposal:
    """The hat of PTRS for given means; `attempt` draws from it by two uniforms."""

    def __init__(self, types: Any, mean: Any) -> None:
        self.types, self.mean = types, mean
        self.b = 0.931 + 2.53 * dr.sqrt(mean)
        self.a = -0.059 + 0.02483 * self.b

    def attempt(self, first: Any, second: Any) -> tuple[Any, Any, Any]:
        """(count, taken without a logarithm, refused without one)."""
        u = first - 0.5
        edge = 0.5 - dr.abs(u)
        count = dr.floor((2.0 * self.a / edge + self.b) * u + self.mean + 0.43)
        # second <= 0.9277 - 3.6224 / (b - 2), a subset of what `below` takes: rounding cannot change the variate
        taken = (edge >= 0.07) & ((0.9277 - second) * (self.b - 2.0) >= 3.6224)
        return count, taken, (count < 0.0) | ((edge < 0.013) & (second > edge))

    def below(self, first: Any, second: Any, count: Any) -> Any:
        """Whether the point lies below the density."""
        edge = 0.5 - dr.abs(first - 0.5)
        height = second * (1.1239 + 1.1328 / (self.b - 3.4)) / (self.a / (edge * edge) + self.b)
        series, product = _log_factorial(dr.maximum(count, 0.0))
        # ln k! = series - ln product; one logarithm for all factors
        return dr.log(height / product) <= count * dr.log(self.mean) - self.mean - series


def _rejection(types: Any, mean: Any, pixel: Any, key: tuple[Any, ...]) -> Any:
    """PTRS from its first attempt on, until every point is taken."""
    proposal = _Proposal(types, mean)

    def attempt(count: Any, index: Any, pending: Any) -> tuple[Any, Any, Any]:
        words = philox4x32(types, (pixel, index, 0, 0), key)
        first, second = uniform64(types, words[1], words[0]), uniform64(types, words[3], words[2])
        count, taken, refused = proposal.attempt(first, second)
        return count, index + 1, pending & ~(taken | (~refused & proposal.below(first, second, count)))

    size = dr.width(mean)
    return dr.while_loop(
        (dr.zeros(types.Float64, size), dr.zeros(types.UInt32, size), dr.full(types.Bool, True, size)),
        lambda count, index, pending: pending,
        attempt,
        label="poisson_ptrs",
    )[0]


def _log_factorial(k: Any) -> tuple[Any, Any]:
    """ln k! = first - ln second, by Stirling's series at k + 9 (next term 2e-12) and the recurrence down."""
    x = k + 9.0
    product = (k + 1.0) * (k + 2.0) * (k + 3.0) * (k + 4.0) * (k + 5.0) * (k + 6.0) * (k + 7.0) * (k + 8.0)
    r = dr.rcp(x)
    s = r * r
    series = r * (1 / 12 - s * (1 / 360 - s * (1 / 1260 - s / 1680)))
    return (x - 0.5) * dr.log(x) - x + _HALF_LOG_TWO_PI + series, product
