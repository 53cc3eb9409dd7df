"""The budget's ratios are judged within 10 %, or what a run can tell, and not at all where it can tell nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.budget.criteria import _ratios


def pair_of(ratio: float, spread: float) -> SimpleNamespace:
    """A comparison in which everything is off by the same."""
    found = np.array([1.0, ratio]), np.full(2, spread)
    return SimpleNamespace(ratio=lambda name: found, together=lambda: found)


@pytest.mark.parametrize(
    ("ratio", "spread", "holds"),
    [(1.08, 0.01, True), (1.12, 0.01, False), (0.88, 0.01, False), (1.12, 0.06, True), (1.3, 0.06, False)],
)
def test_ten_percent_or_the_sampling_error(ratio, spread, holds):
    judged = _ratios(pair_of(ratio, spread), "cog", 1)
    assert len(judged) == 5
    assert all(one.passed == holds for one in judged)


@pytest.mark.parametrize(("ratio", "spread"), [(1.0, 0.2), (np.nan, 0.01)])
def test_what_a_run_cannot_tell_is_not_judged(ratio, spread):
    assert _ratios(pair_of(ratio, spread), "cog", 1) == []
