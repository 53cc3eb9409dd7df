"""Fisher distribution at any concentration: digits of 1 - R, bias of the estimators, intervals, and SciPy's fit."""

from decimal import Decimal, getcontext

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import kstest, vonmises_fisher

from calib.directional import fisher

MEAN = np.array([0.48, -0.6, 0.64])


def _rng(seed: int = 4) -> np.random.Generator:
    return np.random.default_rng(seed)


def _deficit_by_decimals(vectors: NDArray[np.float64]) -> float:
    """1 - R literally, in 60 digits."""
    getcontext().prec = 60
    rows = [[Decimal(float(x)) for x in row] for row in vectors]
    units = [[x / sum(y * y for y in row).sqrt() for x in row] for row in rows]
    total = [sum(column) for column in zip(*units, strict=True)]
    return float(1 - sum(x * x for x in total).sqrt() / len(units))


@pytest.mark.parametrize("concentration", [3.0, 1e4, 1e10, 1e13, 1e17])
def test_deficit_against_sixty_digits(concentration: float) -> None:
    w = fisher.sample_fisher(MEAN, concentration, 50, _rng())
    # a vector rounded to 1e-16 moves a chord of 1/sqrt(k) by 1e-16 sqrt(k), averaged over 50
    assert fisher.fit_fisher(w).deficit == pytest.approx(
        _deficit_by_decimals(w), rel=1e-15 * np.sqrt(concentration) + 1e-13
    )


def test_mean_resultant_of_the_density_by_quadrature() -> None:
    for k in (0.02, 0.7, 5.0, 40.0):
        weight = quad(lambda c, k=k: np.exp(k * (c - 1)), -1, 1)[0]
        deficit = quad(lambda c, k=k: (1 - c) * np.exp(k * (c - 1)), -1, 1, epsabs=1e-13)[0] / weight
        assert fisher.deficit_of_concentration(k) == pytest.approx(deficit, rel=1e-9)


@pytest.mark.parametrize("concentration", [1e-2, 0.3, 2.0, 24.0, 26.0, 400.0, 1e12])
def test_concentration_and_deficit_are_inverse(concentration: float) -> None:
    found = fisher.concentration_from_deficit(fisher.deficit_of_concentration(concentration))
    assert found == pytest.approx(concentration, rel=1e-10 if concentration > 0.1 else 1e-6)


@pytest.mark.parametrize("concentration", [0.5, 8.0, 1e6, 1e12])
def test_sample_has_the_distribution_and_no_preferred_azimuth(concentration: float) -> None:
    w = fisher.sample_fisher(MEAN, concentration, 4000, _rng(8))
    versine = 0.5 * np.einsum("ni,ni->n", w - MEAN, w - MEAN)
    total = -np.expm1(-2 * concentration)
    assert kstest(versine, lambda c: -np.expm1(-concentration * c) / total).pvalue > 0.001
    east, north = fisher.tangent_plane(w, MEAN).T
    assert kstest(np.arctan2(north, east), "uniform", args=(-np.pi, 2 * np.pi)).pvalue > 0.001


def test_likelihood_agrees_with_scipy_at_moderate_concentration() -> None:
    for k in (0.5, 5.0, 200.0):
        w = fisher.sample_fisher(MEAN, k, 500, _rng(5))
        mean, kappa = vonmises_fisher.fit(w)
        fit = fisher.fit_fisher(w)
        assert fit.concentration_likelihood == pytest.approx(kappa, rel=1e-6)
        np.testing.assert_allclose(fit.mean, mean, atol=1e-12)


def test_bias_of_the_estimators() -> None:
    """N = 20000 samples of n = 5: means of 1/k and k known to 0.35 % and 0.5 % (one sigma)."""
    n, runs, k = 5, 20000, 1e11
    w = fisher.sample_fisher(MEAN, k, n * runs, _rng(9)).reshape(runs, n, 3)
    deficit = 0.5 * fisher.mean_and_chords(w)[1].mean(1)
    one = fisher.fit_fisher(w[0])
    scale = deficit / one.deficit  # every estimator of k goes as 1/d
    assert np.mean(scale / one.concentration) * k == pytest.approx(1.0, abs=4 * 0.0036)  # 1/k unbiased
    assert np.mean(one.concentration / scale) / k == pytest.approx(8 / 6, rel=4 * 0.006)  # k is not: nu/(nu - 2)
    assert np.mean(scale / one.concentration_document) * k == pytest.approx(0.8, rel=4 * 0.0036)  # (n - 1)/n
    root = np.sqrt(scale * k)
    assert np.mean(one.sigma_rad * root) == pytest.approx(1 - 1 / (4 * 8), abs=4 * 0.0019)
    assert np.std(one.sigma_rad * root) == pytest.approx(1 / np.sqrt(2 * 8), rel=0.05)


def test_cone_of_the_mean_covers() -> None:
    """N = 2000: a coverage of 0.95 is known to 0.0049, one of 0.68 to 0.0104. So few directions that n is not n - 1."""
    n, runs, k = 4, 2000, 1e12
    w = fisher.sample_fisher(MEAN, k, n * runs, _rng(10)).reshape(runs, n, 3)
    fits = [fisher.fit_fisher(sample) for sample in w]
    off = np.array([np.linalg.norm(fit.mean - MEAN) for fit in fits])
    for level, error in ((0.95, 0.0049), (0.6827, 0.0104)):
        inside = np.mean(off <= [2 * np.sin(fit.mean_cone_rad(level) / 2) for fit in fits])
        assert inside == pytest.approx(level, abs=4 * error)


@pytest.mark.parametrize("k", [1e12, 20.0])
@pytest.mark.parametrize("count", [4, 20, 100, 200])
def test_interval_covers_from_few_directions_to_many(count: int, k: float) -> None:
    """N = 4000: a coverage of 0.95 is known to 0.0034, one of 0.68 to 0.0074; the unbiased 1/k to its scatter."""
    w = fisher.sample_fisher(MEAN, k, 4000 * count, _rng(12)).reshape(4000, count, 3)
    square = fisher.mean_and_chords(w)[1].sum(1) / (2 * (count - 1)) * k
    assert square.mean() == pytest.approx(1.0, abs=5 / np.sqrt(4000 * (count - 1)))
    one = fisher.fit_fisher(fisher.sample_fisher(MEAN, 1e12, count, _rng(13)))
    for level, error in ((0.95, 0.0034), (0.6827, 0.0074)):
        low, high = np.array(one.sigma_interval_rad(level)) / one.sigma_rad
        covered = np.mean((low <= square**-0.5) & (square**-0.5 <= high))
        assert covered == pytest.approx(level, abs=4 * error)


def test_tangent_plane_keeps_chords_and_fewer_degrees_of_freedom_widen_sigma() -> None:
    w = fisher.sample_fisher(MEAN, 4.0, 100, _rng())
    plane = fisher.tangent_plane(w, MEAN)
    np.testing.assert_allclose(np.hypot(*plane.T), np.linalg.norm(w - MEAN, axis=1), rtol=1e-12)
    w = fisher.sample_fisher(MEAN, 1e10, 30, _rng())
    plain, honest = fisher.fit_fisher(w), fisher.fit_fisher(w, degrees_of_freedom=60 - 14)
    assert honest.sigma_rad / plain.sigma_rad == pytest.approx(np.sqrt(58 / 46), rel=1e-12)
