"""Sections and verdicts: what a verdict allows follows from the sample."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import ratio_near, two_sided_limit


def outcome_of(ratio: float, error: float, within: float = 0.05) -> Outcome:
    """A ratio per axis, and what it may be off."""
    q = Quantities()
    q.axis("axis", ["x", "y"])
    q.add("ratio", [1.0, ratio], "Ratio", dims="axis", error=[error, error])
    q.add("allowed", within)
    return Outcome(config=SimpleNamespace(), result={}, data=q.dataset)


@pytest.mark.parametrize(
    ("ratio", "error", "holds"), [(1.05, 0.01, True), (1.09, 0.01, False), (0.91, 0.01, False), (1.09, 0.03, True)]
)
def test_a_ratio_may_be_off_by_a_part_and_its_noise(ratio, error, holds):
    assert two_sided_limit(2) == pytest.approx(2.807, abs=1e-3)  # 1 % over two normal deviates
    for within in (0.05, "allowed"):
        (judged,) = ratio_near("ratio", within=within)(outcome_of(ratio, error))
        assert judged.limit == pytest.approx(0.05 + 2.807 * error, abs=1e-4)
        assert judged.passed is holds


def test_a_run_too_small_to_tell_is_not_judged():
    assert ratio_near("ratio", within=0.05, most=0.25)(outcome_of(1.0, 0.2)) == []
    assert ratio_near("missing", within=0.05)(outcome_of(1.0, 0.2)) == []
    (judged,) = ratio_near("ratio", within=0.05)(outcome_of(np.nan, 0.01))
    assert not judged.passed
