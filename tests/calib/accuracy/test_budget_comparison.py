"""Budgets of repeated tests and of both sides, by hand and drawn."""

import numpy as np
import pytest

from calib.accuracy import budget_comparison
from calib.accuracy.error_budget import TERMS, ErrorTerm, combine
from optics.units import ARCSEC_RAD


def term(x, uncertainty, n=0):
    return ErrorTerm(arcsec=np.array([x, 2.0 * x]), uncertainty_arcsec=np.full(2, uncertainty), n=n)


def test_root_mean_square_of_a_test_that_is_repeated():
    """Three places; 30 000 drawn tests scatter as stated; a test that tells no uncertainty adds none."""
    values, errors = np.array([1.0, 2.0, 2.0]), np.array([0.04, 0.03, 0.05])
    found = budget_comparison.repeated_term([term(v, e, 30) for v, e in zip(values, errors, strict=True)])
    assert found.arcsec == pytest.approx([np.sqrt(3.0), np.sqrt(12.0)])
    assert found.n == 90
    draws = values + errors * np.random.default_rng(1).standard_normal((30_000, 3))
    assert found.uncertainty_arcsec[0] == pytest.approx(np.sqrt((draws**2).mean(1)).std(), rel=0.03)
    assert budget_comparison.repeated_term([term(1.0, np.nan)]).uncertainty_arcsec.tolist() == [0.0, 0.0]


def test_marking_error_is_the_scatter_of_surveys():
    """4000 drawn surveys of five points: three standard deviations of a coordinate, whatever the length of vectors."""
    rng = np.random.default_rng(4)
    surveyed = np.tile(np.concatenate([rng.uniform(-0.05, 0.05, (5, 2)), np.ones((5, 1))], axis=1), (4000, 1, 1))
    surveyed[..., :2] += 0.2 * ARCSEC_RAD * rng.standard_normal((4000, 5, 2))
    found = budget_comparison.survey_term(surveyed * rng.uniform(0.5, 2.0, (4000, 5, 1)))
    assert found.arcsec == pytest.approx([0.6, 0.6], rel=4.0 / np.sqrt(2 * 20_000))
    assert found.uncertainty_arcsec == pytest.approx(found.arcsec / np.sqrt(2 * 3999 * 5))
    assert found.n == 20_000
    assert budget_comparison.survey_term(surveyed[:1]) is None


@pytest.mark.parametrize("k", [5, 8, 40])
def test_one_more_draw_lies_within_what_a_few_tell(k):
    """Mean squared pull of a further normal draw is 1, however few it is judged by."""
    drawn = np.random.default_rng(k).standard_normal((k + 1, 200_000))
    pull2 = (drawn[k] - drawn[:k].mean(0)) ** 2 / budget_comparison.next_draw_variance(drawn[:k])
    assert pull2.mean() == pytest.approx(1.0, abs=0.05)


def test_ratio_and_pull_of_a_term():
    """The predicted uncertainty of HSFE and C1 contains the measured one; a term in the noise has no ratio."""
    ours, theirs = term(0.6, 0.02), term(0.5, 0.03)
    ratio, sigma = budget_comparison.term_ratio("TE", ours, theirs)
    assert (ratio[0], sigma[0]) == pytest.approx((1.2, 1.2 * np.hypot(0.02 / 0.6, 0.03 / 0.5)))
    assert budget_comparison.term_pull("TE", ours, theirs) == pytest.approx(np.array([0.1, 0.2]) / np.hypot(0.02, 0.03))
    for name in ("HSFE", "LSFE-C1"):
        assert budget_comparison.term_ratio(name, ours, theirs)[1][0] == pytest.approx(1.2 * 0.02 / 0.6)
        assert budget_comparison.term_pull(name, ours, theirs) == pytest.approx(np.array([0.1, 0.2]) / 0.02)
    assert np.isnan(budget_comparison.term_ratio("TE", term(0.05, 0.02), theirs)[0][0])
    assert np.isnan(budget_comparison.term_ratio("TE", term(0.0, 0.0), term(0.0, 0.0))).all()


def test_frame_terms_together_scatter_as_stated():
    """20 000 budgets whose terms scatter as stated: the ratio's scatter, known to 0.5 %, second order to 2 %."""
    rng, truth, errors = np.random.default_rng(2), np.array([0.5, 0.3, 0.33]), np.array([0.02, 0.03, 0.01])
    a, b = (truth + errors * rng.standard_normal((20_000, 3)) for _ in range(2))
    b[:, 1] = truth[1]  # of HSFE the prediction's uncertainty is all
    drawn = np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    sizes = zip(TERMS, [*truth, 0.2, 0.2], [*errors, 0.01, 0.01], strict=True)
    budget = combine({name: term(size, error) for name, size, error in sizes}, stars=4)
    ratio, sigma = budget_comparison.frame_terms_ratio(budget, budget)
    assert ratio == pytest.approx([1.0, 1.0])
    assert sigma[0] == pytest.approx(drawn.std(), rel=0.03)
