"""Checks of the distribution: good samples refused as often as stated, bad ones seen, outliers found together."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, expon, kstest

from calib.directional import fisher_checks
from calib.directional.fisher import fit_fisher, sample_fisher

MEAN = np.array([0.0, 0.6, 0.8])
ACROSS = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])


def _plane(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    w = MEAN + np.column_stack([x, y]) @ ACROSS
    return np.asarray(w / np.linalg.norm(w, axis=1, keepdims=True))


def test_p_value_of_isotropy_is_uniform() -> None:
    rng = np.random.default_rng(1)
    found = [fisher_checks.isotropy_check(sample_fisher(MEAN, 1e11, 20, rng)).p_value for _ in range(800)]
    assert kstest(found, "uniform").pvalue > 0.001


def test_isotropy_tends_to_kent() -> None:
    """For many directions T = n (k/2)^2 (l1 - l2)^2 against chi-square, l the moments about the mean (Kent 1982)."""
    w = sample_fisher(MEAN, 1e8, 4000, np.random.default_rng(3))
    fit = fit_fisher(w)
    low, high = np.linalg.eigvalsh((w - fit.mean).T @ (w - fit.mean) / len(w))[1:]
    kent = len(w) * (fit.concentration_document / 2) ** 2 * (high - low) ** 2
    assert fisher_checks.isotropy_check(w).p_value == pytest.approx(chi2.sf(kent, 2), rel=0.02)


def test_a_long_ellipse_is_seen_with_its_axes() -> None:
    rng = np.random.default_rng(5)
    n = 2000
    found = fisher_checks.isotropy_check(_plane(3e-6 * rng.standard_normal(n), 1e-6 * rng.standard_normal(n)))
    assert found.p_value < 1e-10
    assert found.major_rad == pytest.approx(3e-6, rel=4 / np.sqrt(2 * n))
    assert found.minor_rad == pytest.approx(1e-6, rel=4 / np.sqrt(2 * n))
    assert found.ratio == pytest.approx(3.0, rel=0.1)
    assert abs(found.direction @ ACROSS[0]) == pytest.approx(1.0, abs=2e-3)


def test_exponential_check_refuses_as_often_as_stated() -> None:
    """N = 2000: the level 5 % is known to 0.5 %."""
    rng = np.random.default_rng(7)
    levels = np.array([fisher_checks.exponential_check(sample_fisher(MEAN, 1e12, 30, rng)).level for _ in range(2000)])
    assert np.mean(levels <= 0.05) == pytest.approx(0.05, abs=4 * 0.0049)
    assert np.mean(levels <= 0.15) == pytest.approx(0.15, abs=4 * 0.008)
    assert min(fisher_checks.CRITICAL_EXPONENTIAL) == levels[levels < 1].min()


def test_a_mixture_has_heavier_tails() -> None:
    rng = np.random.default_rng(9)
    w = np.concatenate([sample_fisher(MEAN, 1e12, 200, rng), sample_fisher(MEAN, 4e10, 100, rng)])
    check = fisher_checks.exponential_check(w)
    assert check.level == 0.01
    assert check.found[-1] > check.expected[-1]
    assert check.expected == pytest.approx(expon.ppf((np.arange(300) + 0.5) / 300))
    assert np.all(np.diff(check.found) >= 0)


def test_outliers_are_found_together_and_false_alarms_are_as_stated() -> None:
    rng = np.random.default_rng(11)
    w = sample_fisher(MEAN, 1e12, 60, rng)
    w[[5, 17, 40]] = _plane(np.array([2e-5, 2e-5, 2.1e-5]), np.array([1e-6, 0.0, -1e-6]))
    np.testing.assert_array_equal(np.flatnonzero(fisher_checks.fisher_outliers(w)), [5, 17, 40])
    assert fit_fisher(w).sigma_rad > 3 * fit_fisher(w[~fisher_checks.fisher_outliers(w)]).sigma_rad
    # N = 1000 good samples: 5 % is known to 0.7 %; Bonferroni's bound, so not above
    rng = np.random.default_rng(13)
    alarms = [fisher_checks.fisher_outliers(sample_fisher(MEAN, 1e12, 25, rng), level=0.05).any() for _ in range(1000)]
    assert 0.02 < np.mean(alarms) < 0.05 + 4 * 0.007


def test_effective_degrees() -> None:
    """N = 20000 vectors: known to some 2 % in a Fisher distribution; an ellipse has (l1 + l2)^2 / (l1^2 + l2^2) / 2."""
    rng, n = np.random.default_rng(15), 20000
    assert fisher_checks.effective_degrees(sample_fisher(MEAN, 1e12, n, rng)) == pytest.approx(2 * (n - 1), rel=0.08)
    long = _plane(3e-6 * rng.standard_normal(n), 1e-6 * rng.standard_normal(n))
    assert fisher_checks.effective_degrees(long) == pytest.approx(2 * (n - 1) * (9 + 1) ** 2 / (81 + 1) / 2, rel=0.08)
    low, high = fit_fisher(long).sigma_interval_rad(effective=fisher_checks.effective_degrees(long))
    narrow = fit_fisher(long).sigma_interval_rad()
    assert low < narrow[0] < narrow[1] < high


@pytest.mark.parametrize(("shape", "own"), [("ellipse", (0.92, 0.98)), ("tails", (0.5, 0.95))])
def test_interval_is_too_narrow_for_other_distributions(shape: str, own: tuple[float, float]) -> None:
    """N = 1000 samples of 100, known to 0.7 points; own degrees of freedom mend it for an ellipse, not for outliers."""
    rng = np.random.default_rng(17)
    if shape == "ellipse":
        sigma, scale = np.sqrt(5.0) * 1e-6, np.broadcast_to([3e-6, 1e-6], (1000, 100, 2))
    else:
        sigma = np.sqrt(0.98 + 0.02 * 16.0) * 1e-6
        scale = 1e-6 * np.where(rng.random((1000, 100, 1)) < 0.02, 4.0, 1.0) * np.ones(2)
    held = []
    for part in scale:
        w = _plane(*(part * rng.standard_normal(part.shape)).T)
        fit, degrees = fit_fisher(w), fisher_checks.effective_degrees(w)
        ends = fit.sigma_interval_rad(), fit.sigma_interval_rad(effective=degrees)
        held.append([low <= sigma <= high for low, high in ends])
    plain, mended = np.mean(held, axis=0)
    assert plain < 0.92
    assert own[0] < mended < own[1]
