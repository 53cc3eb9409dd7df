"""Philox bits against the published known answers; uniforms and normals against their distributions."""

import numpy as np
import pytest
from scipy import stats

from render.engine import Engine
from render.engine.philox import normal, philox4x32, split_key, uniform, uniform64

N = 1 << 20


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [  # Random123 1.14, tests/kat_vectors, philox4x32 with 10 rounds
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_known_answers(counter: tuple[int, ...], key: tuple[int, int], answer: tuple[int, ...]) -> None:
    types = Engine.start("llvm").types
    words = philox4x32(types, tuple(types.UInt32(c) for c in counter), split_key(types, key[1] << 32 | key[0]))
    assert tuple(int(word[0]) for word in words) == answer


def test_uniform_ends_stay_open() -> None:
    types = Engine.start("llvm").types
    word = types.UInt32([0, 0xFFFFFFFF])
    low, high = np.array(uniform64(types, word, word))
    assert low == 2.0**-53
    assert high == 1.0 - 2.0**-53


def test_uniform_distribution() -> None:
    import drjit as dr

    types = Engine.start("llvm").types
    values = np.array(uniform(types, dr.arange(types.UInt32, N), split_key(types, 11)))
    assert stats.kstest(values, "uniform").pvalue > 1e-3  # N = 2^20, one fixed seed


def test_normal_distribution() -> None:
    import drjit as dr

    types = Engine.start("llvm").types
    values = np.array(normal(types, dr.arange(types.UInt32, N), split_key(types, 12)), float)
    assert stats.kstest(values, "norm").pvalue > 1e-3
    assert abs(values.mean()) < 4 / np.sqrt(N)
    assert abs(values.var() - 1) < 4 * np.sqrt(2 / N)
    assert abs((values**4).mean() - 3) < 4 * np.sqrt(96 / N)
    beyond = (np.abs(values) > 4).sum()
    assert abs(beyond - 2 * stats.norm.sf(4) * N) < 4 * np.sqrt(2 * stats.norm.sf(4) * N)


def test_streams_are_uncorrelated() -> None:
    import drjit as dr

    types = Engine.start("llvm").types
    pixel = dr.arange(types.UInt32, N)
    first, second = (np.array(normal(types, pixel, split_key(types, key)), float) for key in (5, 6))
    assert abs(np.mean(first * second)) < 4 / np.sqrt(N)
    assert abs(np.mean(first[1:] * first[:-1])) < 4 / np.sqrt(N)
