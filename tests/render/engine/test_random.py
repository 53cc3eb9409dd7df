"""Random streams: keys are functions of (seed, path, name, frame) and of nothing else."""

import numpy as np
import pytest

from render.engine.random import Streams, stratified, stratified_normal


def test_key_is_reproducible_and_pinned() -> None:
    """A changed key would change every published frame."""
    assert Streams(7).key("photon", 3) == Streams(7).key("photon", 3)
    assert Streams(7).key("photon", 3) == 0xF6B5472C8AD7C85B


def test_keys_differ_in_each_part() -> None:
    root = Streams(1)
    keys = [Streams(seed).key(name, frame) for seed in (0, 1, 2**40) for name in ("a", "b", "") for frame in (0, 1, 2)]
    keys += [Streams(1).key("photon", frame) for frame in (0, 1, 2**16, 2**32 - 1, 2**32, 2**32 + 1, 2**40)]
    keys += [root.child("a").key("b"), root.child("b").key("a"), root.child("a", "b").key(""), root.child("ab").key("")]
    assert len(set(keys)) == len(keys)


def test_children_compose() -> None:
    assert Streams(5).child("x").child(2).key("n") == Streams(5).child("x", "2").key("n")


def test_generator_is_a_stream_too() -> None:
    first = Streams(3).generator("gyro", 4).normal(size=5)
    assert np.array_equal(first, Streams(3).generator("gyro", 4).normal(size=5))
    assert not np.array_equal(first, Streams(3).generator("gyro", 5).normal(size=5))


@pytest.mark.parametrize("count", [2, 50])
def test_stratified_numbers_fill_every_interval_once(count):
    numbers = stratified(np.random.default_rng(3), count, 7)
    assert numbers.shape == (count, 7)
    assert np.array_equal(np.sort(np.floor(numbers * count), axis=0), np.tile(np.arange(count)[:, None], 7))
    normal = stratified_normal(np.random.default_rng(3), 50, 20)
    assert normal.std(axis=0) == pytest.approx(np.ones(20), abs=0.13)
    assert normal.std(axis=0).mean() == pytest.approx(1.0, abs=0.02)  # by chance each within 10 %
