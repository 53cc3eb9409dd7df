"""Philox4x32-10: random bits as a pure function of a counter and a key, on any backend.

Salmon, Moraes, Dror & Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC11 (2011): ten rounds, the version for
which the authors publish known answers (Random123, ``kat_vectors``). Written here rather than taken from
``drjit.Philox4x32`` because that class runs its rounds in a symbolic loop, which is half as fast, and fixes the fourth
counter.
"""

from __future__ import annotations

from typing import Any

from render.engine.jit import dr

_MULTIPLIER_0, _MULTIPLIER_1 = 0xD2511F53, 0xCD9E8D57
_WEYL_0, _WEYL_1 = 0x9E3779B9, 0xBB67AE85
_ROUNDS = 10
_TWO_PI = 6.283185307179586


def split_key(types: Any, key: int) -> tuple[Any, Any]:
    """Key as two opaque 32-bit words (low, high): a new key never means a new kernel."""
    return dr.opaque(types.UInt32, key & 0xFFFFFFFF), dr.opaque(types.UInt32, key >> 32)


def philox4x32(types: Any, counter: tuple[Any, Any, Any, Any], key: tuple[Any, Any]) -> tuple[Any, Any, Any, Any]:
    """Four 32-bit words for every counter."""
    word = types.UInt32
    c0, c1, c2, c3 = (word(c) for c in counter)
    k0, k1 = (word(k) for k in key)
    multiplier_0, multiplier_1 = word(_MULTIPLIER_0), word(_MULTIPLIER_1)
    for _ in range(_ROUNDS):
        high_0, low_0 = dr.mul_hi(multiplier_0, c0), multiplier_0 * c0
        high_1, low_1 = dr.mul_hi(multiplier_1, c2), multiplier_1 * c2
        c0, c1, c2, c3 = high_1 ^ c1 ^ k0, low_1, high_0 ^ c3 ^ k1, low_0
        k0, k1 = k0 + word(_WEYL_0), k1 + word(_WEYL_1)
    return c0, c1, c2, c3


def uniform64(types: Any, high: Any, low: Any) -> Any:
    """Float64 in the open interval (0, 1): (i + 1/2) / 2^52 from 52 of the 64 bits; never 0, never 1."""
    bits = (types.UInt64(high) << 32) | types.UInt64(low)
    one_to_two: Any = dr.reinterpret_array(types.Float64, (bits >> 12) | types.UInt64(0x3FF0000000000000))
    return one_to_two - (1.0 - 2.0**-53)


def uniform(types: Any, pixel: Any, key: tuple[Any, Any]) -> Any:
    """One Float64 in (0, 1) per pixel."""
    words = philox4x32(types, (pixel, 0, 0, 0), key)
    return uniform64(types, words[1], words[0])


def normal(types: Any, pixel: Any, key: tuple[Any, Any]) -> Any:
    """One standard normal Float32 per pixel by Box & Muller (1958), Ann. Math. Stat. 29, 610.

    The radius comes from 32 bits, so that values beyond 6.7 sigma (probability 3e-11) do not occur.
    """
    words = philox4x32(types, (pixel, 0, 0, 0), key)
    # (word + 1) 2^-32 lies in (0, 1]: the logarithm stays finite
    radius = dr.sqrt(-2.0 * dr.log(dr.fma(types.Float32(words[0]), 2.0**-32, 2.0**-33)))
    return radius * dr.cos(types.Float32(words[1]) * types.Float32(_TWO_PI * 2.0**-32))
