"""Poisson variates against the exact distribution, over both algorithms and their border."""

import numpy as np
import pytest
from scipy import stats

from render.engine import Engine
from render.engine.philox import split_key
from render.engine.poisson import INVERSION_LIMIT, poisson

N = 1 << 20
MEANS = (0.01, 1.0, 12.0, 29.9, 30.1, 100.0, 1e5)


def draw(mean: float | np.ndarray, key: int, **options: bool) -> np.ndarray:
    import drjit as dr

    types = Engine.start("llvm").types
    means = types.Float64(np.broadcast_to(np.asarray(mean, float), N).copy())
    return np.array(poisson(types, means, dr.arange(types.UInt32, N), split_key(types, key), **options))


@pytest.mark.parametrize("mean", MEANS)
def test_exact_distribution(mean: float) -> None:
    """Chi-square over cells of at least 50 expected counts; N = 2^20 draws, fixed key, p > 1e-4 in each of 12 cases."""
    values = draw(mean, 2024)
    assert np.array_equal(values, np.rint(values))
    assert values.min() >= 0
    edges = np.unique(stats.poisson.ppf(np.linspace(0, 1, 201)[1:-1], mean))
    cumulative = np.concatenate([[0.0], stats.poisson.cdf(edges, mean), [1.0]])
    expected = N * np.diff(cumulative)
    observed = np.bincount(np.searchsorted(edges, values), minlength=len(expected))
    while expected[-1] < 50:  # the last cell of a small mean
        expected[-2] += expected[-1]
        observed[-2] += observed[-1]
        expected, observed = expected[:-1], observed[:-1]
    assert stats.chisquare(observed, expected).pvalue > 1e-4


@pytest.mark.parametrize("mean", MEANS)
def test_tails(mean: float) -> None:
    """Counts beyond the quantiles 1e-4 and 1 - 1e-4 of the exact law, within 4.5 sigma of a Poisson count."""
    values = draw(mean, 99)
    for wanted, seen in (
        (stats.poisson.sf(q := stats.poisson.isf(1e-4, mean), mean), (values > q).sum()),
        (stats.poisson.cdf(q := stats.poisson.ppf(1e-4, mean) - 1, mean), (values <= q).sum()),
    ):
        assert abs(seen - N * wanted) <= 4.5 * np.sqrt(N * wanted) + 1


def test_mean_zero_gives_zero() -> None:
    assert not draw(0.0, 1).any()


def test_value_does_not_depend_on_the_neighbours() -> None:
    """A pixel's variate is a function of its own mean and index, whichever branch its neighbours take."""
    mixed = np.where(np.arange(N) % 3 == 0, 5.0, INVERSION_LIMIT * 4)
    values = draw(mixed, 8)
    assert np.array_equal(values[::3], draw(5.0, 8)[::3])
    assert np.array_equal(values[1::3], draw(INVERSION_LIMIT * 4, 8)[1::3])


def test_the_hint_changes_no_variate() -> None:
    mixed = np.geomspace(0.01, 1e6, N)
    assert np.array_equal(draw(mixed, 4), draw(mixed, 4, mostly_small=True))


def test_known_variates() -> None:
    """What earlier versions drew: frames of a seed stay the same, byte for byte."""
    assert draw(np.geomspace(0.1, 1e5, N), 11)[:: N // 8].astype(int).tolist() == [1, 2, 4, 21, 87, 540, 3197, 17890]
